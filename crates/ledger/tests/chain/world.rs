//! A network of two organisations, and a node's ledger without a node.

use bytes::Bytes;
use ledger::block::Payload;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::transaction::{Body, Transaction};
use ledger::{Chaincode, Context, Foretold, Ledger, Outcome, Registry, Revocation, Rules};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::result::Event;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, SledStore, State};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
pub(crate) use testkit::{Ca, User};

/// 2030-01-01, in microseconds since the UNIX epoch.
pub(crate) const NOW: u64 = 1_893_456_000_000_000;
pub(crate) const SECOND: u64 = 1_000_000;

/// Blocks between two snapshots.
pub(crate) const SNAPSHOT_EVERY: u64 = 10;

static NONCE: AtomicU64 = AtomicU64::new(1);

/// Calls the chaincode of these tests.
pub(crate) trait Caller {
    fn body(&self, network: Hash, function: &str, args: &[&str]) -> Body;
    fn sign(&self, body: &Body) -> Transaction;
}

impl Caller for User {
    fn body(&self, network: Hash, function: &str, args: &[&str]) -> Body {
        let nonce = [&NONCE.fetch_add(1, Ordering::Relaxed).to_be_bytes()[..], &[0; 8]].concat();
        Body {
            network: Bytes::copy_from_slice(&network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&self.certificate]).0),
            nonce: nonce.into(),
            not_after: NOW + 60 * SECOND,
            chaincode: "notes".into(),
            function: function.into(),
            args: args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect(),
            known_block: None,
        }
    }

    fn sign(&self, body: &Body) -> Transaction {
        Transaction::sign(body, &self.key).unwrap().with_certificate(self.certificate.clone()).unwrap()
    }
}

/// A chaincode that does what a test asks for.
pub(crate) struct Notes;

impl Chaincode for Notes {
    fn name(&self) -> &'static str {
        "notes"
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("put", [key, value]) => {
                ctx.put(key, value.clone());
                ctx.emit("noted", std::str::from_utf8(key).unwrap(), value.clone());
                Ok(ctx.submitter()?.id().into())
            }
            // Comes out as it is foretold, with one exception.
            ("foretold", [key, value]) => {
                let subject = if key == "otherwise" { "not as foretold" } else { std::str::from_utf8(key).unwrap() };
                ctx.put(key, value.clone());
                ctx.emit("noted", subject, value.clone());
                Ok(value.clone())
            }
            // Only once, and not by everybody.
            ("halt", [robot]) => {
                if ctx.get(robot).is_some() || ctx.submitter()?.name == "Mallory" {
                    return Err(Rejection::new(Code::Refused, "it stands already, or you may not"));
                }
                ctx.put(robot, "halted");
                ctx.emit("halted", std::str::from_utf8(robot).unwrap(), "");
                Ok(Bytes::new())
            }
            ("get", [key]) => Ok(ctx.get(key).unwrap_or_default()),
            ("put-then-panic", [key]) => {
                ctx.put(key, "never");
                ctx.emit("noted", "never", "");
                panic!("as the test asked");
            }
            ("put-then-refuse", [key]) => {
                ctx.put(key, "never");
                Err(Rejection::new(Code::Refused, "as the test asked"))
            }
            ("nested-failure", [key]) => {
                ctx.put(key, "outer");
                let inner = ctx.call("notes", "put-then-refuse", &[Bytes::from_static(b"inner")]);
                assert_eq!(inner.unwrap_err().code, Code::Refused);
                Ok(Bytes::new())
            }
            ("once-a-block", [key]) => {
                let here = Bytes::copy_from_slice(&ctx.height().to_be_bytes());
                if ctx.get(key).as_ref() == Some(&here) {
                    return Err(Rejection::new(Code::Refused, "once in a block"));
                }
                ctx.put(key, here);
                Ok(Bytes::new())
            }
            ("until", [time]) => match std::str::from_utf8(time).unwrap().parse::<u64>().unwrap() {
                until if ctx.block_time() <= until => Ok(Bytes::new()),
                _ => Err(Rejection::new(Code::Refused, "it is later than that")),
            },
            ("forever", []) => ctx.call("notes", "forever", &[]),
            ("too-much", []) => {
                ctx.put(b"k", vec![0; 1024 * 1024 + 1]);
                Ok(Bytes::new())
            }
            _ => Err(Rejection::unknown_function("notes", function, &["put", "get"])),
        }
    }

    fn foretell(&self, function: &str, args: &[Bytes]) -> Option<Foretold> {
        let ("foretold", [key, value]) = (function, args) else { return None };
        let subject = String::from_utf8(key.to_vec()).ok()?;
        let noted = Event { chaincode: "notes".into(), name: "noted".into(), subject, payload: value.clone() };
        Some(Foretold { response: value.clone(), events: vec![noted] })
    }

    fn told_early(&self, function: &str) -> bool {
        function == "halt"
    }

    fn begin_block(&self, ctx: &mut Context<'_>) {
        if ctx.get(b"alarm").is_some() {
            ctx.delete(b"alarm");
            ctx.emit("rang", "alarm", "");
        }
    }

    fn next_deadline(&self, ctx: &Context<'_>) -> Option<u64> {
        std::str::from_utf8(&ctx.get(b"alarm")?).ok()?.parse().ok()
    }

    fn identity_revoked(&self, ctx: &mut Context<'_>, revoked: &Revocation) {
        ctx.put(b"last-revoked", hex::encode(&revoked.serial));
    }

    fn may_read(&self, ctx: &Context<'_>, event: &Event) -> Result<(), Rejection> {
        if event.subject == "secret" && ctx.submitter()?.organisation != "Org1" {
            return Err(Rejection::new(Code::DeniedByPolicy, "secret"));
        }
        Ok(())
    }
}

