//! When a replica wants to be woken although nothing comes in.
//!
//! An engine counts its timeouts in ticks. One that is the only member of its network has no timeouts. Then it wakes
//! for what comes in and for deadlines of chaincodes, and else only to look at the clock, which may have been set.

/// Longest wait without a tick, microseconds.
const TICKLESS_MAX: u64 = 1_000_000;

/// The ticks of one engine. All times are in microseconds of one clock that does not go back.
pub(crate) struct Ticks {
    every: u64,
    /// When the next one is due.
    next: u64,
    /// Something has happened since the last one, so that there is something to report.
    worked: bool,
}

impl Ticks {
    /// The first one is due at once.
    pub(crate) fn every(every: u64, now: u64) -> Self {
        Self { every, next: now, worked: true }
    }

    /// Takes the next tick, if it is due.
    pub(crate) fn due(&mut self, now: u64) -> bool {
        let due = self.next <= now;
        if due {
            self.next = self.next.saturating_add(self.every).max(now);
            self.worked = false;
        }
        due
    }

    /// The engine was given something else than a tick.
    pub(crate) fn note_work(&mut self) {
        self.worked = true;
    }

    /// How long the thread may wait if nothing comes in. `needed`: ticks mean something to the engine.
    pub(crate) fn wait(&self, now: u64, needed: bool) -> u64 {
        let until = if needed || self.worked { self.next } else { self.next.max(now.saturating_add(TICKLESS_MAX)) };
        until.saturating_sub(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: u64 = 50_000;

    /// Turns of the loop in so many ticks of simulated time in which nothing comes in.
    fn turns(ticks: &mut Ticks, mut now: u64, count: u64, needed: bool) -> u64 {
        let end = now + TICK * count;
        let mut turns = 0;
        while now < end {
            ticks.due(now);
            now += ticks.wait(now, needed);
            turns += 1;
        }
        turns
    }

    #[test]
    fn a_hundred_idle_ticks_are_a_hundred_turns_of_a_member_and_few_of_a_node_alone() {
        let now = 7_000_000;
        assert_eq!(turns(&mut Ticks::every(TICK, now), now, 100, true), 100);
        assert_eq!(turns(&mut Ticks::every(TICK, now), now, 100, false), 5, "one a second");
    }

    #[test]
    fn what_has_happened_is_reported_with_the_next_tick_also_by_a_node_alone() {
        let now = 7_000_000;
        let mut ticks = Ticks::every(TICK, now);
        assert!(ticks.due(now) && !ticks.due(now));
        assert!(ticks.wait(now, false) > TICK);
        ticks.note_work();
        assert_eq!(ticks.wait(now, false), TICK);
    }

    #[test]
    fn ticks_that_were_missed_are_not_made_up_for() {
        let now = 7_000_000;
        let mut ticks = Ticks::every(TICK, now);
        let later = now + TICK * 100;
        assert!(ticks.due(now) && ticks.due(later) && ticks.due(later), "one late, one on time");
        assert!(!ticks.due(later), "and no more");
        assert_eq!(ticks.wait(later, true), TICK);
    }
}
