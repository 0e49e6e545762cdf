//! Linearizable reads: which height must a node have executed before it may answer?
//!
//! The engine asks the leader, and the leader makes sure of a majority that it still leads (Raft §6.4). The question or
//! its answer may be lost when the leader changes; then it is asked again, within a bounded time.

use super::Seat;
use ledger_raft::Input;
use ledger_rejection::{Code, Rejection};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Longest time in which the leader must confirm a read, all attempts together.
const CONFIRM_TIME_MAX: Duration = Duration::from_secs(1);
/// How long the first attempt waits; each further one waits twice as long.
const FIRST_ATTEMPT: Duration = Duration::from_millis(150);
/// Pause after a refusal: an election takes this long at least.
const REFUSED_PAUSE: Duration = Duration::from_millis(20);

type Confirmed = Result<u64, Rejection>;

/// Reads that wait for the leader's word.
#[derive(Default)]
pub(crate) struct Reads {
    /// Names of reads never repeat, so a late answer finds nobody instead of somebody else.
    next: AtomicU64,
    waiting: Mutex<HashMap<u64, oneshot::Sender<Confirmed>>>,
}

impl Reads {
    /// The height that reflects everything acknowledged by any node before this call.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if no leader confirms it in time; what the seat says if there is no orderer.
    pub(crate) async fn confirmed_height(&self, seat: &Seat) -> Confirmed {
        let deadline = Instant::now() + CONFIRM_TIME_MAX;
        let mut patience = FIRST_ATTEMPT;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let reason = match self.ask(seat, patience.min(left)).await {
                Ok(height) => return Ok(height),
                Err(reason) => reason,
            };
            if deadline <= Instant::now() + REFUSED_PAUSE {
                return Err(reason);
            }
            tokio::time::sleep(REFUSED_PAUSE).await;
            patience *= 2;
        }
    }

    async fn ask(&self, seat: &Seat, patience: Duration) -> Confirmed {
        let context = self.next.fetch_add(1, Ordering::Relaxed);
        let (sender, answer) = oneshot::channel();
        self.lock().insert(context, sender);
        // Also when this future is dropped, because the client went away.
        let _forget = Forget { reads: self, context };
        if !seat.handle()?.input(Input::ReadIndex { context }) {
            return Err(
                Rejection::new(Code::Overloaded, "the node cannot take more questions now").next("ask again later")
            );
        }
        match tokio::time::timeout(patience, answer).await {
            Ok(Ok(answer)) => answer,
            _ => Err(Rejection::new(Code::NoLeader, "no leader confirmed in time that it still leads")
                .next("ask again, ask another node, or ask for an answer from this node's own state")),
        }
    }

    /// The engine's answer to a read; nobody may be waiting for it any more.
    pub(super) fn answer(&self, context: u64, answer: Confirmed) {
        if let Some(waiting) = self.lock().remove(&context) {
            let _gone = waiting.send(answer);
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<u64, oneshot::Sender<Confirmed>>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Forget<'a> {
    reads: &'a Reads,
    context: u64,
}

impl Drop for Forget<'_> {
    fn drop(&mut self) {
        self.reads.lock().remove(&self.context);
    }
}
