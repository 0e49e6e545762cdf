//! The threads of a node: events into its replica, whose effects are carried out.

use super::names::Names;
use super::{Cluster, Event, UNIT};
use ledger_base::rejection::Code;
use ledger_raft::{Input, Lane, PeerMessage, Role, Secret};
use ledger_replica::catch_up::Behind;
use ledger_replica::{self as replica, Circumstances, Effect, Now, Replica, Settings, Work};
use ledger_storage::entry::{Entry, EntryKind};
use std::sync::Arc;

/// A thread that is woken at once needs so long, microseconds.
const WAKE: u64 = 100;
/// The world state is stored so often, microseconds.
const STORE_PERIOD: u64 = 100_000;

/// The secret behind a node's receipts.
pub(super) fn secret(id: u64) -> Secret {
    Secret([u8::try_from(id).unwrap_or(0); 32])
}

impl Cluster {
    /// Both clocks of a node.
    fn clocks(&self, id: u64) -> Now {
        let up = self.nodes[&id].up.as_ref();
        let (wall, elapsed) = (self.wall(id), self.now);
        let Some(clock) = up.map(|up| &up.clock) else {
            return Now { clock: 0, elapsed, accepts_until: 0, doubt: None };
        };
        let (accepts_until, doubt) = (clock.accepts_until(wall, elapsed), clock.doubt(wall, elapsed));
        Now { clock: clock.at(wall, elapsed), elapsed, accepts_until, doubt }
    }

    /// An engine starts in a process that runs.
    pub(super) fn begin(&mut self, id: u64) {
        let settings = Settings { id, seed: self.random.number(), timing: self.timing, secret: secret(id) };
        let desired = self.desired.clone().unwrap_or_default();
        let node = self.nodes.get_mut(&id).unwrap();
        let up = node.up.as_mut().unwrap();
        let (store, executor, waiters) = (Arc::clone(&up.store), Arc::clone(&up.executor), Arc::clone(&up.waiters));
        up.replica = Some(Replica::start(&settings, store, executor, waiters, desired, Arc::new(Names)).unwrap());
        (up.writing, up.turn_at) = (false, u64::MAX);
        node.start += 1;
        self.schedule(id, UNIT, Event::Turn);
        self.schedule(id, STORE_PERIOD, Event::Store);
    }

    /// Hands an input to a node. One that is stopped finds it when it goes on.
    pub fn input(&mut self, id: u64, input: Input) {
        let chosen = self.chosen.len() as u64;
        let Some(node) = self.nodes.get_mut(&id).filter(|node| node.up.is_some()) else { return };
        if let Input::ReadIndex { context } = input {
            self.asked.insert((id, context), chosen);
        }
        match &mut node.held {
            Some(held) => held.push(Event::Input(Box::new(input))),
            None => self.turn(id, [replica::Event::Input(input)]),
        }
    }

    /// A client submits a transaction through a node, and waits there for its verdict.
    pub fn submit(&mut self, id: u64, lane: Lane, text: &str) {
        if let Some(transaction) = self.awaited(id, lane, text) {
            self.input(id, Input::Submit { lane, transaction });
        }
    }

    /// One turn of the order thread: what has come in, what is due, the write, execution.
    pub(super) fn turn(&mut self, id: u64, events: impl IntoIterator<Item = replica::Event>) {
        for event in events {
            self.step(id, event);
        }
        self.step(id, replica::Event::Time { full: false });
        self.write(id);
        self.execute_committed(id);
        self.sleep(id);
    }

    pub(super) fn step(&mut self, id: u64, event: replica::Event) {
        let now = self.clocks(id);
        let node = self.nodes.get_mut(&id).unwrap();
        let start = node.start;
        let Some(replica) = node.up.as_mut().and_then(|up| up.replica.as_mut()) else { return };
        let mut effects = Vec::new();
        replica.step(now, event, &mut effects);
        for effect in effects {
            // Nothing that comes after the end of an engine is carried out.
            let node = &self.nodes[&id];
            if node.up.is_some() && node.start == start {
                self.carry_out(id, effect);
            }
        }
        self.hear(id);
    }

