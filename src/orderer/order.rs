//! The order thread: owns the engine, writes the log.

use super::Shared;
use super::execute::{Circumstances, Execute, InPlace};
use super::inbox::Inbox;
use super::ticks::Ticks;
use crate::catch_up::Behind;
use ledger::Refusal;
use ledger::transaction::Transaction;
use ledger_raft::{
    Change, Engine, Input, Output, PeerMessage, Role, RoleChange, Status, Transactions, next_step, successor,
};
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::StoreError;
use ledger_storage::entry::Entry;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Inputs taken before the log is written, so that a flood cannot put off the write.
const INPUTS_PER_WRITE_MAX: usize = 4096;
/// Inputs that come while the log is written when there is much to do.
const MANY_INPUTS: usize = 8;
/// How long a learner, for whose disk nobody waits, gathers before it writes.
const LEARNER_WRITE_DELAY: Duration = Duration::from_millis(2);
/// Pause before a write is tried again that found no space.
const FULL_DISK_PAUSE: Duration = Duration::from_millis(100);
/// Pause before a leader with a full disk hands over again: where all voters have one disk, or all are full, the leadership
/// must not go round and round.
const LEAVE_AGAIN_PAUSE: Duration = Duration::from_secs(10);

/// The order thread.
pub(super) struct Order {
    engine: Engine,
    ticks: Ticks,
    leading: bool,
    shared: Arc<Shared>,
    execute: Execute,
    /// To the execute thread.
    blocks: Arc<Inbox<Entry>>,
    /// Committed, and neither executed nor handed over.
    committed: Vec<Entry>,
    /// Whether what is committed may be executed here.
    in_place: InPlace,
    outputs: Vec<Output>,
    /// Number of the newest flush that the engine waits for.
    flush: Option<u64>,
    /// When that flush is due.
    flush_due: Instant,
    status: Arc<Mutex<Status>>,
    role: watch::Sender<RoleChange>,
    /// The deadline for which an empty block was asked for, and the height then: asked once until a block came.
    asked_for: (u64, u64),
    /// Another node leads than before: what waits is submitted again.
    submit_again: bool,
    /// When the leadership was given away last because of a full disk.
    left_full_disk: Option<Instant>,
    /// The members have changed: the next step towards what the ledger wants need not wait for a tick.
    reconcile: bool,
}

impl Order {
    pub(super) fn new(
        engine: Engine,
        shared: Arc<Shared>,
        tick: Duration,
        execute: Execute,
        blocks: &Arc<Inbox<Entry>>,
        status: Arc<Mutex<Status>>,
        role: watch::Sender<RoleChange>,
    ) -> Self {
        let (leading, outputs, asked_for) = (false, Vec::new(), (0, 0));
        let (submit_again, reconcile, left_full_disk) = (false, false, None);
        Self {
            engine,
            ticks: Ticks::every(tick, Instant::now()),
            leading,
            shared,
            execute,
            blocks: Arc::clone(blocks),
            committed: Vec::new(),
            in_place: InPlace::default(),
            outputs,
            flush: None,
            flush_due: Instant::now(),
            status,
            role,
            asked_for,
            submit_again,
            left_full_disk,
            reconcile,
        }
    }

    /// Until the inbox is closed, or the node cannot go on.
    pub(super) fn run(mut self, inputs: &Inbox<Input>) {
        // However this thread ends: it takes nothing in any more, and the other one ends after what it was given.
        let blocks = Arc::clone(&self.blocks);
        let _ends = (inputs.close_at_end(), blocks.close_at_end());
        while !inputs.is_closed() {
            if self.ticks.due(Instant::now()) {
                self.step(Input::Tick);
                self.leave_full_disk();
                self.report();
                self.reconcile = true;
            }
            self.meet_deadline();
            self.submit_again();
            self.reconcile();
            let wait = match self.flush {
                _ if !self.committed.is_empty() => Duration::ZERO,
                Some(_) if self.shared.space.is_stuck() => FULL_DISK_PAUSE,
                Some(_) => self.flush_due.saturating_duration_since(Instant::now()),
                None => self.idle_time(),
            };
            inputs.wait(wait);
            let mut taken = 0;
            while taken < INPUTS_PER_WRITE_MAX && !inputs.is_empty() {
                let waiting = inputs.take();
                taken += waiting.len();
                waiting.into_iter().for_each(|input| self.step(input));
            }
            self.shared.turns.adapt(taken >= MANY_INPUTS);
            // What waits already is to be ordered while the other thread executes.
            if !(self.write() && self.execute(!inputs.is_empty())) {
                return;
            }
        }
        self.flush_due = Instant::now();
        let _stopping = self.write() && self.execute(true);
    }

