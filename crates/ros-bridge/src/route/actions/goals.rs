//! The goals that a bridge has passed on, and when they are to be cancelled. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::{super::calls::CALLS_MAX, GoalId};

/// A goal that does not end is cancelled again after so long.
const AGAIN: Duration = Duration::from_secs(1);

/// The goals that have not ended.
#[derive(Debug)]
pub(in crate::route) struct Goals {
    goals: BTreeMap<GoalId, State>,
    /// How long one may run; none for as long as it takes.
    patience: Option<Duration>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// The server has not said yet whether it accepts it. `stopped`: it is to be cancelled then.
    Asked { stopped: bool },
    /// It runs, until then at most.
    Runs(Option<Instant>),
    /// It is being cancelled, and is again at that time.
    Ends(Instant),
}

impl Goals {
    pub(in crate::route) fn new(patience: Option<Duration>) -> Self {
        Self { goals: BTreeMap::new(), patience }
    }

    /// Is there no room for another one?
    pub(in crate::route) fn is_full(&self) -> bool {
        self.goals.len() >= CALLS_MAX
    }

    /// Has every goal ended?
    pub(in crate::route) fn is_empty(&self) -> bool {
        self.goals.is_empty()
    }

    /// Has this goal been set here, and not ended?
    pub(in crate::route) fn has(&self, goal: &GoalId) -> bool {
        self.goals.contains_key(goal)
    }

    /// A goal is being set. One that is set already stays as it is.
    pub(in crate::route) fn ask(&mut self, goal: GoalId) {
        self.goals.entry(goal).or_insert(State::Asked { stopped: false });
    }

    /// The server has answered. True if the goal is to be cancelled at once: the robot was to stop meanwhile.
    pub(in crate::route) fn answered(&mut self, goal: &GoalId, is_accepted: bool, now: Instant) -> bool {
        let Some(state @ State::Asked { .. }) = self.goals.get_mut(goal) else { return false };
        if !is_accepted {
            self.goals.remove(goal);
            return false;
        }
        let stopped = *state == State::Asked { stopped: true };
        *state = if stopped { State::Ends(now + AGAIN) } else { State::Runs(self.patience.map(|most| now + most)) };
        stopped
    }

    /// The server has not answered in time. The goal is to be cancelled, in case that it has heard of it.
    pub(in crate::route) fn unanswered(&mut self, goal: &GoalId, now: Instant) {
        if let Some(state) = self.goals.get_mut(goal) {
            *state = State::Ends(now + AGAIN);
        }
    }

    /// A goal has ended. True if it was known.
    pub(in crate::route) fn ended(&mut self, goal: &GoalId) -> bool {
        self.goals.remove(goal).is_some()
    }

    /// The server is gone, and every goal with it.
    pub(in crate::route) fn forget(&mut self) {
        self.goals.clear();
    }

    /// The robot is to stop: answers with the goals that are to be cancelled now.
    pub(in crate::route) fn stop(&mut self, now: Instant) -> Vec<GoalId> {
        for state in self.goals.values_mut() {
            match state {
                State::Asked { stopped } => *stopped = true,
                State::Runs(_) => *state = State::Ends(now),
                State::Ends(_) => {}
            }
        }
        self.overdue(now)
    }

    /// When a goal is to be cancelled next.
    pub(in crate::route) fn due(&self) -> Option<Instant> {
        let due = self.goals.values().filter_map(|state| match state {
            State::Asked { .. } => None,
            State::Runs(until) => *until,
            State::Ends(again) => Some(*again),
        });
        due.min()
    }

    /// The goals that are to be cancelled now: they have run for too long, or were cancelled and have not ended.
    pub(in crate::route) fn overdue(&mut self, now: Instant) -> Vec<GoalId> {
        let mut overdue = Vec::new();
        for (goal, state) in &mut self.goals {
            if let State::Runs(Some(due)) | State::Ends(due) = *state
                && due <= now
            {
                *state = State::Ends(now + AGAIN);
                overdue.push(*goal);
            }
        }
        overdue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOAL: GoalId = [1; 16];

    #[test]
    fn a_goal_that_runs_is_cancelled_when_the_robot_stops_and_again_until_it_has_ended() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        goals.ask(GOAL);
        assert!(!goals.answered(&GOAL, true, start));
        assert_eq!(goals.due(), None, "it may run for as long as it takes");
        assert_eq!(goals.stop(start), [GOAL]);
        assert_eq!(goals.stop(start), [[0; 16]; 0], "once");
        assert_eq!(goals.due(), Some(start + AGAIN));
        assert_eq!(goals.overdue(start + AGAIN), [GOAL]);
        assert!(goals.ended(&GOAL) && goals.is_empty() && goals.due().is_none());
    }

    #[test]
    fn a_goal_that_is_accepted_after_the_stop_is_cancelled_at_once() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        goals.ask(GOAL);
        assert_eq!(goals.stop(start), [[0; 16]; 0]);
        assert!(goals.answered(&GOAL, true, start));
        goals.ask([2; 16]);
        assert!(!goals.answered(&[2; 16], false, start) && !goals.has(&[2; 16]), "it was never accepted");
    }

    #[test]
    fn a_goal_that_runs_for_too_long_or_whose_server_does_not_answer_is_cancelled() {
        let (mut goals, start) = (Goals::new(Some(Duration::from_secs(5))), Instant::now());
        goals.ask(GOAL);
        goals.answered(&GOAL, true, start);
        assert_eq!(goals.overdue(start + Duration::from_millis(4999)), [[0; 16]; 0]);
        assert_eq!(goals.overdue(start + Duration::from_secs(5)), [GOAL]);
        goals.ask([2; 16]);
        goals.unanswered(&[2; 16], start);
        assert_eq!(goals.overdue(start + AGAIN), [[2; 16]]);
    }

    #[test]
    fn a_goal_with_the_id_of_one_that_is_being_cancelled_does_not_revive_it() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        goals.ask(GOAL);
        goals.answered(&GOAL, true, start);
        goals.stop(start);
        goals.ask(GOAL);
        assert!(!goals.answered(&GOAL, true, start));
        assert_eq!(goals.overdue(start + AGAIN), [GOAL]);
    }
}
