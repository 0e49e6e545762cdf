//! The parts of the vectors of whole ways: a network with its genesis, blocks of it, and the ways of readers.

use crate::ways::gone;
use crate::world::{NOW, World, name};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::fact::Fact;
use ledger_light::merkle;
use ledger_light::proof::{Proof, Shown};
use ledger_light::{Certificate, Change, Signature, Statement};
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Records as the ledger writes them: the order of their fields counts.
#[derive(Serialize)]
struct Organisation {
    name: &'static str,
    roots: [String; 1],
}

#[derive(Serialize)]
struct FoundingNode {
    id: u64,
    name: &'static str,
    organisation: &'static str,
    address: &'static str,
    voter: bool,
}

#[derive(Serialize)]
struct Node {
    id: u64,
    name: &'static str,
    organisation: &'static str,
    address: &'static str,
    role: &'static str,
}

#[derive(Serialize)]
struct Members<'a> {
    voters: &'a [u64],
    learners: Vec<u64>,
    outgoing: &'a [u64],
    learners_next: [u64; 0],
    auto_leave: bool,
}

#[derive(Serialize)]
struct Genesis {
    rules: u32,
    label: &'static str,
    created: u64,
    salt: Hash,
    organisations: Vec<Organisation>,
    nodes: Vec<FoundingNode>,
    snapshot_every: u64,
}

fn record(value: &impl Serialize) -> Option<Bytes> {
    Some(serde_json::to_vec(value).unwrap().into())
}

/// Governing writes at a height, in order of keys.
pub(crate) fn change(height: u64, writes: Vec<(String, Option<Bytes>)>) -> Change {
    let mut writes: Vec<_> =
        writes.into_iter().map(|(key, value)| (Bytes::from(["msp\0", &key].concat()), value)).collect();
    writes.sort();
    Change { height, writes }
}

/// The record of the members: those of the nodes 1 to 4 that do not vote follow.
pub(crate) fn members(voters: &[u64], outgoing: &[u64]) -> (String, Option<Bytes>) {
    let learners = (1..=4).filter(|node| !voters.contains(node) && !outgoing.contains(node)).collect();
    let members = Members { voters, learners, outgoing, learners_next: [], auto_leave: false };
    ("members".to_owned(), record(&members))
}

/// The record of a node at another address.
pub(crate) fn node(id: u64, [organisation, name]: [&'static str; 2], role: &'static str) -> (String, Option<Bytes>) {
    (format!("node/{id:020}"), record(&Node { id, name, organisation, address: "10.0.0.9:7450", role }))
}

/// The record of an organisation with this root.
pub(crate) fn organisation(name: &'static str, root: &[u8]) -> (String, Option<Bytes>) {
    (format!("organisation/{name}"), record(&Organisation { name, roots: [hex::encode(root)] }))
}

/// A network.
pub(crate) struct Scene {
    pub(crate) world: World,
    pub(crate) network: Hash,
    /// The governing writes of its genesis.
    pub(crate) genesis: Change,
    /// The same for the vectors.
    pub(crate) begin: Value,
}

/// A block with so many leaves: the ground, then verdicts, and at the end an event and a control write if there is room.
#[derive(Clone, Copy)]
pub(crate) struct Block {
    pub(crate) network: Hash,
    pub(crate) recoveries: u64,
    pub(crate) height: u64,
    pub(crate) time: u64,
    pub(crate) governing: Hash,
    pub(crate) leaves: u32,
}

impl Block {
    pub(crate) fn fact(&self, index: u32) -> Fact<'static> {
        let zero = Hash::ZERO;
        match self.leaves - index {
            _ if index == 0 => {
                Fact::Ground { governing: self.governing, control: zero, digest: Hash([4; 32]), previous: zero }
            }
            1 if self.leaves > 4 => Fact::Control { key: b"abac\0grant/Turtlebot4/cmd_vel", value: None },
            2 if self.leaves > 4 => Fact::Event {
                index: Some(0),
                chaincode: "abac",
                name: "granted",
                subject: "Turtlebot4/cmd_vel",
                payload: Hash::of(&[b"{}"]),
            },
            _ => Fact::Verdict {
                index: index - 1,
                id: Hash::of(&[&index.to_be_bytes()]),
                code: if index.is_multiple_of(2) { 3001 } else { 0 },
                response: Hash::of(&[b""]),
            },
        }
    }

    pub(crate) fn statement(&self) -> Statement {
        let leaves = (0..self.leaves).map(|index| self.fact(index).leaf()).collect();
        let Self { network, recoveries, height, time, .. } = *self;
        Statement { network, recoveries, height, time, block: Hash([1; 32]), results: merkle::root(leaves) }
    }

    /// Some of the facts, with their paths.
    pub(crate) fn shown(&self, indices: &[u32]) -> Vec<Shown> {
        let leaves: Vec<Hash> = (0..self.leaves).map(|index| self.fact(index).leaf()).collect();
        indices.iter().map(|index| Shown::of(&self.fact(*index), &leaves, *index).unwrap()).collect()
    }

    /// The proof that shows the ground, with these signatures.
    pub(crate) fn proof(&self, signatures: Vec<Signature>) -> Proof {
        Proof { certificate: Certificate { statement: self.statement(), signatures }, facts: self.shown(&[0]) }
    }
}