    /// Executes what was committed, or has it executed: a little of it in place if nothing else is to be done, as waking
    /// the other thread takes longer. False if the node cannot go on.
    fn execute(&mut self, inputs_wait: bool) -> bool {
        let entries = std::mem::take(&mut self.committed);
        let Some(height) = entries.last().map(|entry| entry.index) else { return true };
        let now = Circumstances {
            awaited: self.engine.is_voter() && !self.leading,
            inputs_wait,
            other_is_idle: self.execute.is_idle(),
        };
        if !self.in_place.allows(&entries, &now) {
            self.execute.hand_over(&self.blocks, entries);
            return true;
        }
        let start = Instant::now();
        if !self.execute.execute(&entries) {
            return false;
        }
        self.in_place.took(start.elapsed());
        self.step(Input::Applied { height, at: self.shared.clock.now() });
        true
    }

    /// Until the next tick, or the next deadline of a chaincode if that is earlier.
    fn idle_time(&self) -> Duration {
        let until_tick = self.ticks.wait(Instant::now(), self.engine.needs_ticks());
        let deadline = self.execute.deadline();
        match deadline.saturating_sub(self.shared.clock.now()) {
            // Asked for already, or not ours to meet.
            0 => until_tick,
            _ if !self.leading => until_tick,
            left => until_tick.min(Duration::from_micros(left)),
        }
    }

    /// A leader without space can promise nothing and answers nobody: another voter shall lead.
    fn leave_full_disk(&mut self) {
        if self.leading
            && self.shared.space.is_full()
            && self.left_full_disk.is_none_or(|left| left.elapsed() >= LEAVE_AGAIN_PAUSE)
            && let Some(to) = successor(&self.engine.status())
        {
            self.left_full_disk = Some(Instant::now());
            self.step(Input::TransferLeadership { to });
        }
    }

    /// Orders an empty block when something is due and no traffic moved block time past it.
    fn meet_deadline(&mut self) {
        let deadline = self.execute.deadline();
        if !self.leading || self.shared.clock.now() < deadline {
            return;
        }
        let asking_for = (deadline, self.shared.ledger.tip().height);
        if self.asked_for != asking_for {
            self.asked_for = asking_for;
            self.step(Input::ProposeEmpty);
        }
    }

    /// What was given to a leader that is gone may be lost with it: everything that still waits goes to the next one.
    /// The id makes sure that it is executed once.
    fn submit_again(&mut self) {
        if std::mem::take(&mut self.submit_again) {
            for (lane, transaction) in self.shared.waiters.all() {
                self.step(Input::Submit { lane, transaction });
            }
        }
    }

    /// A leader takes the next step from the members that there are to those that the ledger wants.
    fn reconcile(&mut self) {
        if !std::mem::take(&mut self.reconcile) || !self.leading {
            return;
        }
        if let Some(step) = next_step(&self.shared.directory.desired(), &self.engine.status()) {
            tracing::info!(change = self.described(&step), "changing the members as the ledger wants them");
            self.step(step);
        }
    }

    /// Makes the log durable if the engine waits for it. False if the node cannot go on.
    fn write(&mut self) -> bool {
        let Some(ready) = self.flush.take_if(|_| self.flush_due <= Instant::now()) else { return true };
        match self.shared.store.flush() {
            Ok(_) => {
                self.shared.space.room();
                if self.shared.store.wants_preparing() {
                    self.shared.bells.rounds.ring();
                }
                self.step(Input::Persisted { ready });
                true
            }
            Err(StoreError::DiskFull { .. }) => {
                // Nothing of it is on disk and nobody was told otherwise: it is tried again until there is space.
                self.flush = Some(ready);
                if self.shared.space.no_room() {
                    return self.write();
                }
                true
            }
            Err(error) => {
                (self.shared.fatal)(error.into());
                false
            }
        }
    }

    fn step(&mut self, input: Input) {
        if !matches!(input, Input::Tick) {
            self.ticks.note_work();
        }
        // A leader waits for a voter's answer; nobody waits for a learner's, which may be on a robot's battery.
        if let Input::Message { message, .. } = &input
            && message.brings_entries()
            && self.engine.is_voter()
        {
            self.shared.awake.keep();
        }
        let mut outputs = std::mem::take(&mut self.outputs);
        self.engine.step(self.shared.clock.now(), input, &mut outputs);
        for output in outputs.drain(..) {
            self.carry_out(output);
        }
        self.outputs = outputs;
    }

