//! The duties of a replica at its own time.

use super::{Effect, FULL_DISK_PAUSE, Now, Replica};
use crate::waiters::Waiter;
use ledger_raft::{Input, next_step, successor};
use ledger_storage::block_store::StoreError;

/// Pause before a leader with a full disk hands over again, microseconds: where all voters have one disk, or all are full,
/// the leadership must not go round and round.
const LEAVE_AGAIN_PAUSE: u64 = 10_000_000;

impl<W: Waiter> Replica<W> {
    pub(super) fn time(&mut self, now: Now, full: bool, out: &mut Vec<Effect>) {
        if self.ticks.due(now.elapsed) {
            self.order(now, Input::Tick, out);
            self.leave_full_disk(now, full, out);
            self.report(out);
            self.reconcile = true;
        }
        self.meet_deadline(now, out);
        self.submit_again(now, out);
        self.tend_calls(now, out);
        self.reconcile(now, out);
    }

    /// A leader without space can promise nothing and answers nobody: another voter shall lead.
    fn leave_full_disk(&mut self, now: Now, full: bool, out: &mut Vec<Effect>) {
        let rested = |left: u64| now.elapsed.saturating_sub(left) >= LEAVE_AGAIN_PAUSE;
        if self.leading
            && full
            && self.left_full_disk.is_none_or(rested)
            && let Some(to) = successor(&self.engine.status())
        {
            self.left_full_disk = Some(now.elapsed);
            self.order(now, Input::TransferLeadership { to }, out);
        }
    }

    /// Orders an empty block when something is due and no traffic moved block time past it.
    fn meet_deadline(&mut self, now: Now, out: &mut Vec<Effect>) {
        let deadline = self.executor.deadline();
        if !self.leading || self.engine.block_time(now.clock) < deadline {
            return;
        }
        let asking_for = (deadline, self.executor.ledger().tip().height);
        if self.asked_for != asking_for {
            self.asked_for = asking_for;
            self.order(now, Input::ProposeEmpty, out);
        }
    }

    /// A transaction that was given to a leader that is gone may be lost with it: everything that still waits goes to
    /// the next one. The id makes sure that it is executed once.
    fn submit_again(&mut self, now: Now, out: &mut Vec<Effect>) {
        if std::mem::take(&mut self.submit_again) {
            for (lane, transaction) in self.waiters.all() {
                self.order(now, Input::Submit { lane, transaction }, out);
            }
        }
    }

    /// A leader takes the next step from the members that there are to those that the ledger wants.
    fn reconcile(&mut self, now: Now, out: &mut Vec<Effect>) {
        if !std::mem::take(&mut self.reconcile) || !self.leading {
            return;
        }
        if let Some(step) = next_step(&self.desired, &self.engine.status()) {
            out.push(Effect::Reconciles(step.clone()));
            self.order(now, step, out);
        }
    }

    /// The log was written, or not.
    pub(super) fn written(&mut self, now: Now, result: Result<(), StoreError>, out: &mut Vec<Effect>) {
        let Some(ready) = self.flush.take() else { return };
        match result {
            Ok(()) => self.order(now, Input::Persisted { ready }, out),
            Err(StoreError::DiskFull { .. }) => {
                // Nothing of it is on disk and nobody was told otherwise: it is tried again until there is space.
                self.flush = Some(ready);
                self.flush_due = now.elapsed.saturating_add(FULL_DISK_PAUSE);
            }
            Err(error) => out.push(Effect::Failed(error.into())),
        }
    }
}
