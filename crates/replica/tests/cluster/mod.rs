//! A cluster in one thread: virtual time, messages in a queue, disks that lose what was not flushed. The seed decides
//! everything, so a failing run can be repeated. Invariants are checked at every step.
//!
//! Every node runs the replica of the product, with a state that is next to nothing. The harness has the rest of a machine.
//!
//! ```text
//! cluster      the network, time, and what must always hold
//!   node       a machine: its disks, and the process on it
//!   drive      the threads of a process: events into the replica, whose effects are carried out
//!   catch_up   old blocks go, disks are lost, and what is lacking is fetched
//!   people     who signs
//!   names      who votes
//! ```
#![allow(
    dead_code,
    unreachable_pub,
    unused_imports,
    clippy::allow_attributes,
    reason = "each test file uses its own part"
)]

mod catch_up;
mod drive;
pub(crate) mod names;
mod node;
mod people;

use bytes::Bytes;
use ledger::block::Payload;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_raft::{Desired, Input, Lane, Membership, PeerMessage, Status};
use ledger_replica::{self as replica, Effect, Timing};
use ledger_storage::entry::{Entry, EntryKind};
pub use node::{ALARM, BOARD_BYTES, Node, genesis};
pub use people::{ORGANISATION, PEOPLE, call};
use std::collections::{BTreeMap, BTreeSet};
use testkit::Random;

/// A unit of virtual time, microseconds.
pub const UNIT: u64 = 1_000;
/// Units of virtual time in a tick.
pub const TICK: u64 = 10;
/// 2030-01-01, in microseconds since the UNIX epoch: virtual time 0.
const EPOCH: u64 = 1_893_456_000_000_000;

/// The fate of a message in the network. Percent, and units of time.
#[derive(Clone, Copy)]
pub struct Faults {
    pub lose: u64,
    pub duplicate: u64,
    pub delay_max: u64,
    pub disk_max: u64,
}

pub const CALM: Faults = Faults { lose: 0, duplicate: 0, delay_max: 1, disk_max: 1 };

pub enum Event {
    Deliver {
        from: u64,
        to: u64,
        bytes: Bytes,
    },
    /// Given to a process that was stopped.
    Input(Box<Input>),
    Turn,
    Written,
    Execute,
    Store,
}

pub struct Cluster {
    pub nodes: BTreeMap<u64, Node>,
    /// Virtual time, microseconds.
    pub now: u64,
    /// How far wall clocks are ahead, by node, microseconds.
    pub ahead: BTreeMap<u64, i64>,
    /// A node that orders no control calls while it leads.
    pub withholds: Option<u64>,
    /// Complaints that were sent.
    pub complaints: u64,
    /// A node that takes the others to acknowledge any block time.
    pub deceived: Option<u64>,
    pub random: Random,
    pub faults: Faults,
    /// Directed links that lose everything.
    pub cut: BTreeSet<(u64, u64)>,
    /// Every committed entry that any node has executed: it never changes.
    pub chosen: Vec<Entry>,
    /// Hash and state digest of each of them.
    digests: Vec<(Hash, Hash)>,
    /// The transactions that were executed in each of them.
    executed: Vec<Vec<String>>,
    /// All of those, by their ids.
    done: BTreeSet<Hash>,
    /// Leader of each term: there is never a second.
    pub leaders: BTreeMap<u64, u64>,
    /// The course of the run as text; equal for equal seeds.
    pub trace: u64,
    /// The members that the ledger wants.
    pub desired: Option<Desired>,
    /// How often nodes were told that they are behind, and what they did.
    pub behind: catch_up::Counts,
    /// The times of nodes that start.
    pub timing: Timing,
    segment_bytes: u64,
    /// Blocks that were chosen when a read was asked for; its answer names no earlier one.
    asked: BTreeMap<(u64, u64), u64>,
    /// The document, and the network's name.
    genesis: (Bytes, Hash),
    founders: Membership,
    current: Membership,
    events: BTreeMap<(u64, u64), (u64, u64, Event)>,
    sequence: u64,
}

impl Cluster {
    pub fn new(seed: u64, voters: &[u64], learners: &[u64]) -> Self {
        Self::with_segments(seed, voters, learners, 256 * 1024)
    }

    /// Small segments, so that there are old ones to drop.
    pub fn with_segments(seed: u64, voters: &[u64], learners: &[u64], segment_bytes: u64) -> Self {
        Self::with_timing(seed, (voters, learners), segment_bytes, Timing::default().data_wait)
    }

