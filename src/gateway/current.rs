//! Is this node's state as new as what was committed when somebody asked? Only then may it refuse because of its state.
//!
//! The leader knows, and a majority must confirm that it leads ([`Reads`]). One question serves everybody who waits when it
//! is asked; whoever comes while it is under way waits for the next one, as an answer may be older than they are. So a flood
//! of refusals costs the leader one question at a time.

use crate::blocks::Blocks;
use crate::orderer::{Reads, Seat};
use ledger::{Code, Rejection};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until, timeout};

/// Longest time that somebody waits for a height that this node has not executed.
const WAIT_FOR_HEIGHT: Duration = Duration::from_secs(2);
/// From one question to the next while more and more ask. The first after a quiet moment is asked at once.
const BETWEEN_QUESTIONS: Duration = Duration::from_millis(1);

/// The height that the state has reached at least, and that was committed when the question was asked; or why that cannot
/// be told now.
pub(crate) type Known = Result<u64, Rejection>;

/// What makes a node's state current; cheap to clone.
#[derive(Clone)]
pub(crate) struct Current {
    inner: Arc<Inner>,
}

struct Inner {
    reads: Arc<Reads>,
    seat: Arc<Seat>,
    blocks: Arc<Blocks>,
    asking: Mutex<Asking>,
}

#[derive(Default)]
struct Asking {
    /// A question is under way, or about to be asked.
    busy: bool,
    /// Those whom the next one serves.
    waiting: Vec<oneshot::Sender<Known>>,
}

impl Current {
    /// Of a node that finds its leader here, and its blocks there.
    pub(crate) fn new(reads: Arc<Reads>, seat: Arc<Seat>, blocks: Arc<Blocks>) -> Self {
        Self { inner: Arc::new(Inner { reads, seat, blocks, asking: Mutex::default() }) }
    }

    /// Waits until this node has executed everything that was committed when this was called, by whichever node.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if no leader confirms in time that it leads; [`Code::Behind`] if this node is further behind than
    /// can be waited for. Then nobody knows whether the state is current.
    pub(crate) async fn reach(&self) -> Known {
        self.ask().await.unwrap_or_else(|_| Err(Rejection::new(Code::ShuttingDown, "the node is stopping")))
    }

    /// As [`Current::reach`], for who does something else meanwhile. What counts is the moment of this call.
    pub(crate) fn ask(&self) -> oneshot::Receiver<Known> {
        let (sender, known) = oneshot::channel();
        let begin = {
            let mut asking = self.inner.asking();
            asking.waiting.push(sender);
            !std::mem::replace(&mut asking.busy, true)
        };
        if begin {
            tokio::spawn(Arc::clone(&self.inner).questions());
        }
        known
    }

    /// Waits until this node has executed the block at a height.
    ///
    /// # Errors
    /// [`Code::Behind`] if it does not in time, [`Code::ShuttingDown`].
    pub(crate) async fn reach_height(&self, height: u64) -> Result<(), Rejection> {
        self.inner.reach(height).await
    }
}

impl Inner {
    /// Asks for as long as somebody waits.
    async fn questions(self: Arc<Self>) {
        loop {
            let next = Instant::now() + BETWEEN_QUESTIONS;
            let waiting = {
                let mut asking = self.asking();
                // Who has gone away needs no answer.
                asking.waiting.retain(|waiter| !waiter.is_closed());
                asking.busy = !asking.waiting.is_empty();
                std::mem::take(&mut asking.waiting)
            };
            if waiting.is_empty() {
                return;
            }
            let known = self.question().await;
            for waiter in waiting {
                let _gone = waiter.send(known.clone());
            }
            if !self.asking().waiting.is_empty() {
                sleep_until(next).await;
            }
        }
    }

    async fn question(&self) -> Known {
        let height = self.reads.confirmed_height(&self.seat).await?;
        self.reach(height).await?;
        Ok(height)
    }

    async fn reach(&self, height: u64) -> Result<(), Rejection> {
        let mut head = self.blocks.head();
        match timeout(WAIT_FOR_HEIGHT, head.wait_for(|reached| *reached >= height)).await {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(_)) => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
            Err(_) => Err(Rejection::new(Code::Behind, "this node has not reached the height that was asked for")
                .found(format!("height {}", self.blocks.height()))
                .wanted(format!("height {height}"))
                .next("ask again, or ask another node")),
        }
    }

    fn asking(&self) -> MutexGuard<'_, Asking> {
        self.asking.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
