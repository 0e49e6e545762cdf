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

/// How far the block time that a node tells may be ahead of the wall clock and of what voters have signed, in microseconds.
const AHEAD_US_MAX: u64 = 5_000_000;

/// Block time as it was heard, going on by the steady clock.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// As the node told it.
    told: Option<Anchor>,
    /// As voters have signed it.
    signed: Option<Anchor>,
}

/// A block time, and when it was heard by the steady clock (microseconds).
#[derive(Clone, Copy, Debug)]
struct Anchor {
    block_time: u64,
    since: u64,
}

impl Clock {
    /// Takes note of a block time that a node tells. False if it is too far ahead to be believed.
    pub(super) fn heard(&mut self, block_time: u64, now: Now) -> bool {
        let credible = block_time <= self.signed(now).saturating_add(AHEAD_US_MAX);
        if credible {
            Anchor::note(&mut self.told, block_time, now);
        }
        credible
    }

    /// Takes note of a block time that voters have signed.
    pub(super) fn heard_signed(&mut self, block_time: u64, now: Now) {
        Anchor::note(&mut self.signed, block_time, now);
    }

    /// Microseconds since the UNIX epoch: the wall clock, or block time if that is further.
    pub(super) fn now(&self, now: Now) -> u64 {
        self.block_time(now).max(now.wall)
    }

    /// The same without what a node alone has told.
    pub(super) fn signed(&self, now: Now) -> u64 {
        self.signed_block_time(now).max(now.wall)
    }

    /// Block time without the wall clock; 0 if none was heard lately.
    pub(super) fn block_time(&self, now: Now) -> u64 {
        Anchor::at(self.told, now).max(self.signed_block_time(now))
    }

    /// The same without what a node alone has told.
    pub(super) fn signed_block_time(&self, now: Now) -> u64 {
        Anchor::at(self.signed, now)
    }
}

/// A moment before which nothing counts. A wall clock that was set back was wrong then, so its part goes back with it: else nothing
/// would count until it is there again.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bound {
    /// Block time at that moment, which no clock of this machine moves.
    block_time: u64,
    /// The clocks of this machine at that moment.
    read: Option<Now>,
}

impl Bound {
    /// No earlier than this block time.
    pub(super) fn hear(&mut self, block_time: u64) {
        self.block_time = self.block_time.max(block_time);
    }

    /// No earlier than now, with the block time of now.
    pub(super) fn reach(&mut self, block_time: u64, now: Now) {
        self.hear(block_time);
        self.read = Some(now);
    }

    /// The moment by the steady clock, microseconds; 0 if there was none.
    pub(super) fn steady(&self) -> u64 {
        self.read.map_or(0, |read| read.steady)
    }

    /// The bound in microseconds since the UNIX epoch, by the clocks as they are now. It is the same as long as none of them jumps.
    pub(super) fn at(&self, now: Now) -> u64 {
        let by_clock = |then: Now| then.wall.min(now.wall.saturating_add(then.steady).saturating_sub(now.steady));
        self.read.map_or(0, by_clock).max(self.block_time)
    }
}

impl Anchor {
    fn note(kept: &mut Option<Self>, block_time: u64, now: Now) {
        if block_time > Self::at(*kept, now) {
            *kept = Some(Self { block_time, since: now.steady });
        }
    }

    /// The time that it says now; 0 if it says nothing any more.
    fn at(kept: Option<Self>, now: Now) -> u64 {
        let Some(Self { block_time, since }) = kept else { return 0 };
        let elapsed = now.steady.saturating_sub(since);
        if elapsed <= ANCHOR_US_MAX { block_time.saturating_add(elapsed - elapsed / SLOWER) } else { 0 }
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
    fn a_bound_goes_back_with_a_wall_clock_that_is_set_back_and_never_on_nor_before_block_time() {
        let mut bound = Bound::default();
        let at = |wall, steady| Now { wall, steady };
        assert_eq!(bound.at(at(9_000, 50)), 0);
        bound.reach(0, at(9_000, 50));
        assert_eq!(bound.at(at(9_700, 750)), 9_000, "time goes on");
        assert_eq!(bound.at(at(20_000, 750)), 9_000, "the clock was set forward");
        assert_eq!(bound.at(at(2_700, 750)), 2_000, "it was set back by seven seconds");
        bound.hear(2_500);
        assert_eq!(bound.at(at(2_700, 750)), 2_500);
        bound.reach(2_400, at(2_800, 850));
        assert_eq!(bound.at(at(2_900, 950)), 2_800);
    }

    #[test]
    fn a_wrong_block_time_is_forgotten() {
        let mut clock = Clock::default();
        let now = Now { wall: 1_000, steady: 0 };
        assert!(clock.heard(now.wall + AHEAD_US_MAX, now));
        let later = Now { wall: 1_000 + ANCHOR_US_MAX, steady: ANCHOR_US_MAX + 1 };
        assert_eq!(clock.now(later), later.wall);
    }

    #[test]
    fn a_node_alone_moves_the_time_no_further_than_five_seconds_and_the_voters_do() {
        let (mut clock, now) = (Clock::default(), Now { wall: 1_000, steady: 0 });
        assert!(clock.heard(now.wall + AHEAD_US_MAX, now));
        assert!(!clock.heard(now.wall + AHEAD_US_MAX + 1, now), "what it said before is no reason to believe more");
        assert_eq!(clock.signed(now), now.wall);
        let ahead = now.wall + 3600 * 1_000_000;
        clock.heard_signed(ahead, now);
        assert_eq!((clock.signed(now), clock.now(now)), (ahead, ahead));
        assert!(clock.heard(ahead + AHEAD_US_MAX, now));
    }
}