    /// With another longest time that data waits.
    pub fn with_timing(seed: u64, (voters, learners): (&[u64], &[u64]), segment_bytes: u64, data_wait: u64) -> Self {
        let founders = Membership::new(voters.iter().copied(), learners.iter().copied());
        let mut cluster = Self {
            nodes: BTreeMap::new(),
            now: 0,
            ahead: BTreeMap::new(),
            withholds: None,
            complaints: 0,
            deceived: None,
            random: Random::seeded(seed),
            faults: CALM,
            cut: BTreeSet::new(),
            chosen: Vec::new(),
            digests: Vec::new(),
            executed: Vec::new(),
            done: BTreeSet::new(),
            leaders: BTreeMap::new(),
            trace: 0,
            desired: None,
            behind: catch_up::Counts::default(),
            timing: Timing { tick: TICK * UNIT, election_ticks: 20, data_wait },
            segment_bytes,
            asked: BTreeMap::new(),
            genesis: genesis(&founders, EPOCH),
            current: founders.clone(),
            founders,
            events: BTreeMap::new(),
            sequence: 0,
        };
        for id in voters.iter().chain(learners) {
            cluster.join(*id);
        }
        cluster
    }

    fn network(&self) -> Hash {
        self.genesis.1
    }

    /// The clock of a machine that is right.
    pub fn time(&self) -> u64 {
        EPOCH + self.now
    }

    fn wall(&self, id: u64) -> u64 {
        self.time().saturating_add_signed(self.ahead.get(&id).copied().unwrap_or(0))
    }

    /// An operator says that the clock of a node is right.
    pub fn confirm_clock(&self, id: u64) {
        let up = self.nodes[&id].up.as_ref().unwrap();
        up.clock.confirm(self.wall(id), self.now);
    }

    /// A new, empty node that knows the genesis.
    pub fn join(&mut self, id: u64) {
        let node = Node::new(id, self.random.number(), self.founders.clone());
        self.nodes.insert(id, node);
        self.start(id);
    }

    pub fn start(&mut self, id: u64) {
        let (salt, now) = (self.random.number(), self.now);
        let node = self.nodes.get_mut(&id).unwrap();
        node.open(&self.genesis, self.segment_bytes, salt, now);
        let height = self.height(id);
        let members = self.founders.clone().fold(&self.chosen[..height as usize]);
        assert_eq!(self.nodes[&id].members, members, "a start knows the members of its height");
        self.begin(id);
    }

    /// Power fails at one node.
    pub fn crash(&mut self, id: u64) {
        let Some(up) = &self.nodes[&id].up else { return };
        // The world state is stored up to any height that the log has durably.
        let stored = up.ledger().state().stored().map_or(0, |tip| tip.height);
        let durable = up.store.durable_index().min(up.ledger().tip().height);
        let up_to = stored + self.random.below(durable.saturating_sub(stored) + 1);
        up.ledger().flush_up_to(up_to, Some(&up.snapshots)).unwrap();
        self.nodes.get_mut(&id).unwrap().lose_power();
    }

    fn schedule(&mut self, node: u64, delay: u64, event: Event) {
        let start = self.nodes.get(&node).map_or(0, |node| node.start);
        self.sequence += 1;
        self.events.insert((self.now + delay, self.sequence), (node, start, event));
    }

    /// A client waits at a node for the verdict on a transaction; answers with its bytes.
    pub fn awaited(&mut self, id: u64, lane: Lane, text: &str) -> Option<Bytes> {
        let (network, now) = (self.network(), self.wall(id));
        let up = self.nodes.get(&id)?.up.as_ref()?;
        let now = up.clock.at(now, self.now);
        let function = if text == "alarm" { "alarm" } else { "note" };
        let transaction = call(&PEOPLE.salma, network, now, ("notes", function), Bytes::from(text.to_owned()));
        up.waiters.add(self.now, &transaction, lane, up.client(text));
        Some(transaction.encoded().clone())
    }

    /// The ledger wants these members from now on.
    pub fn want(&mut self, desired: Desired) {
        self.desired = Some(desired.clone());
        let all: Vec<u64> = self.nodes.keys().copied().collect();
        for id in all {
            self.step(id, replica::Event::Wanted(desired.clone()));
        }
    }