    fn carry_out(&mut self, id: u64, effect: Effect) {
        self.note(id, &effect);
        let node = self.nodes.get_mut(&id).unwrap();
        match effect {
            Effect::Send { to, message } => self.send(id, to, &message),
            Effect::Status(_) | Effect::Reconciles(_) | Effect::Denied(_) | Effect::Ignored { .. } => {}
            Effect::Misbehaved(proof) => panic!("an honest node is called a liar: {proof:?}"),
            Effect::Contradicted(found) => panic!("honest nodes contradict each other: {found:?}"),
            Effect::Role(change) if change.role == Role::Leader => {
                let leader = *self.leaders.entry(change.term).or_insert(id);
                assert_eq!(leader, id, "two leaders in term {}", change.term);
            }
            Effect::Role(_) => {}
            Effect::Members { height, membership } => {
                node.members = membership.clone();
                node.up.as_mut().unwrap().told.insert(height, membership);
            }
            Effect::Read { context, answer: Ok(index) } => {
                assert!(index >= self.asked[&(id, context)], "a read at node {id} sees what was there before it");
                node.reads.push((context, index));
            }
            Effect::Read { .. } => {}
            Effect::Refused { input, reason } => node.refused.push((*input, reason)),
            Effect::Behind { from, first_index } => self.catch_up(id, Behind { from, first_index }),
            Effect::Failed(reason) => {
                node.failed = Some(reason);
                node.end();
            }
        }
    }

    fn send(&mut self, id: u64, to: u64, message: &PeerMessage) {
        let lost = self.random.percent(self.faults.lose) || self.cut.contains(&(id, to));
        let copies = 1 + u64::from(self.random.percent(self.faults.duplicate));
        for _ in 0..if lost { 0 } else { copies } {
            let delay = 1 + self.random.below(self.faults.delay_max);
            self.schedule(to, delay * UNIT, Event::Deliver { from: id, to, bytes: message.to_bytes() });
        }
    }

    /// The log is to be written if the replica says so: that takes time.
    fn write(&mut self, id: u64) {
        let now = self.clocks(id);
        let Some(up) = self.nodes.get_mut(&id).unwrap().up.as_mut() else { return };
        let due = up.replica.as_ref().is_some_and(|replica| replica.must_write(now));
        if due && !std::mem::replace(&mut up.writing, true) {
            let delay = 1 + self.random.below(self.faults.disk_max);
            self.schedule(id, delay * UNIT, Event::Written);
        }
    }

    /// The log is written.
    pub(super) fn written(&mut self, id: u64) {
        let up = self.nodes.get_mut(&id).unwrap().up.as_mut().unwrap();
        up.writing = false;
        let written = up.store.flush().map(drop);
        self.turn(id, [replica::Event::Written(written)]);
    }

    /// Committed blocks are executed here, or given to the execute thread.
    fn execute_committed(&mut self, id: u64) {
        let node = self.nodes.get_mut(&id).unwrap();
        let Some(up) = node.up.as_mut() else { return };
        let Some(replica) = up.replica.as_mut() else { return };
        let other_is_idle = up.given.is_empty() && !node.stalled;
        match replica.work(Circumstances { inputs_wait: false, other_is_idle }) {
            None => {}
            Some(Work::Here(entries)) => {
                let height = entries.last().unwrap().index;
                self.execute(id, &entries);
                self.step(id, replica::Event::Executed { height, took: 1 });
            }
            Some(Work::Elsewhere(entries)) => {
                up.given.extend(entries);
                self.schedule(id, UNIT, Event::Execute);
            }
        }
    }

