//! Calls that robots hear of before they are ordered: an emergency stop must not wait for a majority.

use super::{Admission, Ledger};
use crate::call_ref::CallRef;
use crate::transaction::Transaction;
use ledger_storage::result::Event;

impl Ledger {
    /// Is this a call of which readers are told before it is ordered ([`Chaincode::told_early`](crate::Chaincode::told_early))?
    pub fn is_told_early(&self, transaction: &Transaction) -> bool {
        let body = transaction.body();
        self.registry.find(&body.chaincode).is_ok_and(|chaincode| chaincode.told_early(&body.function))
    }

    /// Has this call been executed, or can it never be, because block time has passed its `not_after`?
    pub fn is_settled(&self, call: &CallRef) -> bool {
        call.not_after < self.tip().time || self.was_executed(&call.id, call.not_after)
    }

    /// The events that such a call would have on the state as it is, at the node's time in microseconds. None for every other call,
    /// for one that this node would refuse, and for one that was executed already: its own events tell of that.
    ///
    /// It promises nothing. The call may be refused when it is ordered, or never be ordered.
    pub fn foresee(&self, transaction: &Transaction, now: u64) -> Option<Vec<Event>> {
        let time = now.max(self.tip().time);
        // A block may still execute a late one, but robots are not to be notified of old stops.
        if !self.is_told_early(transaction) || transaction.check_time(time).is_err() {
            return None;
        }
        let Ok(Admission::New(transaction)) = self.admit_decoded(transaction.clone(), now) else { return None };
        let (caller, _) = self.authenticate(&transaction, time).ok()?;
        let body = transaction.body();
        let called = self.call(&caller, time, transaction.id(), &body.chaincode, &body.function, &body.args);
        called.ok().map(|(_, events)| events).filter(|events| !events.is_empty())
    }
}
