//! When a route asks how its robot stands.
//!
//! At once when the ledger tells that something changed, or a message comes of which nothing is known. While somebody moves the
//! robot, thrice in the time for which an answer counts. Never while it rests.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::future::BoxFuture;
use ledger_rejection::Rejection;

use crate::standing::{Asker, Standing};

/// Time between two questions, at least: a node that makes up changes costs the network no more than that.
const GAP: Duration = Duration::from_millis(50);
/// The same after a question that got no answer.
const GAP_AFTER_FAILURE: Duration = Duration::from_millis(250);
/// A question asks for the answer that another route of the robot has got in this time.
const SHARED: Duration = Duration::from_millis(50);
/// Questions in the time for which an answer counts, while somebody moves the robot.
const QUESTIONS: u32 = 3;

/// The answer to a question.
pub(super) type Answer = Result<Arc<Standing>, Rejection>;

/// The questions of a route.
pub(super) struct Questions {
    asker: Arc<Asker>,
    stale_after: Duration,
    under_way: Option<BoxFuture<'static, Answer>>,
    /// Something changed at that moment, and no answer is as new.
    changed: Option<Instant>,
    /// When the newest answer was asked for, or the last question that failed.
    asked: Option<Instant>,
    failed: bool,
}

impl Questions {
    /// Nothing is known yet.
    pub(super) fn new(asker: Arc<Asker>, stale_after: Duration, now: Instant) -> Self {
        Self { asker, stale_after, under_way: None, changed: Some(now), asked: None, failed: false }
    }

    /// Something may have changed at that moment.
    pub(super) fn changed(&mut self, now: Instant) {
        self.changed = Some(now);
    }

    /// When to ask next; none if nothing is to be asked, or a question is under way.
    pub(super) fn due(&self, is_moving: bool) -> Option<Instant> {
        if self.under_way.is_some() || !(is_moving || self.changed.is_some()) {
            return None;
        }
        let pause = match (self.failed, self.changed) {
            (true, _) => GAP_AFTER_FAILURE,
            (false, Some(_)) => GAP,
            (false, None) => self.stale_after / QUESTIONS,
        };
        Some(self.asked.map_or_else(Instant::now, |asked| asked + pause))
    }

    /// Asks.
    pub(super) fn ask(&mut self, now: Instant) {
        let (asker, since) = (Arc::clone(&self.asker), self.changed.unwrap_or(now.checked_sub(SHARED).unwrap_or(now)));
        self.asked = Some(now);
        self.under_way = Some(Box::pin(async move { asker.ask(since).await }));
    }

    /// The answer to the question under way; waits for ever if there is none.
    pub(super) async fn answer(&mut self) -> Answer {
        let Some(question) = &mut self.under_way else { return std::future::pending().await };
        let answer = question.await;
        self.under_way = None;
        self.failed = answer.is_err();
        if let Ok(standing) = &answer {
            self.asked = Some(standing.asked);
            self.changed = self.changed.filter(|changed| *changed > standing.asked);
        }
        answer
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::{fake::Fake, fixture::shared};
    use std::sync::atomic::Ordering;

    const STALE_AFTER: Duration = Duration::from_millis(900);

    #[tokio::test]
    async fn a_robot_that_rests_asks_nothing_and_one_that_moves_asks_thrice_in_the_time_for_which_an_answer_counts() {
        let fake = Fake::new("exclusive", shared());
        let asker = Asker::new(fake.clone(), "T", Arc::clone(&shared().msps), None).unwrap();
        let mut questions = Questions::new(Arc::new(asker), STALE_AFTER, Instant::now());
        assert!(questions.due(false).unwrap() <= Instant::now(), "nothing is known yet");
        questions.ask(Instant::now());
        assert_eq!(questions.due(true), None, "one at a time");
        let asked = questions.answer().await.unwrap().asked;
        assert_eq!(questions.due(false), None);
        assert_eq!(questions.due(true), Some(asked + STALE_AFTER / 3));

        questions.changed(Instant::now());
        assert_eq!(questions.due(false), Some(asked + GAP), "a node that tells of changes all the time");
        fake.answers.store(false, Ordering::Relaxed);
        let again = Instant::now();
        questions.ask(again);
        questions.answer().await.unwrap_err();
        assert_eq!(questions.due(false), Some(again + GAP_AFTER_FAILURE));
    }

    #[tokio::test]
    async fn what_changed_after_a_question_is_asked_for_again() {
        let fake = Fake::new("exclusive", shared());
        let asker = Asker::new(fake, "T", Arc::clone(&shared().msps), None).unwrap();
        let mut questions = Questions::new(Arc::new(asker), STALE_AFTER, Instant::now());
        questions.ask(Instant::now());
        let asked = questions.answer().await.unwrap().asked;
        questions.ask(Instant::now());
        let later = asked + Duration::from_secs(1);
        questions.changed(later);
        questions.answer().await.unwrap();
        assert!(questions.due(false).is_some(), "the answer may be older than the change");
    }
}
