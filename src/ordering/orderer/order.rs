//! The order thread: owns the replica, writes the log, carries out what is to be done.

use super::execute::Execute;
use super::inbox::Inbox;
use super::{Engines, Reign};
use crate::ordering::directory::Member;
use crate::ordering::waiters::Client;
use ledger_raft::{Change, Input, Role, RoleChange, Status};
use ledger_replica::catch_up::Behind;
use ledger_replica::{Circumstances, Effect, Event, Last, Replica, Work};
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Inputs taken before the log is written, so that a flood cannot put off the write.
const INPUTS_PER_WRITE_MAX: usize = 4096;
/// Inputs that come while the log is written when there is much to do.
const MANY_INPUTS: usize = 8;

/// The order thread.
pub(super) struct Order {
    replica: Replica<Client>,
    engines: Arc<Engines>,
    execute: Execute,
    /// To the execute thread.
    blocks: Arc<Inbox<Entry>>,
    effects: Vec<Effect>,
    status: Arc<Mutex<Status>>,
    role: watch::Sender<Reign>,
    /// The members of the network, to notice when they change.
    members: watch::Receiver<Arc<[Member]>>,
    /// Why messages of a peer were ignored last.
    ignored: BTreeMap<u64, &'static str>,
    /// The node cannot go on.
    failed: bool,
}

impl Order {
    pub(super) fn new(
        replica: Replica<Client>,
        engines: &Arc<Engines>,
        execute: Execute,
        blocks: &Arc<Inbox<Entry>>,
        status: Arc<Mutex<Status>>,
        role: watch::Sender<Reign>,
    ) -> Self {
        let (blocks, effects, failed) = (Arc::clone(blocks), Vec::new(), false);
        let ignored = BTreeMap::new();
        let engines = Arc::clone(engines);
        let mut members = engines.directory.subscribe();
        // The replica may have been told before the last change.
        members.mark_changed();
        Self { replica, engines, execute, blocks, effects, status, role, members, ignored, failed }
    }

    /// Until the inbox is closed, or the node cannot go on.
    pub(super) fn run(mut self, inputs: &Inbox<Input>) {
        // However this thread ends: it takes nothing in any more, and the other one ends after what it was given.
        let blocks = Arc::clone(&self.blocks);
        let _ends = (inputs.close_at_end(), blocks.close_at_end());
        while !inputs.is_closed() {
            inputs.wait(Duration::from_micros(self.replica.wait(self.engines.clock.both())));
            let mut taken = 0;
            while taken < INPUTS_PER_WRITE_MAX && !inputs.is_empty() {
                let waiting = inputs.take();
                taken += waiting.len();
                waiting.into_iter().for_each(|input| self.step(Event::Input(input)));
            }
            self.engines.turns.adapt(taken >= MANY_INPUTS);
            self.follow_members();
            self.step(Event::Time { full: self.engines.log.space.is_full() });
            if self.replica.must_write(self.engines.clock.both()) {
                self.write();
            }
            // What waits already is to be ordered while the other thread executes.
            self.execute(!inputs.is_empty());
            if self.failed {
                return;
            }
        }
        while let Some(last) = self.replica.end() {
            match last {
                Last::Write => self.write(),
                Last::Execute(_) if self.failed => {}
                Last::Execute(entries) => self.execute.hand_over(&self.blocks, entries),
            }
        }
    }

    /// Executes what was committed, or has it executed.
    fn execute(&mut self, inputs_wait: bool) {
        match self.replica.work(Circumstances { inputs_wait, other_is_idle: self.execute.is_idle() }) {
            _ if self.failed => {}
            None => {}
            Some(Work::Elsewhere(entries)) => self.execute.hand_over(&self.blocks, entries),
            Some(Work::Here(entries)) => {
                let start = Instant::now();
                self.failed = !self.execute.execute(&entries);
                let took = u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
                if let Some(height) = entries.last().map(|entry| entry.index).filter(|_| !self.failed) {
                    self.step(Event::Executed { height, took });
                }
            }
        }
    }

    /// Makes the log durable.
    fn write(&mut self) {
        let result = self.engines.log.flush();
        if result.is_ok() && self.engines.log.store.wants_preparing() {
            self.engines.bells.rounds.ring();
        }
        self.step(Event::Written(result));
    }