    fn carry_out(&mut self, output: Output) {
        match output {
            Output::Send { to, message } => {
                if !self.shared.peers.send(to, &message)
                    && let PeerMessage::Forward(lost) = message
                {
                    self.not_forwarded(to, lost);
                }
            }
            Output::Flush { ready } => {
                if self.flush.is_none() {
                    let delay = if self.engine.is_voter() { Duration::ZERO } else { LEARNER_WRITE_DELAY };
                    self.flush_due = Instant::now() + delay;
                }
                self.flush = Some(ready);
            }
            Output::Commit(entries) => self.committed.extend(entries),
            Output::Role(change) => {
                self.leading = change.role == Role::Leader;
                self.asked_for = (0, 0);
                self.tell_role(&change);
                self.report();
                self.role.send_replace(change);
                self.submit_again = change.leader.is_some();
            }
            Output::Membership { height, membership } => {
                let directory = &self.shared.directory;
                let (voters, learners) = (directory.names(&membership.voters), directory.names(&membership.learners));
                tracing::info!(height, voters, learners, "members changed");
                // Whoever sees the change on the ledger must find it here, too.
                self.report();
                self.reconcile = true;
            }
            Output::Dropped { transaction, reason } => {
                if let Ok(transaction) = Transaction::decode(transaction) {
                    self.refuse(transaction, reason);
                }
            }
            Output::ReadReady { context, index } => self.shared.reads.answer(context, Ok(index)),
            Output::Refused { input, reason } => match *input {
                Input::ReadIndex { context } => self.shared.reads.answer(context, Err(reason)),
                input => tracing::warn!(request = self.described(&input), %reason, "ordering refused a request"),
            },
            Output::Behind { from, first_index } => {
                let leader = self.shared.directory.name(from);
                tracing::info!(leader, first_index, "this node is too far behind to be served by the leader's log");
                self.shared.behind.send_replace(Some(Behind { from, first_index }));
            }
            Output::Failed(reason) => (self.shared.fatal)(reason),
        }
    }

    /// Says who leads. That nobody does, and that somebody does again, have the same level.
    fn tell_role(&self, change: &RoleChange) {
        let term = change.term;
        match (change.role, change.leader) {
            (Role::Leader, _) => tracing::info!(term, "this node leads"),
            (_, Some(leader)) => {
                tracing::info!(term, leader = self.shared.directory.name(leader), "another node leads")
            }
            (Role::Candidate, None) => tracing::info!(term, "no leader is known; this node asks for votes"),
            (Role::Follower, None) => tracing::info!(term, "no leader is known"),
        }
    }

    /// A request to the engine, for people.
    fn described(&self, input: &Input) -> String {
        let name = |node: u64| self.shared.directory.name(node);
        match input {
            Input::TransferLeadership { to } => format!("hand the leadership over to {}", name(*to)),
            Input::ChangeMembership(change) => {
                let changes = change.changes().map(|change| match change {
                    Change::AddVoter(node) => format!("{} votes", name(node)),
                    Change::AddLearner(node) => format!("{} follows", name(node)),
                    Change::Remove(node) => format!("{} leaves", name(node)),
                });
                changes.collect::<Vec<_>>().join(", ")
            }
            Input::ProposeEmpty => "an empty block".to_owned(),
            Input::ReadIndex { .. } => "a read".to_owned(),
            Input::Submit { .. } => "a transaction".to_owned(),
            _ => "a message".to_owned(),
        }
    }

    /// There is no way to the leader now.
    fn not_forwarded(&self, leader: u64, lost: Transactions) {
        let reason = Rejection::new(Code::NoLeader, format!("node {leader} leads, but there is no connection to it"))
            .next("submit the same transaction again, through this or another node");
        for transaction in lost.control.into_iter().chain(lost.data) {
            if let Ok(transaction) = Transaction::decode(transaction) {
                self.refuse(transaction, reason.clone());
            }
        }
    }

    /// Tells whoever submitted it, and counts it.
    fn refuse(&self, transaction: Transaction, rejection: Rejection) {
        let who = self.shared.waiters.refuse(&transaction.id(), &rejection);
        let refusal = Refusal::of_node(who, Some(transaction), rejection);
        self.shared.denials.record(self.shared.clock.now(), &refusal);
    }

    fn report(&self) {
        *self.status.lock().unwrap_or_else(PoisonError::into_inner) = self.engine.status();
    }
}
