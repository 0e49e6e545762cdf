//! The driver of the engine: inputs and time in, effects out.

mod calls;
mod duties;
mod ending;
mod outputs;

pub use ending::Last;

use crate::executor::Executor;
use crate::in_place::{Circumstances, InPlace};
use crate::reads::Known;
use crate::ticks::Ticks;
use crate::timing::Timing;
use crate::waiters::{Waiter, Waiters};
use crate::withheld::Withheld;
use ledger::Refusal;
use ledger::members::Membership;
use ledger_base::hash::Hash;
use ledger_base::invariant;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Misbehaviour;
use ledger_raft::{
    Ballots, ClockDoubt, Contradiction, Creators, Desired, Engine, EngineConfig, ExecutedBlocks, Input, PeerMessage,
    RoleChange, Secret, Status,
};
use ledger_storage::block_store::{BlockStore, StoreError};
use ledger_storage::entry::Entry;
use std::sync::Arc;

/// Pause before a write is tried again that found no space, microseconds.
pub const FULL_DISK_PAUSE: u64 = 100_000;
/// How long a learner, for whose disk nobody waits, gathers before it writes, microseconds.
pub const LEARNER_WRITE_DELAY: u64 = 2_000;

/// The two clocks of a node, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Now {
    /// The node's view of the time, since the UNIX epoch. It is never behind the block time that the node has seen, and
    /// may jump ahead.
    pub clock: u64,
    /// Time since the node started. It grows steadily.
    pub elapsed: u64,
    /// The latest block time that this node acknowledges, as a voter: [`crate::Clock::accepts_until`].
    pub accepts_until: u64,
    /// Why the machine's clock may be wrong: [`crate::Clock::doubt`].
    pub doubt: Option<ClockDoubt>,
}

/// How a replica is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// This node's number; never 0.
    pub id: u64,
    /// Randomness: see [`EngineConfig::seed`].
    pub seed: u64,
    /// Its times.
    pub timing: Timing,
    /// Behind its receipts: see [`Secret`].
    pub secret: Secret,
}

/// An event.
#[derive(Debug)]
pub enum Event {
    /// Something for the engine: a message, a transaction, a question.
    Input(Input),
    /// Time has gone on: what is due is done. To be told after [`Replica::wait`], and after every group of inputs.
    Time {
        /// The disk has too little space for messages.
        full: bool,
    },
    /// The log was written because [`Replica::must_write`] said so.
    Written(Result<(), StoreError>),
    /// [`Work::Here`] is done.
    Executed {
        /// Height of the last block of it.
        height: u64,
        /// Microseconds that it took.
        took: u64,
    },
    /// A message cannot be sent, as there is no way to its receiver.
    Unsent {
        /// The receiver.
        to: u64,
        /// The message.
        message: PeerMessage,
    },
    /// The members that the ledger wants have changed.
    Wanted(Desired),
}

/// An effect: the node must do it. In the order given.
#[derive(Debug)]
pub enum Effect {
    /// Send this message, or tell [`Event::Unsent`]. Losing it is allowed.
    Send {
        /// The peer.
        to: u64,
        /// The message.
        message: PeerMessage,
    },
    /// How ordering stands now.
    Status(Box<Status>),
    /// The leader has changed.
    Role(RoleChange),
    /// The members have changed.
    Members {
        /// Height of the change.
        height: u64,
        /// The members from there on.
        membership: Membership,
    },
    /// A leader takes this step towards the members that the ledger wants.
    Reconciles(Input),
    /// A question of [`crate::Reads`] is answered.
    Read {
        /// Its context.
        context: u64,
        /// A height that was committed, or why none can be told.
        answer: Known,
    },
    /// A transaction was not ordered. Its client was told; to be counted.
    Denied(Box<Refusal>),
    /// A transfer of leadership or a change of members was refused.
    Refused {
        /// The question.
        input: Box<Input>,
        /// Why.
        reason: Rejection,
    },
    /// This node lacks blocks that replication does not bring: end the replica, fetch at least the blocks before
    /// `first_index`, and start a new one.
    Behind {
        /// The leader that says so.
        from: u64,
        /// The first block that replication still brings.
        first_index: u64,
    },
    /// A message of a peer was ignored. Nothing is to be done but to say so.
    Ignored {
        /// The peer.
        from: u64,
        /// Why.
        reason: &'static str,
    },
    /// A node has signed two different things for one place. The proof is to be kept, and sent to all.
    Misbehaved(Box<Misbehaviour>),
    /// Another node has another chain. It is to be shown: people must decide.
    Contradicted(Contradiction),
    /// The node cannot go on.
    Failed(Rejection),
}

