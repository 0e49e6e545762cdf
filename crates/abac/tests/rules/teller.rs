//! Two organisations, their people and nodes, and a chain that grows by what they sign.

use crate::chain::{self, Block, Chain};
use bytes::Bytes;
use ledger::Ledger;
use ledger::block::Payload;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::transaction::{Body, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_storage::entry::{Entry, EntryKind};
use serde_json::Value;
use testkit::{Ca, User};

/// 2030-01-01, in microseconds since the UNIX epoch.
pub(crate) const START: u64 = 1_893_456_000_000_000;
pub(crate) const SECOND: u64 = 1_000_000;

pub(crate) struct Teller {
    ledger: Ledger,
    chain: Chain,
    pub(crate) time: u64,
    nonce: u64,
    pub(crate) boss: User,
    pub(crate) owner: User,
    pub(crate) salma: User,
    pub(crate) farhad: User,
    pub(crate) camera: User,
    pub(crate) node1: User,
    pub(crate) node2: User,
    pub(crate) node3: User,
    /// Of no organisation.
    pub(crate) stranger: User,
    /// The CA of Org1.
    pub(crate) ca: SigningKey,
}

impl Teller {
    /// Org1 has operators, Org2 robots; each has a node, of which the first votes.
    pub(crate) fn new(rules: u32) -> Self {
        let cas = [Ca::new("org1-ca"), Ca::new("org2-ca")];
        let node = |id: u64| FoundingNode {
            id,
            name: format!("node{id}"),
            organisation: format!("Org{id}"),
            address: format!("node{id}:7450"),
            voter: id == 1,
        };
        let genesis = Genesis {
            rules,
            label: "story".into(),
            created: START,
            salt: Hash::of(&[b"story"]),
            snapshot_every: 100,
            organisations: [("Org1", &cas[0]), ("Org2", &cas[1])]
                .map(|(name, ca)| FoundingOrganisation::below(name, ca.root()))
                .to_vec(),
            nodes: vec![node(1), node(2)],
        };
        let genesis = genesis.to_bytes().unwrap();
        let [one, two] = &cas;
        let ed25519 = KeyKind::Ed25519;
        Self {
            ledger: chain::open(&genesis),
            chain: Chain { genesis, blocks: Vec::new() },
            time: START,
            nonce: 0,
            boss: one.user("boss", "admin", ed25519),
            owner: two.user("owner", "admin", ed25519),
            salma: one.user_with("Salma", "member", &["Turtlebot4", "Husky"]),
            farhad: one.user_with("Farhad", "member", &["Turtlebot4"]),
            camera: two.user("OptiTrack", "robot", ed25519),
            node1: one.user("node1", "node", KeyKind::P256),
            node2: two.user("node2", "node", KeyKind::P256),
            node3: two.user("node3", "node", KeyKind::P256),
            ca: one.key(),
            stranger: Ca::new("org3-ca").user("stranger", "admin", ed25519),
        }
    }

    pub(crate) fn finish(self) -> Chain {
        self.chain
    }

    pub(crate) fn network(&self) -> Hash {
        self.ledger.network()
    }

    pub(crate) fn height(&self) -> u64 {
        self.ledger.tip().height
    }

    /// A transaction's body, not signed yet.
    pub(crate) fn body(&mut self, by: Who, chaincode: &str, function: &str, args: &[&[u8]]) -> Body {
        self.nonce += 1;
        Body {
            network: Bytes::copy_from_slice(&self.network().0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&by(self).certificate]).0),
            nonce: [&self.nonce.to_be_bytes()[..], &[0; 8]].concat().into(),
            not_after: self.time + 60 * SECOND,
            chaincode: chaincode.into(),
            function: function.into(),
            args: args.iter().map(|arg| Bytes::copy_from_slice(arg)).collect(),
            known_block: None,
        }
    }

    pub(crate) fn sign(&self, by: Who, body: &Body) -> Bytes {
        let by = by(self);
        let signed = Transaction::sign(body, &by.key).unwrap().with_certificate(by.certificate.clone()).unwrap();
        signed.encoded().clone()
    }

    /// A signed call whose arguments are text.
    pub(crate) fn signed(&mut self, by: Who, chaincode: &str, function: &str, args: &[&str]) -> Bytes {
        let args: Vec<_> = args.iter().map(|arg| arg.as_bytes()).collect();
        let body = self.body(by, chaincode, function, &args);
        self.sign(by, &body)
    }

    /// Executes a block a second later; answers with what its transactions answer.
    pub(crate) fn block(&mut self, transactions: Vec<Bytes>) -> Vec<(Code, Bytes)> {
        self.time += SECOND;
        let data = Payload { time: self.time, transactions }.to_bytes();
        self.entry(EntryKind::Normal, data)
    }

    pub(crate) fn entry(&mut self, kind: EntryKind, data: Bytes) -> Vec<(Code, Bytes)> {
        let entry = Entry { index: self.height() + 1, term: 1, kind, data };
        let outcome = self.ledger.apply(&entry).unwrap();
        let events = chain::digest_of_events(&outcome.events);
        let results = outcome.certifiable.map(|it| it.results);
        self.chain.blocks.push(Block { entry, hash: outcome.hash, digest: outcome.digest, events, results });
        outcome.results.iter().map(|result| (result.code(), result.response.clone())).collect()
    }

    /// A block with one call that ends with this code.
    #[track_caller]
    pub(crate) fn call(&mut self, by: Who, wanted: Code, chaincode: &str, function: &str, args: &[&str]) -> Value {
        let signed = self.signed(by, chaincode, function, args);
        self.ends(signed, wanted)
    }

    /// A block with one call that only reads, which is no transaction.
    #[track_caller]
    pub(crate) fn read(&mut self, by: Who, chaincode: &str, function: &str, args: &[&str]) {
        self.call(by, Code::QueryOnly, chaincode, function, args);
    }

    /// A block with one transaction that ends with this code.
    #[track_caller]
    pub(crate) fn ends(&mut self, signed: Bytes, wanted: Code) -> Value {
        let (code, response) = self.block(vec![signed]).remove(0);
        assert_eq!(code, wanted, "{response:?}");
        serde_json::from_slice(&response).unwrap_or_default()
    }
}

/// Somebody of the story.
pub(crate) type Who = fn(&Teller) -> &User;
