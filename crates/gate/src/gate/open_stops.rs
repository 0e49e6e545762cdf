//! Stops that the gate was notified of before their verdict: each keeps the robot stopped until a certified answer settles it.

use std::collections::{BTreeMap, BTreeSet};

use ledger::CallRef;
use ledger::transaction::NOT_AFTER_AHEAD_MAX;
use ledger_base::hash::Hash;

/// Most stops that are remembered. Beyond it the robot stays stopped until the last one that found no room is over.
pub(super) const OPEN_STOPS_MAX: usize = 32;
/// How far `not_after` may be ahead of certified block time, in microseconds. The clock of the node that took the call in may be
/// ahead of block time, so it is twice what the ledger accepts. A call beyond it was made up.
const AHEAD_US_MAX: u64 = 2 * NOT_AFTER_AHEAD_MAX;

/// The open stops of a robot.
#[derive(Debug, Default)]
pub(super) struct OpenStops {
    /// By their calls: until when they are open, in certified block time (microseconds).
    open: BTreeMap<CallRef, u64>,
    /// Until when those are open that found no room, microseconds.
    crowded_until: Option<u64>,
}

impl OpenStops {
    /// Remembers a stop.
    pub(super) fn note(&mut self, call: CallRef) {
        if self.open.contains_key(&call) {
            return;
        }
        if self.open.len() < OPEN_STOPS_MAX {
            self.open.insert(call, call.not_after);
        } else {
            self.crowded_until = self.crowded_until.max(Some(call.not_after));
        }
    }

    /// Takes a certified answer, of this block time in microseconds, which lists these stops as settled.
    pub(super) fn settle(&mut self, settled: &BTreeSet<Hash>, time: u64) {
        let bound = time.saturating_add(AHEAD_US_MAX);
        self.open.retain(|call, until| {
            *until = (*until).min(bound);
            *until >= time && !settled.contains(&call.id)
        });
        self.crowded_until = self.crowded_until.map(|until| until.min(bound)).filter(|until| *until >= time);
    }

    /// Is there one?
    pub(super) fn is_empty(&self) -> bool {
        self.open.is_empty() && self.crowded_until.is_none()
    }

    /// Those whose verdicts are to be asked for.
    pub(super) fn calls(&self) -> impl Iterator<Item = CallRef> {
        self.open.keys().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000;
    const NOW: u64 = 1000 * SECOND;

    fn call(number: u32) -> CallRef {
        CallRef { id: Hash::of(&[&number.to_be_bytes()]), not_after: NOW + 30 * SECOND }
    }

    #[test]
    fn a_stop_is_open_until_it_is_settled_or_block_time_has_passed_it() {
        let mut stops = OpenStops::default();
        stops.note(call(1));
        stops.note(call(2));
        stops.settle(&BTreeSet::from([call(1).id, call(7).id]), NOW);
        assert_eq!(stops.calls().collect::<Vec<_>>(), [call(2)]);
        stops.settle(&BTreeSet::new(), NOW + 30 * SECOND);
        assert!(!stops.is_empty(), "a block of that time may have it");
        stops.settle(&BTreeSet::new(), NOW + 30 * SECOND + 1);
        assert!(stops.is_empty());
    }

    #[test]
    fn beyond_the_bound_the_robot_stays_stopped_until_the_last_one_is_over() {
        let mut stops = OpenStops::default();
        (0..1000).for_each(|number| stops.note(call(number)));
        assert_eq!(stops.calls().count(), OPEN_STOPS_MAX);
        stops.settle(&(0..1000).map(|number| call(number).id).collect(), NOW);
        assert_eq!(stops.calls().count(), 0);
        assert!(!stops.is_empty(), "nobody knows which ones");
        stops.settle(&BTreeSet::new(), NOW + 30 * SECOND + 1);
        assert!(stops.is_empty());
    }

    #[test]
    fn a_stop_that_was_made_up_with_a_time_far_ahead_is_over_after_two_bounds() {
        let mut stops = OpenStops::default();
        (0..=1000).for_each(|number| stops.note(CallRef { not_after: u64::MAX, ..call(number) }));
        stops.settle(&BTreeSet::new(), NOW);
        stops.settle(&BTreeSet::new(), NOW + AHEAD_US_MAX);
        assert!(!stops.is_empty());
        stops.settle(&BTreeSet::new(), NOW + AHEAD_US_MAX + 1);
        assert!(stops.is_empty());
    }
}
