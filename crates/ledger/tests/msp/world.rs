//! Organisations with their people and nodes, and a ledger that executes what they sign, a block a second.

use bytes::Bytes;
use ledger::block::Payload;
use ledger::members::{Change, MembershipChange};
use ledger::msp::{CarryCa, Decision, IssuedCertificate, KnownIdentity, NodeRole, Nodes};
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::transaction::{Body, Transaction};
use ledger::{Chaincode, Context, Ledger, Quorum, Registry, Rules};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::result::Event;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::sync::Arc;
pub(crate) use testkit::{Ca, User};

/// 2030-01-01, in microseconds since the UNIX epoch.
pub(crate) const START: u64 = 1_893_456_000_000_000;
pub(crate) const SECOND: u64 = 1_000_000;
pub(crate) const DAY: u64 = 24 * 3600 * SECOND;

/// Remembers which organisations and lost authorities it was told of, and who agreed to its calls.
struct Listener;

/// `agree TEXT` notes who agreed; with the text `refuse` or `panic` it does that instead, once it was armed.
static NEEDS_APPROVAL: [(&str, Quorum); 2] =
    [("agree", Quorum::Majority), ("agree-as-one", Quorum::Admins { of: None, least: 2 })];

impl Chaincode for Listener {
    fn name(&self) -> &'static str {
        "listener"
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("echo", [text]) => Ok(text.clone()),
            // Both go on for ever, where nobody stops them.
            ("hog", []) => loop {
                ctx.put(b"hog", vec![0; 1024 * 1024]);
            },
            ("stare", []) => loop {
                ctx.get(b"armed");
            },
            ("overload", []) => Err(Rejection::new(Code::Overloaded, "as the test asked")),
            ("arm", []) => {
                ctx.put(b"armed", "yes");
                Ok(Bytes::new())
            }
            ("agreed", []) => Ok(ctx.get(b"agreed").unwrap_or_default()),
            ("lost", []) => Ok(ctx.get(b"lost").unwrap_or_default()),
            ("disarm", []) => {
                ctx.delete(b"armed");
                Ok(Bytes::new())
            }
            // A detour to what needs approval.
            ("detour", [text]) => ctx.call("listener", "agree", std::slice::from_ref(text)),
            ("agree" | "agree-as-one", [text]) => {
                let approved = ctx.approved_by().unwrap();
                assert!(ctx.submitter().is_err(), "it acts for all who agreed");
                let names = approved.admins.iter().map(|(organisation, names)| format!("{organisation} {names:?}"));
                let names: Vec<_> = names.collect();
                let before = ctx.get(b"agreed").unwrap_or_default();
                let line = format!("{text:?} by {} for {}\n", names.join(", "), approved.proposer);
                ctx.put(b"agreed", [before, line.into()].concat());
                ctx.emit("agreed", "", text.clone());
                match (&text[..], ctx.get(b"armed")) {
                    (b"refuse", Some(_)) => Err(Rejection::new(Code::Refused, "as the test asked")),
                    (b"panic", Some(_)) => panic!("as the test asked"),
                    (b"detour", _) => ctx.call("listener", "agree", &[Bytes::from_static(b"nested")]),
                    _ => Ok(Bytes::new()),
                }
            }
            _ => Ok(ctx.get(b"removed").unwrap_or_default()),
        }
    }

    fn needs_approval(&self) -> &'static [(&'static str, Quorum)] {
        &NEEDS_APPROVAL
    }

    fn organisation_removed(&self, ctx: &mut Context<'_>, organisation: &str) {
        ctx.put(b"removed", organisation.to_owned());
    }

    fn authority_lost(&self, ctx: &mut Context<'_>, issuer: &[u8; 32]) {
        ctx.put(b"lost", hex::encode(issuer));
    }
}

/// The chaincodes of a node that speaks one number of rules more than any release.
fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.speak_up_to(Rules::OF_TESTS);
    registry.install(Arc::new(Listener)).unwrap();
    registry
}

pub(crate) struct Network {
    pub(crate) cas: Vec<Ca>,
    pub(crate) admins: Vec<User>,
    pub(crate) nodes: Vec<User>,
    pub(crate) ledger: Ledger,
    stores: (Bytes, Arc<State>, Arc<ResultStore>),
    pub(crate) time: u64,
    nonce: u64,
    /// Events of the last block.
    pub(crate) events: Vec<Event>,
    /// All blocks.
    pub(crate) blocks: Vec<Entry>,
}

