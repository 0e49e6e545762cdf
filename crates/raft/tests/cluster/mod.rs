//! A cluster in one thread: virtual time, messages in a queue, disks that lose what was not flushed. The seed decides
//! everything, so a failing run can be repeated. Invariants are checked at every step.
#![allow(dead_code, unreachable_pub, clippy::allow_attributes, reason = "each test file uses its own part")]

mod catch_up;

use bytes::Bytes;
use ledger::block::Payload;
use ledger_raft::{Desired, Engine, EngineConfig, Input, Lane, Membership, Output, PeerMessage, Role, next_step};
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use testkit::Random;

/// Units of virtual time in a tick.
pub const TICK: u64 = 10;

/// The fate of a message in the network. Percent, and units of time.
#[derive(Clone, Copy)]
pub struct Faults {
    pub lose: u64,
    pub duplicate: u64,
    pub delay_max: u64,
    pub disk_max: u64,
}

pub const CALM: Faults = Faults { lose: 0, duplicate: 0, delay_max: 1, disk_max: 1 };

enum Event {
    Deliver { from: u64, to: u64, bytes: Bytes },
    Tick,
    Flush { ready: u64 },
    Apply { height: u64 },
}

pub struct Node {
    pub id: u64,
    pub disk: SimDisk,
    pub up: Option<(Engine, Arc<BlockStore>)>,
    /// Counts starts; events of an earlier one are void.
    start: u64,
    /// The state machine: every block executed, in order.
    pub state: Vec<Entry>,
    /// How much of it survives a crash.
    saved: usize,
    pub dropped: Vec<(Bytes, ledger_rejection::Code)>,
    pub refused: Vec<(Input, ledger_rejection::Rejection)>,
    pub reads: Vec<(u64, u64)>,
    pub members: Membership,
    /// The event that is due when a process that is stopped goes on; none while it runs.
    held: Option<Vec<Event>>,
    /// Why the engine has stopped for good.
    pub failed: Option<ledger_rejection::Rejection>,
}

pub struct Cluster {
    pub nodes: BTreeMap<u64, Node>,
    pub now: u64,
    pub random: Random,
    pub faults: Faults,
    /// Directed links that lose everything.
    pub cut: BTreeSet<(u64, u64)>,
    /// Every committed entry that any node has executed: it never changes.
    pub chosen: Vec<Entry>,
    /// Leader of each term: there is never a second.
    pub leaders: BTreeMap<u64, u64>,
    /// The course of the run as text; equal for equal seeds.
    pub trace: u64,
    pub commits_per_step_max: usize,
    /// The members that the ledger wants; a leader sees to it with every tick.
    pub desired: Option<Desired>,
    /// How often nodes were told that they are behind, and what they did.
    pub behind: catch_up::Counts,
    segment_bytes: u64,
    /// Blocks that were chosen when a read was asked for; its answer names no earlier one.
    asked: BTreeMap<(u64, u64), u64>,
    genesis: Membership,
    current: Membership,
    events: BTreeMap<(u64, u64), (u64, u64, Event)>,
    sequence: u64,
    /// Changes an engine's configuration before it starts.
    pub configure: fn(&mut EngineConfig),
}

impl Cluster {
    pub fn new(seed: u64, voters: &[u64], learners: &[u64]) -> Self {
        Self::with_segments(seed, voters, learners, 32 * 1024)
    }

    /// Small segments, so that there are old ones to drop.
    pub fn with_segments(seed: u64, voters: &[u64], learners: &[u64], segment_bytes: u64) -> Self {
        let genesis = Membership::new(voters.iter().copied(), learners.iter().copied());
        let mut cluster = Self {
            nodes: BTreeMap::new(),
            now: 1_000_000,
            random: Random::seeded(seed),
            faults: CALM,
            cut: BTreeSet::new(),
            chosen: Vec::new(),
            leaders: BTreeMap::new(),
            trace: 0,
            commits_per_step_max: 0,
            desired: None,
            behind: catch_up::Counts::default(),
            segment_bytes,
            asked: BTreeMap::new(),
            current: genesis.clone(),
            genesis,
            events: BTreeMap::new(),
            sequence: 0,
            configure: |_| {},
        };
        for id in voters.iter().chain(learners) {
            cluster.join(*id);
        }
        cluster
    }

    /// A new, empty node that knows the genesis.
    pub fn join(&mut self, id: u64) {
        let node = Node {
            id,
            disk: SimDisk::new(self.random.number()),
            up: None,
            start: 0,
            state: Vec::new(),
            saved: 0,
            dropped: Vec::new(),
            refused: Vec::new(),
            reads: Vec::new(),
            members: self.genesis.clone(),
            held: None,
            failed: None,
        };
        self.nodes.insert(id, node);
        self.start(id);
    }

