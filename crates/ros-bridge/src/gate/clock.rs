//! The time, for a robot that trusts no single clock: the latest time that it knows. Later only shortens what is
//! accepted.

/// The time, as whoever runs the gate reads it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Now {
    /// Wall clock, microseconds since the UNIX epoch.
    pub wall: u64,
    /// A clock that never jumps, microseconds since any moment.
    pub steady: u64,
}

/// How long the latest block time counts on, in microseconds of the steady clock. Not for ever: a node that told one
/// wrong time must not silence the robot beyond it.
const ANCHOR_US_MAX: u64 = 10_000_000;

/// Where block time is ahead of the machines' clocks, it loses one part of so many, as nodes have it: so it comes back. A gate
/// that went on faster would take new messages for old ones.
const SLOWER: u64 = 16;

/// Block time as it was heard, going on by the steady clock.
#[derive(Debug, Default)]
pub(super) struct Clock {
    anchor: Option<(u64, u64)>,
}

impl Clock {
    /// Takes note of a block time.
    pub(super) fn heard(&mut self, block_time: u64, now: Now) {
        if self.anchored(now).is_none_or(|known| block_time > known) {
            self.anchor = Some((block_time, now.steady));
        }
    }

    /// Microseconds since the UNIX epoch: the wall clock, or block time if that is further.
    pub(super) fn now(&self, now: Now) -> u64 {
        self.anchored(now).unwrap_or(0).max(now.wall)
    }

    fn anchored(&self, now: Now) -> Option<u64> {
        let (block_time, since) = self.anchor?;
        let elapsed = now.steady.saturating_sub(since);
        (elapsed <= ANCHOR_US_MAX).then(|| block_time.saturating_add(elapsed - elapsed / SLOWER))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_time_moves_a_slow_clock_on_and_never_a_fast_one_back() {
        let mut clock = Clock::default();
        let at = |wall, steady| Now { wall, steady };
        clock.heard(5_000, at(1_000, 0));
        assert_eq!(clock.now(at(1_160, 160)), 5_150);
        clock.heard(4_000, at(1_320, 320));
        assert_eq!(clock.now(at(1_320, 320)), 5_300, "an earlier block time does not turn it back");
        assert_eq!(clock.now(at(9_000, 400)), 9_000);
    }

    #[test]
    fn messages_of_a_network_whose_time_is_ahead_and_comes_back_do_not_grow_old() {
        let mut clock = Clock::default();
        for steady in (0..ANCHOR_US_MAX).step_by(16_000) {
            let now = Now { wall: 1_000_000 + steady, steady };
            // As the nodes of such a network have it.
            let block_time = 5_000_000 + steady / 16 * 15;
            clock.heard(block_time, now);
            assert_eq!(clock.now(now), block_time, "after {steady} us");
        }
    }

    #[test]
    fn a_wrong_block_time_is_forgotten() {
        let mut clock = Clock::default();
        clock.heard(u64::MAX, Now { wall: 1_000, steady: 0 });
        let later = Now { wall: 1_000 + ANCHOR_US_MAX, steady: ANCHOR_US_MAX + 1 };
        assert_eq!(clock.now(later), later.wall);
    }
}