impl Network {
    /// `Org1`, `Org2` …, each with an admin and a node `nodeN`; the first `voters` of the nodes vote.
    pub(crate) fn new(organisations: usize, voters: usize) -> Self {
        let cas: Vec<_> = (1..=organisations).map(|number| Ca::new(&format!("org{number}-ca"))).collect();
        let node = |index: usize| FoundingNode {
            id: index as u64 + 1,
            name: format!("node{}", index + 1),
            organisation: format!("Org{}", index + 1),
            address: format!("node{}:7450", index + 1),
            voter: index < voters,
        };
        let genesis = Genesis {
            rules: Rules::NEWEST.number(),
            label: "test".into(),
            created: START,
            salt: Hash::ZERO,
            snapshot_every: 100,
            organisations: (1..)
                .zip(&cas)
                .map(|(number, ca)| FoundingOrganisation::below(&format!("Org{number}"), ca.root()))
                .collect(),
            nodes: (0..organisations).map(node).collect(),
        };
        let genesis = genesis.to_bytes().unwrap();
        let (state, results) = (State::open(Box::new(MemoryState::default())).unwrap(), ResultStore::in_memory());
        let (state, results) = (Arc::new(state), Arc::new(results));
        let ledger = Ledger::open(&genesis, registry(), Arc::clone(&state), Arc::clone(&results)).unwrap();
        let admins = cas.iter().map(|ca| ca.user("Admin", "admin", KeyKind::Ed25519)).collect();
        let nodes =
            (1..).zip(&cas).map(|(number, ca)| ca.user(&format!("node{number}"), "node", KeyKind::Ed25519)).collect();
        let stores = (genesis, state, results);
        Self { cas, admins, nodes, ledger, stores, time: START, nonce: 0, events: Vec::new(), blocks: Vec::new() }
    }

    /// The ledger as it is after a restart.
    pub(crate) fn open_again(&self) -> Result<Ledger, Rejection> {
        let (genesis, state, results) = &self.stores;
        Ledger::open(genesis, registry(), Arc::clone(state), Arc::clone(results))
    }

    /// Another ledger of this network, from its beginning, that speaks no newer rules than these.
    pub(crate) fn open_older(&self, newest: Rules) -> Ledger {
        let mut registry = registry();
        registry.speak_up_to(newest);
        let state = State::open(Box::new(MemoryState::default())).unwrap();
        Ledger::open(&self.stores.0, registry, Arc::new(state), Arc::new(ResultStore::in_memory())).unwrap()
    }

    /// The stores of a node that has nothing.
    pub(crate) fn no_state() -> (Arc<State>, Arc<ResultStore>) {
        (Arc::new(State::open(Box::new(MemoryState::default())).unwrap()), Arc::new(ResultStore::in_memory()))
    }

    /// The ledger of another node, which has one more chaincode.
    pub(crate) fn open_beside(
        &self,
        (state, results): &(Arc<State>, Arc<ResultStore>),
        chaincode: impl Chaincode + 'static,
    ) -> Ledger {
        let mut registry = registry();
        registry.install(Arc::new(chaincode)).unwrap();
        Ledger::open(&self.stores.0, registry, Arc::clone(state), Arc::clone(results)).unwrap()
    }

    pub(crate) fn sign(&mut self, by: &User, function: &str, args: &[&str]) -> Transaction {
        self.sign_for("msp", by, function, args)
    }