    fn follow_members(&mut self) {
        // Without a sender nothing changes any more.
        if self.members.has_changed().unwrap_or(false) {
            self.members.mark_unchanged();
            self.step(Event::Wanted(self.engines.directory.desired()));
        }
    }

    fn step(&mut self, event: Event) {
        // A leader waits for a voter's answer; nobody waits for a learner's, which may be on a robot's battery.
        if let Event::Input(Input::Message { message, .. }) = &event
            && message.brings_entries()
            && self.replica.is_voter()
        {
            self.engines.idle_control.keep();
        }
        let (mut effects, mut unsent) = (std::mem::take(&mut self.effects), Vec::new());
        self.replica.step(self.engines.clock.both(), event, &mut effects);
        for effect in effects.drain(..) {
            self.carry_out(effect, &mut unsent);
        }
        self.effects = effects;
        unsent.into_iter().for_each(|event| self.step(event));
    }

    fn carry_out(&mut self, effect: Effect, unsent: &mut Vec<Event>) {
        match effect {
            Effect::Send { to, message } => {
                if !self.engines.outlet.send(to, &message) {
                    unsent.push(Event::Unsent { to, message });
                }
            }
            Effect::Status(status) => *self.status.lock().unwrap_or_else(PoisonError::into_inner) = *status,
            Effect::Role(change) => {
                self.tell_role(&change);
                self.role.send_replace(Reign::now(change));
            }
            Effect::Members { height, membership } => {
                let directory = &self.engines.directory;
                let (voters, learners) = (directory.names(&membership.voters), directory.names(&membership.learners));
                tracing::info!(height, voters, learners, "members changed");
            }
            Effect::Reconciles(step) => {
                tracing::info!(change = self.described(&step), "changing members to match the ledger");
            }
            Effect::Read { context, answer } => self.engines.outlet.answered(context, answer),
            Effect::Denied(refusal) => self.engines.outlet.rejected(self.engines.clock.now(), &refusal),
            Effect::Refused { input, reason } => {
                tracing::warn!(request = self.described(&input), code = reason.code.name(), %reason, "ordering \
                                                                                                      rejected a \
                                                                                                      request");
            }
            Effect::Behind { from, first_index } => {
                let leader = self.engines.directory.name(from);
                tracing::info!(leader, first_index, "too far behind for the leader's log");
                self.engines.behind.send_replace(Some(Behind { from, first_index }));
            }
            Effect::Ignored { from, reason } => {
                // Once for each reason: a peer that floods this node must not flood its log.
                let before = self.ignored.insert(from, reason);
                if before != Some(reason) {
                    let peer = self.engines.directory.name(from);
                    tracing::warn!(node = peer, reason, "ignoring messages of a peer");
                }
            }
            Effect::Misbehaved(proof) => self.engines.outlet.misbehaved(proof),
            Effect::Contradicted(found) => self.engines.outlet.contradicted(found),
            Effect::Failed(reason) => {
                self.failed = true;
                self.engines.failure.fail(reason);
            }
        }
    }

    /// Says who leads. That nobody does, and that somebody does again, have the same level.
    fn tell_role(&self, change: &RoleChange) {
        let term = change.term;
        match (change.role, change.leader) {
            (Role::Leader, _) => tracing::info!(term, "became leader"),
            (_, Some(leader)) => {
                tracing::info!(term, leader = self.engines.directory.name(leader), "leader changed")
            }
            (Role::Candidate, None) => tracing::info!(term, "no leader; requesting votes"),
            (Role::Follower, None) => tracing::info!(term, "no leader"),
        }
    }

    /// A request to the engine, for people.
    fn described(&self, input: &Input) -> String {
        let name = |node: u64| self.engines.directory.name(node);
        match input {
            Input::TransferLeadership { to } => format!("transfer the leadership to {}", name(*to)),
            Input::ChangeMembership(change) => {
                let changes = change.changes().map(|change| match change {
                    Change::AddVoter(node) => format!("{} becomes a voter", name(node)),
                    Change::AddLearner(node) => format!("{} becomes a learner", name(node)),
                    Change::Remove(node) => format!("{} is removed", name(node)),
                });
                changes.collect::<Vec<_>>().join(", ")
            }
            _ => "another change".to_owned(),
        }
    }
}