    pub fn start(&mut self, id: u64) {
        let (seed, salt, configure, genesis) =
            (self.random.number(), self.random.number(), self.configure, self.genesis.clone());
        let segment_bytes = self.segment_bytes;
        let node = self.nodes.get_mut(&id).unwrap();
        assert!(node.up.is_none());
        let mut options = Options::new([7; 32], move || salt);
        options.segment_bytes = segment_bytes;
        let (store, _) = BlockStore::open(Arc::new(node.disk.clone()), options).unwrap();
        let store = Arc::new(store);
        node.members = genesis.clone().fold(&node.state);
        let mut config = EngineConfig::new(id, node.members.clone(), seed);
        config.applied = node.state.len() as u64;
        configure(&mut config);
        let engine = Engine::new(config, Arc::clone(&store)).unwrap();
        node.up = Some((engine, store));
        node.start += 1;
        self.schedule(id, 1, Event::Tick);
    }

    /// Power fails at one node: what is not flushed is lost, what is being written is torn.
    pub fn crash(&mut self, id: u64) {
        let node = self.nodes.get_mut(&id).unwrap();
        let durable = node.up.take().map_or(0, |(_, store)| store.durable_index() as usize);
        node.held = None;
        node.disk.crash();
        // A driver saves nothing that the log on the disk does not have.
        let unsaved = node.state.len().min(durable).saturating_sub(node.saved) as u64;
        node.saved += self.random.below(unsaved + 1) as usize;
        node.state.truncate(node.saved);
    }

    fn schedule(&mut self, node: u64, delay: u64, event: Event) {
        let start = self.nodes.get(&node).map_or(0, |node| node.start);
        self.sequence += 1;
        self.events.insert((self.now + delay, self.sequence), (node, start, event));
    }

    pub fn input(&mut self, id: u64, input: Input) {
        let (now, chosen) = (self.now, self.chosen.len() as u64);
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let (start, Some((engine, _))) = (node.start, node.up.as_mut()) else { return };
        if let Input::ReadIndex { context } = input {
            self.asked.insert((id, context), chosen);
        }
        let mut out = Vec::new();
        engine.step(now, input, &mut out);
        for output in out {
            if self.nodes[&id].start != start {
                // The engine has ended; so has what it still wanted.
                break;
            }
            self.output(id, output);
        }
    }

    /// The work of the leader's driver with every tick.
    fn reconcile(&mut self, id: u64) {
        let Some((engine, _)) = &self.nodes[&id].up else { return };
        if let Some(step) = self.desired.as_ref().and_then(|desired| next_step(desired, &engine.status())) {
            self.input(id, step);
        }
    }

    pub fn submit(&mut self, id: u64, lane: Lane, transaction: &str) {
        self.input(id, Input::Submit { lane, transaction: Bytes::from(transaction.to_owned()) });
    }

