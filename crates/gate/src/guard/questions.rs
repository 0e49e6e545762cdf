//! When to ask how a robot stands.
//!
//! At once when the node tells that something changed, or a message comes of which nothing is known. While somebody moves the
//! robot, or a stop has no verdict, thrice in the time for which an answer counts. Never while it rests otherwise. Times are of the steady clock, in microseconds.

/// Time between two questions, at least: a node that makes up changes costs the network no more than that.
const GAP_US: u64 = 50_000;
/// The same after a question that got no answer.
const GAP_AFTER_FAILURE_US: u64 = 250_000;
/// A question asks for the answer that another service of the robot has got in this time.
const SHARED_US: u64 = 50_000;
/// Questions in the time for which an answer counts, while somebody moves the robot.
const QUESTIONS: u64 = 3;

/// The questions about one service.
#[derive(Debug)]
pub(super) struct Questions {
    stale_us: u64,
    under_way: bool,
    /// Something changed at that moment, and no answer is as new.
    changed: Option<u64>,
    /// When the newest answer was asked for, or the last question that failed.
    asked: Option<u64>,
    failed: bool,
}

impl Questions {
    /// Nothing is known yet.
    pub(super) fn new(stale_us: u64, now: u64) -> Self {
        Self { stale_us, under_way: false, changed: Some(now), asked: None, failed: false }
    }

    /// Something may have changed at that moment.
    pub(super) fn changed(&mut self, now: u64) {
        self.changed = Some(now);
    }

    /// When to ask next; none if nothing is to be asked, or a question is under way.
    pub(super) fn due(&self, is_awaited: bool) -> Option<u64> {
        if self.under_way || !(is_awaited || self.changed.is_some()) {
            return None;
        }
        let pause = match (self.failed, self.changed) {
            (true, _) => GAP_AFTER_FAILURE_US,
            (false, Some(_)) => GAP_US,
            (false, None) => self.stale_us / QUESTIONS,
        };
        Some(self.asked.map_or(0, |asked| asked.saturating_add(pause)))
    }

    /// A question is asked. Answers since when it must have been asked to count.
    pub(super) fn ask(&mut self, now: u64) -> u64 {
        (self.asked, self.under_way) = (Some(now), true);
        self.changed.unwrap_or(now.saturating_sub(SHARED_US))
    }

    /// A question that was asked at that moment is answered.
    pub(super) fn answered(&mut self, asked: u64) {
        (self.asked, self.under_way, self.failed) = (Some(asked), false, false);
        self.changed = self.changed.filter(|changed| *changed > asked);
    }

    /// The question got no answer.
    pub(super) fn failed(&mut self) {
        (self.under_way, self.failed) = (false, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STALE_US: u64 = 900_000;

    #[test]
    fn a_robot_that_rests_asks_nothing_and_one_that_moves_asks_thrice_in_the_time_for_which_an_answer_counts() {
        let mut questions = Questions::new(STALE_US, 7);
        assert_eq!(questions.due(false), Some(0), "nothing is known yet");
        assert_eq!(questions.ask(1_000_000), 7);
        assert_eq!(questions.due(true), None, "one at a time");
        questions.answered(1_000_000);
        assert_eq!(questions.due(false), None);
        assert_eq!(questions.due(true), Some(1_000_000 + STALE_US / 3));
        assert_eq!(questions.ask(1_300_000), 1_300_000 - SHARED_US, "another may have asked a moment before");
        questions.answered(1_300_000 - SHARED_US);

        questions.changed(1_300_000);
        assert_eq!(
            questions.due(false),
            Some(1_300_000 - SHARED_US + GAP_US),
            "a node that tells of changes all the time"
        );
        questions.ask(1_400_000);
        questions.failed();
        assert_eq!(questions.due(false), Some(1_400_000 + GAP_AFTER_FAILURE_US));
    }

    #[test]
    fn what_changed_after_a_question_is_asked_for_again() {
        let mut questions = Questions::new(STALE_US, 0);
        questions.ask(1_000_000);
        questions.changed(1_000_001);
        questions.answered(1_000_000);
        assert!(questions.due(false).is_some(), "the answer may be older than the change");
        assert_eq!(questions.ask(2_000_000), 1_000_001);
    }
}
