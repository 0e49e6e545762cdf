//! Makes this node's state as new as what was committed when somebody asked: carries out what [`Reads`] decides.

use crate::ordering::orderer_slot::OrdererSlot;
use crate::process::clock::Clock;
use crate::storage::blocks::Blocks;
use ledger::{Ledger, Outcome};
use ledger_base::invariant::vital_task;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Input;
pub(crate) use ledger_replica::Known;
use ledger_replica::{Asker, Observer, ReadEffect, Reads, WAIT_FOR_HEIGHT};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{Notify, oneshot};
use tokio::time::timeout;

/// Becomes known.
pub(crate) type Question = oneshot::Receiver<Known>;

/// Makes a node's state current; cheap to clone.
#[derive(Clone)]
pub(crate) struct ReadIndex {
    blocks: Arc<Blocks>,
    questions: Arc<Questions>,
}

/// The readers that wait for an answer.
struct Waiting(oneshot::Sender<Known>);

impl Asker for Waiting {
    fn is_gone(&self) -> bool {
        self.0.is_closed()
    }
}

/// Those who ask, where the engine is, and the time.
struct Questions {
    slot: Arc<OrdererSlot>,
    clock: Clock,
    runtime: Handle,
    state: Mutex<State>,
    /// Something is due earlier than the timer knows.
    earlier: Notify,
}

struct State {
    reads: Reads<Waiting>,
    /// When the timer looks next; none while there is no timer.
    timer: Option<u64>,
}

/// The news for the timer.
enum Timer {
    Fine,
    Begin,
    Earlier,
}

impl ReadIndex {
    /// Of a node that finds its leader at the slot, and its blocks there. Runs in the runtime of the caller.
    pub(crate) fn new(slot: Arc<OrdererSlot>, blocks: Arc<Blocks>, clock: Clock) -> Self {
        let state = Mutex::new(State { reads: Reads::new(blocks.height()), timer: None });
        let (runtime, earlier) = (Handle::current(), Notify::new());
        Self { blocks, questions: Arc::new(Questions { slot, clock, runtime, state, earlier }) }
    }

    /// Waits until this node has executed everything that was committed when this was called, by whichever node.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if no leader confirms in time that it leads; [`Code::Behind`] if this node is further behind than
    /// can be waited for. Then nobody knows whether the state is current.
    pub(crate) async fn reach(&self) -> Known {
        self.ask().await.unwrap_or_else(|_| Err(Rejection::new(Code::ShuttingDown, "the node is stopping")))
    }

    /// As [`ReadIndex::reach`], for who does something else meanwhile. The moment of this call counts.
    pub(crate) fn ask(&self) -> Question {
        let (sender, known) = oneshot::channel();
        self.questions.tell(|reads, now, out| reads.ask(now, Waiting(sender), out));
        known
    }

    /// The engine's answer to a question.
    pub(crate) fn answered(&self, context: u64, answer: Known) {
        self.questions.tell(|reads, now, out| reads.answered(now, context, answer, out));
    }

    /// Waits until this node has executed the block at a height that some node has told a client. It was committed before it was
    /// told, so a current state is enough. A node that lies about heights makes nobody wait at another one.
    ///
    /// # Errors
    /// As [`ReadIndex::reach_height`], where no leader confirms that the state is current either.
    pub(crate) async fn reach_told(&self, height: u64) -> Result<(), Rejection> {
        if height <= self.blocks.height() {
            return Ok(());
        }
        tokio::select! {
            reached = self.reach_height(height) => reached,
            Ok(_) = self.reach() => Ok(()),
        }
    }

    /// Waits until this node has executed the block at a height.
    ///
    /// # Errors
    /// [`Code::Behind`] if it does not in time, [`Code::ShuttingDown`].
    pub(crate) async fn reach_height(&self, height: u64) -> Result<(), Rejection> {
        if height <= self.blocks.height() {
            return Ok(());
        }
        let mut head = self.blocks.head();
        let reached = head.wait_for(|reached| *reached >= height);
        match timeout(Duration::from_micros(WAIT_FOR_HEIGHT), reached).await {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(_)) => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
            Err(_) => Err(Rejection::new(Code::Behind, "this node has not reached the requested height")
                .found(format!("height {}", self.blocks.height()))
                .wanted(format!("height {height}"))),
        }
    }
}

impl Observer for ReadIndex {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        self.questions.tell(|reads, now, out| reads.executed(now, outcome.header.height, out));
    }
}

impl Questions {
    /// Tells what happened, and does what follows. Nobody holds the lock while a thread is woken.
    fn tell(self: &Arc<Self>, happened: impl FnOnce(&mut Reads<Waiting>, u64, &mut Vec<ReadEffect<Waiting>>)) {
        let mut effects = Vec::new();
        self.change(|reads, now| happened(reads, now, &mut effects));
        while let Some(effect) = effects.pop() {
            match effect {
                // Whoever has gone away needs no answer.
                ReadEffect::Tell { asker, known } => drop(asker.0.send(known)),
                ReadEffect::Ask { context } => {
                    if let Err(reason) = self.put(context) {
                        self.change(|reads, now| reads.answered(now, context, Err(reason), &mut effects));
                    }
                }
            }
        }
    }

    fn change(self: &Arc<Self>, change: impl FnOnce(&mut Reads<Waiting>, u64)) {
        let timer = {
            let mut state = self.state();
            change(&mut state.reads, self.clock.elapsed());
            state.look_at_timer()
        };
        match timer {
            Timer::Fine => {}
            Timer::Begin => drop(self.runtime.spawn(vital_task(Arc::clone(self).keep_time()))),
            Timer::Earlier => self.earlier.notify_one(),
        }
    }

    fn put(&self, context: u64) -> Result<(), Rejection> {
        if self.slot.handle()?.input(Input::ReadIndex { context }) {
            return Ok(());
        }
        Err(Rejection::new(Code::Overloaded, "the node cannot accept more queries now"))
    }

    /// Wakes [`Reads`] when something is due, for as long as somebody waits.
    async fn keep_time(self: Arc<Self>) {
        loop {
            let due = {
                let mut state = self.state();
                state.timer = state.reads.wakes_at();
                state.timer
            };
            let Some(due) = due else { return };
            let left = Duration::from_micros(due.saturating_sub(self.clock.elapsed()));
            let _due_or_earlier = timeout(left, self.earlier.notified()).await;
            self.tell(|reads, now, out| reads.time(now, out));
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Has the timer to be told? It may look too early, never too late.
    fn look_at_timer(&mut self) -> Timer {
        match (self.reads.wakes_at(), self.timer) {
            (Some(due), Some(timer)) if due < timer => {
                self.timer = Some(due);
                Timer::Earlier
            }
            (Some(due), None) => {
                self.timer = Some(due);
                Timer::Begin
            }
            _ => Timer::Fine,
        }
    }
}