impl Scene {
    /// Both organisations and four nodes, of which these vote.
    pub(crate) fn new(world: World, voters: &[u64]) -> Self {
        let organisations = || ["Org1", "Org2"].into_iter().zip(&world.cas);
        let nodes = || (1..=4).map(|id| (id, name(id), if voters.contains(&id) { "voter" } else { "learner" }));
        let genesis = Genesis {
            rules: 1,
            label: "vectors",
            created: NOW,
            salt: Hash::of(&[&voters.iter().map(|id| *id as u8).collect::<Vec<_>>()]),
            organisations: organisations()
                .map(|(name, ca)| Organisation { name, roots: [hex::encode(ca.root())] })
                .collect(),
            nodes: nodes()
                .map(|(id, [organisation, name], role)| FoundingNode {
                    id,
                    name,
                    organisation,
                    address: "10.0.0.9:7450",
                    voter: role == "voter",
                })
                .collect(),
            snapshot_every: 10_000,
        };
        let text = serde_json::to_string(&genesis).unwrap();
        let network = Hash::of(&[b"ledgerd genesis v1\0", text.as_bytes()]);
        let mut writes = vec![members(voters, &[])];
        writes.extend(organisations().map(|(name, ca)| organisation(name, &ca.root())));
        writes.extend(nodes().map(|(id, names, role)| node(id, names, role)));
        let genesis = change(0, writes);
        let begin = json!({"network": network, "time": NOW, "genesis": text, "writes": hex::encode(genesis.to_bytes()),
                           "governing": genesis.extend(Hash::ZERO).unwrap()});
        Self { world, network, genesis, begin }
    }

    /// A block of three leaves after these changes.
    pub(crate) fn block(&self, height: u64, changes: &[&Change]) -> Block {
        let begun = self.genesis.extend(Hash::ZERO).unwrap();
        let governing = changes.iter().fold(begun, |chain, change| change.extend(chain).unwrap());
        Block { network: self.network, recoveries: 0, height, time: NOW + height * 200_000, governing, leaves: 3 }
    }

    /// The signatures of nodes below a statement.
    pub(crate) fn sign(&self, statement: &Statement, nodes: &[u64]) -> Vec<Signature> {
        nodes.iter().map(|node| self.world.sign(statement, *node).signature).collect()
    }

    /// The proof of a block with the signatures of nodes.
    pub(crate) fn proof(&self, block: &Block, nodes: &[u64]) -> Proof {
        block.proof(self.sign(&block.statement(), nodes))
    }
}

/// A reader is shown this at once.
pub(crate) fn step(changes: &[&Change], proof: impl AsRef<[u8]>) -> Value {
    let change = |change: &&Change| json!({"height": change.height, "writes": hex::encode(change.to_bytes())});
    let changes: Vec<_> = changes.iter().map(change).collect();
    json!({"changes": changes, "proof": hex::encode(proof)})
}

/// The ways, as they are collected.
#[derive(Default)]
pub(crate) struct Ways {
    pub(crate) beginnings: Map<String, Value>,
    pub(crate) ways: Vec<Value>,
}

impl Ways {
    /// A way to its end.
    #[track_caller]
    pub(crate) fn good(&mut self, name: &str, begin: &str, steps: Vec<Value>) {
        let gives = gone(&self.beginnings[begin], &steps).unwrap_or_else(|reason| panic!("{name}: {reason:?}"));
        self.ways.push(json!({"name": name, "begin": begin, "steps": steps, "gives": gives}));
    }

    /// A way whose last step is refused. With no step at all, the beginning is.
    #[track_caller]
    pub(crate) fn refused(&mut self, name: &str, (code, why): (Code, &str), begin: &str, steps: Vec<Value>) {
        match gone(&self.beginnings[begin], &steps) {
            Err(reason) => assert_eq!(reason.code, code, "{name}: {reason:?}"),
            Ok(_) => panic!("{name} is believed"),
        }
        self.ways.push(json!({"name": name, "begin": begin, "steps": steps, "refused": code.name(), "why": why}));
    }
}