    fn note(&mut self, id: u64, effect: &Effect) {
        for byte in format!("{} {id} {effect:?}", self.now).bytes() {
            self.trace = (self.trace ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    /// Handles everything up to a moment.
    pub fn run_units(&mut self, units: u64) {
        let until = self.now + units * UNIT;
        while let Some(entry) = self.events.first_entry() {
            if entry.key().0 > until {
                break;
            }
            let ((at, _), (id, start, event)) = entry.remove_entry();
            self.now = at;
            let Some(node) = self.nodes.get_mut(&id).filter(|node| node.up.is_some()) else { continue };
            if let Some(held) = &mut node.held {
                held.push(event);
                continue;
            }
            let current = node.start == start;
            match event {
                // A message of before a restart may still come.
                Event::Deliver { from, to, bytes } => {
                    let mut message = PeerMessage::decode(bytes).unwrap();
                    if let PeerMessage::Raft(answer) = &mut message
                        && self.deceived == Some(to)
                    {
                        answer.accepts_until = u64::MAX;
                    }
                    self.input(to, Input::Message { from, message });
                }
                Event::Input(input) => self.input(id, *input),
                Event::Turn if current => self.turn(id, []),
                Event::Written if current => self.written(id),
                Event::Execute if current => self.execute_given(id),
                Event::Store if current => self.store_state(id),
                _ => {}
            }
        }
        self.now = until;
    }

    pub fn run(&mut self, ticks: u64) {
        self.run_units(ticks * TICK);
    }

    /// Runs until the condition holds.
    pub fn until(&mut self, what: &str, ticks: u64, condition: impl Fn(&Self) -> bool) {
        for _ in 0..ticks * TICK {
            if condition(self) {
                return;
            }
            self.run_units(1);
        }
        let status: Vec<_> = self.running().map(|id| self.status(id)).collect();
        panic!("not within {ticks} ticks: {what}; {status:#?}");
    }

    fn running(&self) -> impl Iterator<Item = u64> {
        self.nodes.values().filter(|node| node.up.is_some()).map(|node| node.id)
    }

    /// The node that leads and may propose.
    pub fn leader(&self) -> Option<u64> {
        let leading = self.running().map(|id| self.status(id)).filter(|status| status.may_propose);
        leading.max_by_key(|status| status.role.term).map(|status| status.id)
    }

    pub fn elect(&mut self) -> u64 {
        self.until("somebody leads", 400, |cluster| cluster.leader().is_some());
        self.leader().unwrap()
    }

    /// How ordering stands at a node that runs.
    pub fn status(&self, id: u64) -> Status {
        self.nodes[&id].up.as_ref().unwrap().replica.as_ref().unwrap().status()
    }

    /// The height that a node has executed; 0 while it does not run.
    pub fn height(&self, id: u64) -> u64 {
        self.nodes[&id].up.as_ref().map_or(0, |up| up.ledger().tip().height)
    }

    /// The transactions that a node has executed, in order.
    pub fn executed_by(&self, id: u64) -> Vec<String> {
        self.executed[..self.height(id) as usize].concat()
    }

    pub fn has_executed(&self, id: u64, text: &str) -> bool {
        self.executed[..self.height(id) as usize].iter().rev().flatten().any(|found| found == text)
    }

    /// Is a transaction in the log of a node, executed or not?
    pub fn holds(&self, id: u64, text: &str) -> bool {
        let store = &self.nodes[&id].up.as_ref().unwrap().store;
        let entries = store.entries(store.first_index()..store.last_index() + 1, usize::MAX).unwrap();
        transactions(&entries).iter().any(|found| found == text)
    }

    /// The members after everything that is committed.
    pub fn members(&self) -> Membership {
        self.current.clone()
    }

    /// All live members hold the same chain, which is everything that was ever committed.
    pub fn converged(&self) -> bool {
        let mut live = self.running().filter(|id| self.current.contains(*id));
        live.all(|id| self.height(id) == self.chosen.len() as u64)
    }

    /// Logs that agree on index and term agree on everything up to there.
    pub fn check_log_matching(&self) {
        let stores: Vec<_> = self.nodes.values().filter_map(|node| Some(&node.up.as_ref()?.store)).collect();
        for (nth, one) in stores.iter().enumerate() {
            for other in stores.iter().skip(nth + 1) {
                let range = one.first_index().max(other.first_index())..one.last_index().min(other.last_index()) + 1;
                if range.is_empty() {
                    continue;
                }
                let [one, other] = [one, other].map(|store| store.entries(range.clone(), usize::MAX).unwrap());
                let common = one.iter().zip(&other).rposition(|(a, b)| a.term == b.term).map_or(0, |last| last + 1);
                assert_eq!(one[..common], other[..common]);
            }
        }
    }
}

/// The transactions in these blocks, executed or not.
pub fn transactions<'a>(entries: impl IntoIterator<Item = &'a Entry>) -> Vec<String> {
    let blocks = entries.into_iter().filter(|entry| entry.kind == EntryKind::Normal);
    let all = blocks.flat_map(|entry| Payload::from_bytes(entry.data.clone()).unwrap().transactions);
    all.map(|bytes| text(&bytes)).collect()
}

/// The text of a transaction; bytes that are none stand for themselves.
fn text(bytes: &Bytes) -> String {
    let transaction = Transaction::decode(bytes.clone());
    let argument = transaction.map(|transaction| transaction.body().args[0].clone());
    String::from_utf8_lossy(&argument.unwrap_or_else(|_| bytes.clone())).into_owned()
}
