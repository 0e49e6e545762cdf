//! How often an address is dialled that does not answer.
//!
//! Every member registers its own address, and every node dials it. So that nobody makes the others knock at a door that
//! is not theirs, the pauses after each failure double. They end at a second for a node that has answered at this address
//! or that was approved to order, and at a minute for every other. A call of that node is a reason to try at once, but it
//! counts as well: such tries have a growing pause of their own. A change of the address shortens no pause.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The first pause after a failure.
const PAUSE_MIN: Duration = Duration::from_millis(50);
/// The longest before a node is tried again that answered before, or that orders.
const KNOWN_PAUSE_MAX: Duration = Duration::from_secs(1);
/// The longest before any other is.
const PAUSE_MAX: Duration = Duration::from_secs(60);

/// The pauses of all members, by their numbers.
#[derive(Default)]
pub(crate) struct Paces {
    members: Mutex<HashMap<u64, Pace>>,
}

/// Why a node is dialled now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cause {
    /// Its pause is over, or somebody needs it.
    Time,
    /// It has just called.
    Call,
}

/// The failures of one member since a connection was last of use.
#[derive(Clone, Debug, Default)]
struct Pace {
    address: String,
    /// It has answered at this address.
    answered: bool,
    failed: u32,
    failed_calls: u32,
    last: Option<Instant>,
}

impl Pace {
    fn pause(&self, votes: bool, cause: Cause) -> Duration {
        let failed = match cause {
            Cause::Time => self.failed,
            Cause::Call => self.failed_calls,
        };
        if failed == 0 {
            return Duration::ZERO;
        }
        let max = if votes || self.answered { KNOWN_PAUSE_MAX } else { PAUSE_MAX };
        PAUSE_MIN.saturating_mul(1 << failed.min(16).saturating_sub(1)).min(max)
    }

    /// Time that is left of the pause.
    fn left(&self, votes: bool, cause: Cause, now: Instant) -> Duration {
        let end = self.last.map(|last| last + self.pause(votes, cause));
        end.map_or(Duration::ZERO, |end| end.saturating_duration_since(now))
    }
}

impl Paces {
    /// How long a member may not be dialled yet. `votes`: it was approved to order.
    pub(crate) fn left(&self, (id, address): (u64, &str), votes: bool, cause: Cause, now: Instant) -> Duration {
        self.with(id, address, |pace| pace.left(votes, cause, now))
    }

    /// A member is dialled now. That counts as a failure until [`Paces::lasts`].
    pub(crate) fn dials(&self, (id, address): (u64, &str), cause: Cause, now: Instant) {
        self.with(id, address, |pace| {
            pace.last = Some(now);
            pace.failed = pace.failed.saturating_add(1);
            pace.failed_calls = pace.failed_calls.saturating_add(u32::from(cause == Cause::Call));
        });
    }

    /// It has answered, as the node that it is.
    pub(crate) fn answers(&self, (id, address): (u64, &str)) {
        self.with(id, address, |pace| pace.answered = true);
    }

    /// The connection was of use: the next pause is the first one again.
    pub(crate) fn lasts(&self, (id, address): (u64, &str)) {
        self.with(id, address, |pace| (pace.failed, pace.failed_calls) = (0, 0));
    }

    /// Forgets who is no member any more.
    pub(crate) fn keep(&self, is_member: impl Fn(u64) -> bool) {
        self.members.lock().unwrap_or_else(PoisonError::into_inner).retain(|id, _| is_member(*id));
    }

    fn with<T>(&self, id: u64, address: &str, act: impl FnOnce(&mut Pace) -> T) -> T {
        let mut members = self.members.lock().unwrap_or_else(PoisonError::into_inner);
        let pace = members.entry(id).or_default();
        if pace.address != address {
            // Somebody who moves again and again is dialled no more often than one who stays.
            (pace.address, pace.answered) = (address.to_owned(), false);
        }
        act(pace)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often a member is dialled in this time that never answers; it calls so often, and moves so often.
    fn dials(seconds: u64, votes: bool, calls_every: Option<u64>, moves_every: Option<u64>) -> u64 {
        let (paces, begun, mut count) = (Paces::default(), Instant::now(), 0);
        for step in 0..seconds * 100 {
            let now = begun + Duration::from_millis(10 * step);
            let address = moves_every.map_or(0, |every| step / every);
            let place = (7, &*format!("h:{address}"));
            let calls = calls_every.is_some_and(|every| step % every == 0);
            let cause = [Cause::Time, Cause::Call].into_iter().take(1 + usize::from(calls));
            for cause in cause {
                if paces.left(place, votes, cause, now).is_zero() {
                    paces.dials(place, cause, now);
                    count += 1;
                }
            }
        }
        count
    }

    #[test]
    fn an_address_that_never_answers_is_dialled_less_and_less_whatever_its_node_does() {
        let quiet = dials(600, false, None, None);
        assert!((15..=25).contains(&quiet), "{quiet}");
        for (calls, moves) in [(Some(1), None), (None, Some(1)), (Some(1), Some(1))] {
            let busy = dials(600, false, calls, moves);
            assert!(busy <= 2 * quiet, "{busy} after {calls:?} {moves:?}");
        }
        let voter = dials(600, true, None, None);
        assert!((590..=620).contains(&voter), "{voter}");
    }

    #[test]
    fn a_node_that_answered_is_tried_every_second_and_its_call_is_a_reason_to_try_at_once() {
        let (paces, now, place) = (Paces::default(), Instant::now(), (7, "h:1"));
        let fail = || (0..20).for_each(|_| paces.dials(place, Cause::Time, now));
        fail();
        assert_eq!(paces.left(place, false, Cause::Time, now), PAUSE_MAX);
        assert_eq!(paces.left(place, false, Cause::Call, now), Duration::ZERO);
        paces.answers(place);
        assert_eq!(paces.left(place, false, Cause::Time, now), KNOWN_PAUSE_MAX, "one that is refused at once");
        paces.lasts(place);
        assert_eq!(paces.left(place, false, Cause::Time, now), Duration::ZERO);
        fail();
        assert_eq!(paces.left(place, false, Cause::Time, now), KNOWN_PAUSE_MAX);
        assert_eq!(paces.left((7, "elsewhere:1"), false, Cause::Time, now), PAUSE_MAX, "it has not answered there");
    }
}
