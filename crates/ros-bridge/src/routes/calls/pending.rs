//! Requests of the local graph that wait for the ledger's verdict and for the robot's reply. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use ledger_base::hash::Hash;

use super::waiting::Waiting;
use crate::routes::ends::SubmitUpdate;

/// The requests, in lanes that differ in how long they wait. A number is unique over all lanes.
pub(in crate::routes) struct PendingRequests<C, const LANES: usize> {
    lanes: [Waiting<u64, Request<C>>; LANES],
    /// The numbers of the requests by the ids of their transactions.
    numbers: BTreeMap<Hash, u64>,
}

/// A request of somebody in the local graph.
struct Request<C> {
    call: C,
    /// The transaction in which it goes to the ledger.
    id: Option<Hash>,
}

impl<C, const LANES: usize> PendingRequests<C, LANES> {
    /// For so long they wait, by lane.
    pub(in crate::routes) fn new(patience: [Duration; LANES]) -> Self {
        Self { lanes: patience.map(Waiting::new), numbers: BTreeMap::new() }
    }

    /// Is there no room for another one in this lane?
    pub(in crate::routes) fn is_full(&self, lane: usize) -> bool {
        self.lanes.get(lane).is_none_or(Waiting::is_full)
    }

    /// Lets a request wait from now on.
    pub(in crate::routes) fn insert(&mut self, lane: usize, number: u64, call: C, now: Instant) {
        if let Some(lane) = self.lanes.get_mut(lane) {
            lane.insert(number, Request { call, id: None }, now);
        }
    }

    /// Takes news from the half that submits. Returns the call of a request that the ledger has rejected.
    pub(in crate::routes) fn update(&mut self, update: SubmitUpdate) -> Option<C> {
        match update {
            SubmitUpdate::Submitted(number, id) => {
                if let Some(request) = self.lanes.iter_mut().find_map(|lane| lane.get_mut(&number)) {
                    request.id = Some(id);
                    self.numbers.insert(id, number);
                }
                None
            }
            SubmitUpdate::Refused(number) => self.take(number),
        }
    }

    /// The call for which the reply to this transaction is; it waits no longer. Other replies are for other bridges.
    pub(in crate::routes) fn replied(&mut self, id: &Hash) -> Option<C> {
        let number = *self.numbers.get(id)?;
        self.take(number)
    }

    /// When the first of them has waited long enough.
    pub(in crate::routes) fn due(&self) -> Option<Instant> {
        self.lanes.iter().filter_map(Waiting::due).min()
    }

    /// Those that have waited long enough, and wait no longer.
    pub(in crate::routes) fn expire(&mut self, now: Instant) -> Vec<C> {
        let expired: Vec<Request<C>> = self.lanes.iter_mut().flat_map(|lane| lane.expire(now)).collect();
        expired.into_iter().map(|request| self.forget(request)).collect()
    }

    fn take(&mut self, number: u64) -> Option<C> {
        let request = self.lanes.iter_mut().find_map(|lane| lane.take(&number))?;
        Some(self.forget(request))
    }

    fn forget(&mut self, Request { call, id }: Request<C>) -> C {
        if let Some(id) = id {
            self.numbers.remove(&id);
        }
        call
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: Hash = Hash([7; 32]);

    fn pending(start: Instant) -> PendingRequests<&'static str, 2> {
        let mut pending = PendingRequests::new([Duration::from_secs(1), Duration::from_secs(10)]);
        pending.insert(0, 1, "quick", start);
        pending.insert(1, 2, "slow", start);
        pending
    }

    #[test]
    fn a_reply_finds_its_request_by_the_transaction_once() {
        let mut pending = pending(Instant::now());
        assert_eq!(pending.replied(&ID), None, "it was not submitted yet");
        assert_eq!(pending.update(SubmitUpdate::Submitted(2, ID)), None);
        assert_eq!((pending.replied(&ID), pending.replied(&ID)), (Some("slow"), None));
    }

    #[test]
    fn a_rejected_request_and_one_that_waits_too_long_are_forgotten() {
        let start = Instant::now();
        let mut pending = pending(start);
        assert_eq!(pending.due(), Some(start + Duration::from_secs(1)));
        assert_eq!(pending.update(SubmitUpdate::Refused(1)), Some("quick"));
        assert_eq!(pending.update(SubmitUpdate::Submitted(2, ID)), None);
        assert_eq!(pending.expire(start + Duration::from_secs(10)), ["slow"]);
        assert_eq!((pending.replied(&ID), pending.due()), (None, None));
        assert!(pending.numbers.is_empty());
    }
}