pub(crate) struct World {
    pub(crate) org1: Ca,
    pub(crate) org2: Ca,
    pub(crate) genesis: Bytes,
    pub(crate) network: Hash,
}

impl World {
    pub(crate) fn new() -> Self {
        let (org1, org2) = (Ca::new("org1-ca"), Ca::new("org2-ca"));
        let genesis = Genesis {
            rules: Rules::NEWEST.number(),
            label: "test".into(),
            created: NOW - SECOND,
            salt: Hash::ZERO,
            snapshot_every: SNAPSHOT_EVERY,
            organisations: [("Org1", &org1), ("Org2", &org2)]
                .map(|(name, ca)| FoundingOrganisation::below(name, ca.root()))
                .to_vec(),
            nodes: vec![FoundingNode {
                id: 1,
                name: "node1".into(),
                organisation: "Org1".into(),
                address: "127.0.0.1:1".into(),
                voter: true,
            }],
        };
        let genesis = genesis.to_bytes().unwrap();
        let (_, network) = Genesis::from_bytes(&genesis).unwrap();
        Self { org1, org2, genesis, network }
    }

    pub(crate) fn ledger(&self) -> Ledger {
        let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
        self.try_ledger_on(state, Arc::new(ResultStore::in_memory())).unwrap()
    }

    /// A ledger on what is in a directory and on a disk of results.
    pub(crate) fn ledger_on(&self, directory: &Path, results: &SimDisk) -> Ledger {
        self.open_on(directory, results).unwrap()
    }

    pub(crate) fn open_on(&self, directory: &Path, results: &SimDisk) -> Result<Ledger, Rejection> {
        let state = Arc::new(State::open(Box::new(SledStore::open(directory)?))?);
        self.try_ledger_on(state, Arc::new(ResultStore::open(Arc::new(results.clone()), self.network)?))
    }

    pub(crate) fn try_ledger_on(&self, state: Arc<State>, results: Arc<ResultStore>) -> Result<Ledger, Rejection> {
        let mut registry = Registry::new();
        registry.install(Arc::new(Notes)).unwrap();
        Ledger::open(&self.genesis, registry, state, results)
    }
}

/// The entry that follows what the ledger has executed.
pub(crate) fn entry(ledger: &Ledger, time: u64, transactions: &[&Transaction]) -> Entry {
    let transactions = transactions.iter().map(|transaction| transaction.encoded().clone()).collect();
    let data = Payload { time, transactions }.to_bytes();
    Entry { index: ledger.tip().height + 1, term: 1, kind: EntryKind::Normal, data }
}

/// Orders and executes a block.
pub(crate) fn block(ledger: &Ledger, time: u64, transactions: &[&Transaction]) -> Outcome {
    ledger.apply(&entry(ledger, time, transactions)).unwrap()
}

pub(crate) fn codes(outcome: &Outcome) -> Vec<Code> {
    outcome.results.iter().map(ledger_storage::result::TransactionResult::code).collect()
}

pub(crate) fn note(ledger: &Ledger, reader: &User, key: &str) -> String {
    let identity = ledger.msps().verify(&reader.certificate, &[], NOW).unwrap();
    let answer = ledger.query(&identity, NOW, "notes", "get", &[Bytes::copy_from_slice(key.as_bytes())]);
    String::from_utf8(answer.unwrap().0.to_vec()).unwrap()
}