/// Committed blocks, to be executed in order.
#[derive(Debug, PartialEq)]
pub enum Work {
    /// The caller executes them now, then tells [`Event::Executed`].
    Here(Vec<Entry>),
    /// The other thread executes them, which then gives [`Input::Applied`].
    Elsewhere(Vec<Entry>),
}

/// The orderer of one node while it takes part, and everything that its order thread decides.
pub struct Replica<W> {
    engine: Engine,
    executor: Arc<Executor>,
    waiters: Arc<Waiters<W>>,
    ticks: Ticks,
    leading: bool,
    /// Committed, and not given to anybody.
    committed: Vec<Entry>,
    /// Height of the last block that was given to somebody.
    given: u64,
    in_place: InPlace,
    /// Kept, so that it is allocated once.
    outputs: Vec<ledger_raft::Output>,
    /// Number of the newest flush that the engine waits for.
    flush: Option<u64>,
    /// When that flush is due.
    flush_due: u64,
    /// The members that the ledger wants.
    desired: Desired,
    /// They, or the members that there are, have changed: the next step need not wait for a tick.
    reconcile: bool,
    /// The deadline for which an empty block was asked for, and the height then: asked once until a block came.
    asked_for: (u64, u64),
    /// Another node leads than before: what waits is submitted again.
    submit_again: bool,
    /// The log was to be written for the last time.
    wrote_last: bool,
    /// When the leadership was given away last because of a full disk.
    left_full_disk: Option<u64>,
    /// Control calls that wait for their verdict.
    withheld: Withheld,
}

impl<W: Waiter> Replica<W> {
    /// Goes on from what the log holds and what is executed. `ballots` has the node's key for votes.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if log, state and settings do not fit together; a fault of the store.
    pub fn start(
        settings: &Settings,
        store: Arc<BlockStore>,
        executor: Arc<Executor>,
        waiters: Arc<Waiters<W>>,
        desired: Desired,
        ballots: Arc<dyn Ballots>,
    ) -> Result<Self, Rejection> {
        let given = executor.ledger().tip().height;
        let mut config = EngineConfig::new(settings.id, executor.ledger().members()?, settings.seed);
        config.applied = given;
        config.election_tick = settings.timing.election_ticks;
        config.heartbeat_tick = settings.timing.heartbeat_ticks();
        config.data_wait_us = settings.timing.data_wait;
        config.secret = settings.secret;
        let ledger = Arc::clone(executor.ledger());
        let organisation = move |creator: &Hash| {
            ledger.counted_for(creator).map(|identity| Hash::of(&[identity.organisation.as_bytes()]))
        };
        config.creators = Creators::new(organisation);
        let executed = Arc::clone(&executor) as Arc<dyn ExecutedBlocks>;
        let engine = Engine::new(config, store, executed, ballots)
            .map_err(|error| Rejection::new(Code::Corrupt, error.to_string()))?;
        executor.look_at_deadline();
        Ok(Self {
            engine,
            executor,
            waiters,
            ticks: Ticks::every(settings.timing.tick, 0),
            leading: false,
            committed: Vec::new(),
            given,
            in_place: InPlace::default(),
            outputs: Vec::new(),
            flush: None,
            flush_due: 0,
            desired,
            reconcile: false,
            asked_for: (0, 0),
            submit_again: false,
            wrote_last: false,
            left_full_disk: None,
            withheld: Withheld::default(),
        })
    }