    /// The execute thread executes everything that it was given.
    pub(super) fn execute_given(&mut self, id: u64) {
        let at = self.clocks(id).clock;
        let node = self.nodes.get_mut(&id).unwrap();
        let given = match &mut node.up {
            Some(up) if !node.stalled => std::mem::take(&mut up.given),
            _ => return,
        };
        self.execute(id, &given);
        if let Some(last) = given.last() {
            self.turn(id, [replica::Event::Input(Input::Applied { height: last.index, at })]);
        }
    }

    /// Executes blocks, and compares them with what others have executed.
    pub(super) fn execute(&mut self, id: u64, entries: &[Entry]) {
        let executor = Arc::clone(&self.nodes[&id].up.as_ref().unwrap().executor);
        for entry in entries {
            self.execute_one(id, &executor, entry);
        }
        executor.look_at_deadline();
        self.hear(id);
    }

    pub(super) fn execute_one(&mut self, id: u64, executor: &replica::Executor, entry: &Entry) {
        let outcome = executor.execute(entry).unwrap();
        let up = self.nodes.get_mut(&id).unwrap().up.as_mut().unwrap();
        up.clock.observe(outcome.header.time, self.now);
        let members = executor.ledger().members().unwrap();
        if let Some(told) = up.told.remove(&entry.index) {
            assert_eq!(told, members, "node {id} has told the members of its ledger");
        }
        let nth = entry.index as usize - 1;
        match self.chosen.get(nth) {
            Some(chosen) => {
                assert_eq!(chosen, entry, "node {id} executes what was committed");
                assert_eq!(self.digests[nth], (outcome.hash, outcome.digest), "node {id} computes what others did");
            }
            None => {
                assert_eq!(self.chosen.len(), nth, "node {id} executes in order");
                let executed = outcome.ids.iter().zip(&outcome.results).zip(&outcome.transactions);
                let executed = executed.filter(|((_, result), _)| result.code() == Code::Ok);
                let mut texts = Vec::new();
                for ((transaction, _), bytes) in executed {
                    assert!(self.done.insert(*transaction), "{transaction} is executed once");
                    texts.push(super::text(bytes));
                }
                self.chosen.push(entry.clone());
                self.digests.push((outcome.hash, outcome.digest));
                self.executed.push(texts);
                if entry.kind != EntryKind::Normal {
                    self.current = self.current.after(entry).unwrap_or_else(|| self.current.clone());
                }
                assert_eq!(self.current, members, "the members follow from the log");
            }
        }
    }

    /// Results, world state and snapshots are stored.
    pub(super) fn store_state(&mut self, id: u64) {
        let up = self.nodes[&id].up.as_ref().unwrap();
        up.ledger().flush_up_to(up.store.durable_index(), Some(&up.snapshots)).unwrap();
        self.schedule(id, STORE_PERIOD, Event::Store);
    }

    /// The clients of a node hear their answers: who is told a verdict finds it on the chain.
    fn hear(&mut self, id: u64) {
        let node = self.nodes.get_mut(&id).unwrap();
        let Some(up) = &node.up else { return };
        for (text, code, height) in up.answers.1.try_iter() {
            match height {
                0 => node.dropped.push((text, code)),
                height if code == Code::Ok => {
                    assert!(self.executed[height as usize - 1].contains(&text), "{text} is in block {height}");
                }
                _ => {}
            }
        }
    }

    /// When the order thread is to be woken, if nothing comes in before.
    fn sleep(&mut self, id: u64) {
        let now = self.clocks(id);
        let tick = self.timing.tick;
        let Some(up) = self.nodes.get_mut(&id).unwrap().up.as_mut() else { return };
        let Some(replica) = &up.replica else { return };
        // The write that it waits for is under way.
        let wait = if up.writing { tick } else { replica.wait(now).max(WAKE) };
        let at = self.now.saturating_add(wait);
        if at < up.turn_at || up.turn_at <= self.now {
            up.turn_at = at;
            self.schedule(id, wait, Event::Turn);
        }
    }
}