    fn note(&mut self, id: u64, output: &Output) {
        for byte in format!("{} {id} {output:?}", self.now).bytes() {
            self.trace = (self.trace ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn output(&mut self, id: u64, output: Output) {
        self.note(id, &output);
        match output {
            Output::Send { to, message } => {
                let lost = self.random.percent(self.faults.lose) || self.cut.contains(&(id, to));
                let copies = 1 + u64::from(self.random.percent(self.faults.duplicate));
                for _ in 0..if lost { 0 } else { copies } {
                    let delay = 1 + self.random.below(self.faults.delay_max);
                    self.schedule(to, delay, Event::Deliver { from: id, to, bytes: message.to_bytes() });
                }
            }
            Output::Flush { ready } => {
                let delay = 1 + self.random.below(self.faults.disk_max);
                self.schedule(id, delay, Event::Flush { ready });
            }
            Output::Commit(entries) => {
                for entry in entries {
                    self.executed(id, entry);
                }
                let height = self.nodes[&id].state.len() as u64;
                self.schedule(id, 1, Event::Apply { height });
            }
            Output::Role(change) => {
                if change.role == Role::Leader {
                    let leader = *self.leaders.entry(change.term).or_insert(id);
                    assert_eq!(leader, id, "two leaders in term {}", change.term);
                }
            }
            Output::Membership { height, membership } => {
                let node = self.nodes.get_mut(&id).unwrap();
                node.members = membership;
                assert_eq!(node.members, self.genesis.clone().fold(&node.state[..height as usize]));
            }
            Output::ReadReady { context, index } => {
                assert!(index >= self.asked[&(id, context)], "a read at node {id} sees what was there before it");
                self.nodes.get_mut(&id).unwrap().reads.push((context, index));
            }
            Output::Behind { first_index, .. } => self.catch_up(id, first_index),
            Output::Ignored { .. } => {}
            Output::Dropped { transaction, reason } => {
                self.nodes.get_mut(&id).unwrap().dropped.push((transaction, reason.code));
            }
            Output::Refused { input, reason } => self.nodes.get_mut(&id).unwrap().refused.push((*input, reason)),
            Output::Failed(reason) => self.nodes.get_mut(&id).unwrap().failed = Some(reason),
        }
    }

    fn executed(&mut self, id: u64, entry: Entry) {
        let node = self.nodes.get_mut(&id).unwrap();
        assert_eq!(entry.index, node.state.len() as u64 + 1, "node {id} executes in order, once");
        match self.chosen.get(node.state.len()) {
            Some(chosen) => assert_eq!(*chosen, entry, "node {id} executes what was committed"),
            None => {
                self.current = self.current.after(&entry).unwrap_or_else(|| self.current.clone());
                self.chosen.push(entry.clone());
            }
        }
        node.state.push(entry);
    }

    /// Handles everything up to a moment.
    pub fn run_units(&mut self, units: u64) {
        let until = self.now + units;
        while let Some(entry) = self.events.first_entry() {
            if entry.key().0 > until {
                break;
            }
            let ((at, _), (id, start, event)) = entry.remove_entry();
            self.now = at;
            if let Some(held) = self.nodes.get_mut(&id).and_then(|node| node.held.as_mut()) {
                held.push(event);
                continue;
            }
            let alive = self.nodes.get(&id).is_some_and(|node| node.up.is_some() && node.start == start);
            match event {
                // A message of before a restart may still come.
                Event::Deliver { from, to, bytes } => {
                    let message = PeerMessage::decode(bytes).unwrap();
                    self.input(to, Input::Message { from, message });
                }
                _ if !alive => {}
                Event::Tick => {
                    self.schedule(id, TICK, Event::Tick);
                    self.input(id, Input::Tick);
                    self.reconcile(id);
                }
                Event::Flush { ready } => {
                    self.nodes[&id].up.as_ref().unwrap().1.flush().unwrap();
                    self.input(id, Input::Persisted { ready });
                }
                Event::Apply { height } => self.input(id, Input::Applied { height, at: self.now }),
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
        let status: Vec<_> = self.nodes.values().filter_map(|node| Some(node.up.as_ref()?.0.status())).collect();
        panic!("not within {ticks} ticks: {what}; {status:#?}");
    }

    /// The node that leads and may propose.
    pub fn leader(&self) -> Option<u64> {
        let mut leading: Vec<_> = self
            .nodes
            .values()
            .filter_map(|node| Some((&node.up.as_ref()?.0, node.id)))
            .filter(|(engine, _)| engine.status().may_propose)
            .collect();
        leading.sort_by_key(|(engine, _)| engine.status().role.term);
        leading.last().map(|(_, id)| *id)
    }

    pub fn elect(&mut self) -> u64 {
        self.until("somebody leads", 400, |cluster| cluster.leader().is_some());
        self.leader().unwrap()
    }

    pub fn engine(&self, id: u64) -> &Engine {
        &self.nodes[&id].up.as_ref().unwrap().0
    }

    /// The transactions that a node has executed, in order.
    pub fn executed_by(&self, id: u64) -> Vec<String> {
        transactions(&self.nodes[&id].state)
    }

    pub fn has_executed(&self, id: u64, transaction: &str) -> bool {
        self.nodes[&id].state.iter().rev().any(|entry| transactions([entry]).iter().any(|found| found == transaction))
    }

    /// The members after everything that is committed.
    pub fn members(&self) -> Membership {
        self.current.clone()
    }

    /// All live members hold the same chain, which is everything that was ever committed.
    pub fn converged(&self) -> bool {
        let members = self.members();
        let live = self.nodes.values().filter(|node| node.up.is_some() && members.contains(node.id));
        live.into_iter().all(|node| node.state.len() == self.chosen.len())
    }

    /// Logs that agree on index and term agree on everything up to there.
    pub fn check_log_matching(&self) {
        let stores: Vec<_> = self.nodes.values().filter_map(|node| Some(&node.up.as_ref()?.1)).collect();
        for (nth, one) in stores.iter().enumerate() {
            for other in stores.iter().skip(nth + 1) {
                let range = one.first_index().max(other.first_index())..one.last_index().min(other.last_index()) + 1;
                let [one, other] = [one, other].map(|store| store.entries(range.clone(), usize::MAX).unwrap());
                let common = one.iter().zip(&other).rposition(|(a, b)| a.term == b.term).map_or(0, |last| last + 1);
                assert_eq!(one[..common], other[..common]);
            }
        }
    }
}

pub fn transactions<'a>(entries: impl IntoIterator<Item = &'a Entry>) -> Vec<String> {
    entries
        .into_iter()
        .filter(|entry| entry.kind == EntryKind::Normal)
        .flat_map(|entry| Payload::from_bytes(entry.data.clone()).unwrap().transactions)
        .map(|transaction| String::from_utf8(transaction.to_vec()).unwrap())
        .collect()
}