    /// Takes one event, and appends what the node must do to `out`.
    pub fn step(&mut self, now: Now, event: Event, out: &mut Vec<Effect>) {
        match event {
            Event::Input(Input::Message { from, message: PeerMessage::Forward(forwarded) }) => {
                let within = self.within_budgets(now, from, forwarded, out);
                self.order(now, Input::Message { from, message: PeerMessage::Forward(within) }, out);
            }
            Event::Input(Input::Message { from, message: PeerMessage::Unanswered(call) }) => {
                self.passed_on(now, from, call, out);
            }
            Event::Input(Input::Submit { lane, transaction }) => {
                self.keep_call(now, lane, &transaction);
                self.order(now, Input::Submit { lane, transaction }, out);
            }
            Event::Input(input) => self.order(now, input, out),
            Event::Time { full } => self.time(now, full, out),
            Event::Written(result) => self.written(now, result, out),
            Event::Executed { height, took } => {
                self.in_place.took(took);
                self.order(now, Input::Applied { height, at: now.clock }, out);
            }
            Event::Unsent { to, message } => self.unsent(to, message, out),
            Event::Wanted(desired) => {
                self.desired = desired;
                self.reconcile = true;
            }
        }
    }

    /// Is the log to be written now? Then flush the block store, and tell [`Event::Written`] what came of it.
    pub fn must_write(&self, now: Now) -> bool {
        self.flush.is_some() && self.flush_due <= now.elapsed
    }

    /// Does the engine wait for a write, now or later?
    pub fn waits_for_write(&self) -> bool {
        self.flush.is_some()
    }

    /// The blocks to be executed, and the thread that does it. To be asked when the log was written.
    pub fn work(&mut self, circumstances: Circumstances) -> Option<Work> {
        let entries = self.hand_out()?;
        // A leader waits for what a voter that follows writes next.
        let awaited = self.engine.is_voter() && !self.leading;
        Some(match self.in_place.allows(&entries, awaited, circumstances) {
            true => Work::Here(entries),
            false => Work::Elsewhere(entries),
        })
    }

    /// The committed blocks that were given to nobody yet.
    fn hand_out(&mut self) -> Option<Vec<Entry>> {
        let entries = std::mem::take(&mut self.committed);
        let (first, last) = (entries.first()?.index, entries.last()?.index);
        invariant!(
            first == self.given + 1 && last == self.given + entries.len() as u64,
            "blocks are executed in order, without a gap",
            "blocks {first} to {last} after block {}",
            self.given
        );
        self.given = last;
        Some(entries)
    }

    /// Microseconds until something is to be done although nothing happens.
    pub fn wait(&self, now: Now) -> u64 {
        if !self.committed.is_empty() {
            return 0;
        }
        let until_tick = self.ticks.wait(now.elapsed, self.engine.needs_ticks());
        let until_write = match self.flush {
            Some(_) => self.flush_due.saturating_sub(now.elapsed),
            None => u64::MAX,
        };
        let until_deadline = match self.executor.deadline().saturating_sub(now.clock) {
            // Asked for already, or to be asked for when block time has come so far: a tick looks.
            0 => u64::MAX,
            left if self.leading => left,
            _ => u64::MAX,
        };
        until_tick.min(until_write).min(until_deadline)
    }

    /// How ordering stands.
    pub fn status(&self) -> Status {
        self.engine.status()
    }

    /// Does this node lead?
    pub fn leads(&self) -> bool {
        self.leading
    }

    /// Has this node a vote?
    pub fn is_voter(&self) -> bool {
        self.engine.is_voter()
    }
}
