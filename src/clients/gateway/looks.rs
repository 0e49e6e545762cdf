//! Waiting for a turn to look at transactions: carries out what [`Turns`] decides.

use ledger_raft::Lane;
use ledger_replica::gateway::{Share, Turn, Turns};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::oneshot;

/// The turns of a node.
pub(crate) struct Looks {
    turns: Mutex<Turns<oneshot::Sender<()>>>,
}

/// The right to look at transactions, until it is dropped. Its holder must not wait for anything.
pub(super) struct Look {
    looks: Arc<Looks>,
    turn: Turn,
}

impl Looks {
    /// On a runtime of so many workers.
    pub(crate) fn new(workers: usize) -> Arc<Self> {
        Arc::new(Self { turns: Mutex::new(Turns::new(workers)) })
    }

    /// A turn, if nobody is before us.
    pub(super) fn try_turn(self: &Arc<Self>, lane: Lane, share: &Share) -> Option<Look> {
        let turn = self.turns().take(lane, share.applicant())?;
        Some(Look { looks: Arc::clone(self), turn })
    }

    /// A turn, after those who wait already. Cancelling it leaves the place in the queue.
    pub(super) async fn turn(self: &Arc<Self>, lane: Lane, share: &Share) -> Look {
        let (turn, told) = {
            let mut turns = self.turns();
            match turns.take(lane, share.applicant()) {
                Some(turn) => (turn, None),
                None => {
                    let (waiter, told) = oneshot::channel();
                    (turns.wait(lane, share.applicant(), waiter), Some(told))
                }
            }
        };
        let look = Look { looks: Arc::clone(self), turn };
        if let Some(told) = told {
            let _never_forgotten = told.await;
        }
        look
    }

    fn turns(&self) -> MutexGuard<'_, Turns<oneshot::Sender<()>>> {
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Look {
    fn drop(&mut self) {
        let next = self.looks.turns().leave(&self.turn);
        // Nobody holds the lock while a thread is woken. A stream that waits no longer leaves, too.
        if let Some(next) = next {
            let _gone = next.send(());
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use futures::FutureExt;
    use ledger_replica::gateway::Shares;

    #[test]
    fn whoever_stops_waiting_is_passed_over_even_after_being_told() {
        let (looks, shares) = (Looks::new(2), Shares::new(10));
        let [one, other] = ["A/x", "B/z"].map(|name| shares.of(name.into()));
        let first = looks.try_turn(Lane::Data, &one).unwrap();
        assert!(looks.try_turn(Lane::Data, &other).is_none());
        let mut stops = Box::pin(looks.turn(Lane::Data, &other));
        let mut told = Box::pin(looks.turn(Lane::Data, &one));
        let mut waits = Box::pin(looks.turn(Lane::Data, &other));
        assert!([&mut stops, &mut told, &mut waits].into_iter().all(|turn| turn.now_or_never().is_none()));
        drop(stops);
        drop(first);
        drop(told);
        let last = waits.now_or_never().unwrap();
        drop(last);
        looks.try_turn(Lane::Data, &one).unwrap();
    }
}