    /// As [`Network::sign`], for another chaincode.
    pub(crate) fn sign_for(&mut self, chaincode: &str, by: &User, function: &str, args: &[&str]) -> Transaction {
        self.nonce += 1;
        let body = Body {
            network: Bytes::copy_from_slice(&self.ledger.network().0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&by.certificate]).0),
            nonce: [&self.nonce.to_be_bytes()[..], &[0; 8]].concat().into(),
            not_after: self.time + 60 * SECOND,
            chaincode: chaincode.into(),
            function: function.into(),
            args: args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect(),
            known_block: None,
        };
        Transaction::sign(&body, &by.key).unwrap().with_certificate(by.certificate.clone()).unwrap()
    }

    /// Executes one block with these transactions.
    pub(crate) fn block(&mut self, transactions: &[&Transaction]) -> Vec<Result<Bytes, Rejection>> {
        self.time += SECOND;
        let transactions = transactions.iter().map(|transaction| transaction.encoded().clone()).collect();
        let data = Payload { time: self.time, transactions }.to_bytes();
        let entry = Entry { index: self.ledger.tip().height + 1, term: 1, kind: EntryKind::Normal, data };
        let outcome = self.ledger.apply(&entry).unwrap();
        self.blocks.push(entry);
        self.events = outcome.events.into_iter().map(|emitted| emitted.event).collect();
        outcome.results.iter().map(ledger_storage::result::TransactionResult::outcome).collect()
    }

    /// Executes one block that changes the members.
    pub(crate) fn change_members(&mut self, changes: impl IntoIterator<Item = Change>) {
        self.change_members_as(&MembershipChange::new(changes));
    }

    /// The same; answers whether voters sign it.
    pub(crate) fn change_members_as(&mut self, change: &MembershipChange) -> bool {
        let data = change.to_bytes();
        let entry = Entry { index: self.ledger.tip().height + 1, term: 1, kind: EntryKind::ConfChangeV2, data };
        let outcome = self.ledger.apply(&entry).unwrap();
        self.blocks.push(entry);
        self.events = outcome.events.into_iter().map(|emitted| emitted.event).collect();
        outcome.certifiable.is_some()
    }

    /// One call in a block of its own.
    pub(crate) fn call(&mut self, by: &User, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let transaction = self.sign(by, function, args);
        self.block(&[&transaction]).remove(0)
    }

    /// A call by the admin of an organisation, counted from 1.
    pub(crate) fn admin(&mut self, organisation: usize, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let admin = self.admins.remove(organisation - 1);
        let answer = self.call(&admin, function, args);
        self.admins.insert(organisation - 1, admin);
        answer
    }

    /// A call by the founding node of an organisation, counted from 1.
    pub(crate) fn node(&mut self, organisation: usize, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let node = self.nodes.remove(organisation - 1);
        let answer = self.call(&node, function, args);
        self.nodes.insert(organisation - 1, node);
        answer
    }

    /// The answer of a query.
    pub(crate) fn ask(&self, by: &User, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let caller = self.ledger.msps().verify(&by.certificate, &[], self.time).unwrap();
        let args: Vec<_> = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        self.ledger.query(&caller, self.time, "msp", function, &args).map(|(answer, _)| answer)
    }

    /// The answer of a query, asked by the admin of Org1.
    pub(crate) fn query<T: DeserializeOwned>(&self, function: &str, args: &[&str]) -> T {
        serde_json::from_slice(&self.ask(&self.admins[0], function, args).unwrap()).unwrap()
    }

    /// Ids, names and roles of the nodes.
    pub(crate) fn roles(&self) -> Vec<(u64, String, NodeRole)> {
        let nodes: Nodes = self.query("nodes", &[]);
        nodes.nodes.into_iter().map(|node| (node.id, node.full_name(), node.role)).collect()
    }

    pub(crate) fn role(&self, id: u64) -> NodeRole {
        self.roles().into_iter().find(|(other, ..)| *other == id).unwrap().2
    }

    /// The record of a node that holds the key of a CA, by its index.
    pub(crate) fn carry(&self, ca: usize, organisation: &str, node: &str) -> CarryCa {
        CarryCa::prove(&self.ledger.network(), organisation, node, &self.cas[ca].key())
    }

    /// A node's knowledge of somebody who received a certificate before there was a ledger.
    pub(crate) fn known(&self, user: &User, name: &str, role: Role) -> KnownIdentity {
        let identity = self.ledger.msps().verify(&user.certificate, &[], self.time).unwrap();
        let issued = IssuedCertificate {
            serial: hex::encode(&identity.serial),
            issuer: Hash(identity.issuer),
            fingerprint: Hash(identity.fingerprint),
            not_before: identity.not_before,
            not_after: identity.not_after,
            via: String::new(),
            recorded: 0,
            revoked: false,
        };
        let attributes = identity.attributes;
        KnownIdentity { name: name.into(), role, attributes, secret: None, certificates: vec![issued] }
    }

    /// The removal that the other chaincode was told of.
    pub(crate) fn told(&self) -> String {
        self.listener("removed")
    }

    /// The lost authority that the other chaincode was told of last, in hexadecimal.
    pub(crate) fn lost(&self) -> String {
        self.listener("lost")
    }

    /// Which calls of the other chaincode were approved, by whom.
    pub(crate) fn agreed(&self) -> String {
        self.listener("agreed")
    }

    fn listener(&self, function: &str) -> String {
        let caller = self.ledger.msps().verify(&self.admins[0].certificate, &[], self.time).unwrap();
        let (answer, _) = self.ledger.query(&caller, self.time, "listener", function, &[]).unwrap();
        String::from_utf8(answer.to_vec()).unwrap()
    }

    pub(crate) fn event_names(&self) -> Vec<&str> {
        self.events.iter().map(|event| event.name.as_str()).collect()
    }
}

/// The code of a refusal; `Ok` if there is none.
pub(crate) fn code(answer: &Result<Bytes, Rejection>) -> Code {
    answer.as_ref().err().map_or(Code::Ok, |rejection| rejection.code)
}

pub(crate) fn json<T: DeserializeOwned>(answer: Result<Bytes, Rejection>) -> T {
    serde_json::from_slice(&answer.unwrap()).unwrap()
}

/// Id of the proposal in a decision that still waits.
pub(crate) fn waiting(answer: Result<Bytes, Rejection>) -> String {
    let decision: Value = json(answer);
    assert_eq!(decision["executed"], false, "{decision}");
    decision["proposal"]["id"].as_str().unwrap().to_owned()
}

/// The code that an approved call failed with.
pub(crate) fn failed(answer: Result<Bytes, Rejection>) -> Code {
    let decision: Decision = json(answer);
    assert!(!decision.executed);
    Code::from_number(decision.proposal.unwrap().failed.unwrap().code).unwrap()
}

pub(crate) fn is_executed(answer: Result<Bytes, Rejection>) -> bool {
    json::<Value>(answer)["executed"] == true
}
