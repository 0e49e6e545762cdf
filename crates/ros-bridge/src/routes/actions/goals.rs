//! The goals that a bridge has passed on, and when they are to be cancelled. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::frame::GoalId;
use crate::routes::ends::CALLS_MAX;

/// A goal that does not end is cancelled again after so long.
const AGAIN: Duration = Duration::from_secs(1);

/// The goals that have not ended.
#[derive(Debug)]
pub(in crate::routes) struct Goals {
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
    /// Its server has left, and is to cancel it when it comes back.
    Left,
}

impl State {
    /// The goal is to be cancelled: now if it runs, and when it is accepted if it is not yet.
    fn stop(&mut self, now: Instant) {
        match self {
            Self::Asked { stopped } => *stopped = true,
            Self::Runs(_) => *self = Self::Ends(now),
            Self::Ends(_) | Self::Left => {}
        }
    }
}

impl Goals {
    pub(in crate::routes) fn new(patience: Option<Duration>) -> Self {
        Self { goals: BTreeMap::new(), patience }
    }

    /// Is there no room for another one?
    pub(in crate::routes) fn is_full(&self) -> bool {
        self.goals.len() >= CALLS_MAX
    }

    /// Has every goal ended?
    pub(in crate::routes) fn is_empty(&self) -> bool {
        self.goals.is_empty()
    }

    /// Does none run, as far as it can be known? Where the server has left, nobody can stop anything.
    pub(in crate::routes) fn rests(&self) -> bool {
        self.goals.values().all(|state| *state == State::Left)
    }

    /// Has this goal been set here, and not ended?
    pub(in crate::routes) fn has(&self, goal: &GoalId) -> bool {
        self.goals.contains_key(goal)
    }

    /// A goal is being set. One that is set already stays as it is.
    pub(in crate::routes) fn ask(&mut self, goal: GoalId) {
        self.goals.entry(goal).or_insert(State::Asked { stopped: false });
    }

    /// The server has answered. True if the goal is to be cancelled at once: the robot was to stop meanwhile.
    pub(in crate::routes) fn answered(&mut self, goal: &GoalId, is_accepted: bool, now: Instant) -> bool {
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
    pub(in crate::routes) fn unanswered(&mut self, goal: &GoalId, now: Instant) {
        if let Some(state) = self.goals.get_mut(goal).filter(|state| **state != State::Left) {
            *state = State::Ends(now + AGAIN);
        }
    }

    /// A goal that another bridge has set is to be cancelled. False if it is known here.
    pub(in crate::routes) fn found(&mut self, goal: GoalId, now: Instant) -> bool {
        let is_new = !self.has(&goal);
        self.goals.entry(goal).or_insert(State::Ends(now + AGAIN));
        is_new
    }

    /// A goal has ended. True if it was known.
    pub(in crate::routes) fn ended(&mut self, goal: &GoalId) -> bool {
        self.goals.remove(goal).is_some()
    }

    /// The server does not know this goal. One that it has not answered yet may still be accepted, so it stays. True if it was known.
    pub(in crate::routes) fn lose(&mut self, goal: &GoalId) -> bool {
        let is_answered = self.goals.get(goal).is_some_and(|state| !matches!(state, State::Asked { .. }));
        is_answered && self.ended(goal)
    }

    /// Is this goal not known here, or has its server left?
    pub(in crate::routes) fn has_lost(&self, goal: &GoalId) -> bool {
        self.goals.get(goal).is_none_or(|state| *state == State::Left)
    }

    /// The goals that were accepted, as far as it is known, and have not ended. Not those whose server has left.
    pub(in crate::routes) fn accepted(&self) -> Vec<GoalId> {
        let is_accepted = |state: &State| matches!(state, State::Runs(_) | State::Ends(_));
        self.goals.iter().filter(|(_, state)| is_accepted(state)).map(|(goal, _)| *goal).collect()
    }

    /// The server has left: it may be gone, or stand still. True if it had goals.
    pub(in crate::routes) fn leave(&mut self) -> bool {
        let had_goals = !self.rests();
        self.goals.values_mut().for_each(|state| *state = State::Left);
        had_goals
    }

    /// A server is there: answers with the goals that are to be cancelled now because theirs had left.
    pub(in crate::routes) fn come_back(&mut self, now: Instant) -> Vec<GoalId> {
        let mut back = Vec::new();
        for (goal, state) in self.goals.iter_mut().filter(|(_, state)| **state == State::Left) {
            *state = State::Ends(now + AGAIN);
            back.push(*goal);
        }
        back
    }

    /// The robot is to stop: answers with the goals that are to be cancelled now.
    pub(in crate::routes) fn stop(&mut self, now: Instant) -> Vec<GoalId> {
        self.goals.values_mut().for_each(|state| state.stop(now));
        self.overdue(now)
    }

    /// Nobody waits for this goal any more: it is to be cancelled.
    pub(in crate::routes) fn give_up(&mut self, goal: &GoalId, now: Instant) {
        if let Some(state) = self.goals.get_mut(goal) {
            state.stop(now);
        }
    }

    /// When a goal is to be cancelled next.
    pub(in crate::routes) fn due(&self) -> Option<Instant> {
        let due = self.goals.values().filter_map(|state| match state {
            State::Asked { .. } | State::Left => None,
            State::Runs(until) => *until,
            State::Ends(again) => Some(*again),
        });
        due.min()
    }

    /// The goals that are to be cancelled now: they have run for too long, or were cancelled and have not ended.
    pub(in crate::routes) fn overdue(&mut self, now: Instant) -> Vec<GoalId> {
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
    fn the_goals_of_a_server_that_has_left_are_cancelled_when_it_comes_back_and_not_before() {
        let (mut goals, start) = (Goals::new(Some(Duration::from_secs(5))), Instant::now());
        goals.ask(GOAL);
        goals.answered(&GOAL, true, start);
        goals.ask([2; 16]);
        assert!(!goals.rests() && goals.come_back(start).is_empty(), "it has not left");
        assert!(goals.leave() && !goals.leave(), "that is news once");
        assert!(goals.rests() && !goals.is_empty(), "there is nothing to stop, and all to be cancelled");
        assert!(!goals.answered(&[2; 16], true, start));
        goals.unanswered(&[2; 16], start);
        assert_eq!((goals.stop(start + AGAIN).len(), goals.due()), (0, None), "nobody is there to be asked");
        let back = start + Duration::from_secs(20);
        assert_eq!(goals.come_back(back), [GOAL, [2; 16]]);
        assert!(!goals.rests() && goals.come_back(back).is_empty(), "once");
        assert!(goals.ended(&[2; 16]));
        assert_eq!(goals.overdue(back + AGAIN), [GOAL], "until it has ended");
        assert!(goals.ended(&GOAL) && goals.rests());
    }

    #[test]
    fn a_goal_of_an_earlier_bridge_is_cancelled_until_it_has_ended() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        goals.ask([2; 16]);
        assert!(goals.found(GOAL, start) && !goals.rests());
        assert!(!goals.found(GOAL, start) && !goals.found([2; 16], start), "they are known");
        assert_eq!(goals.overdue(start + AGAIN), [GOAL]);
        assert!(goals.ended(&GOAL) && goals.has(&[2; 16]));
    }

    #[test]
    fn a_goal_for_which_nobody_waits_any_more_is_cancelled_alone() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        for goal in [GOAL, [2; 16], [3; 16]] {
            goals.ask(goal);
        }
        goals.answered(&GOAL, true, start);
        goals.answered(&[2; 16], true, start);
        goals.give_up(&GOAL, start);
        goals.give_up(&[3; 16], start);
        assert_eq!(goals.overdue(start), [GOAL]);
        assert_eq!(goals.overdue(start), [[0; 16]; 0], "once");
        assert!(goals.answered(&[3; 16], true, start), "when it is accepted");
        assert_eq!(goals.overdue(start + AGAIN), [GOAL, [3; 16]], "until they have ended");
    }

    #[test]
    fn a_goal_that_its_server_does_not_know_is_lost_unless_it_may_still_be_accepted() {
        let (mut goals, start) = (Goals::new(None), Instant::now());
        for goal in [GOAL, [2; 16], [3; 16]] {
            goals.ask(goal);
        }
        goals.answered(&GOAL, true, start);
        goals.answered(&[2; 16], true, start);
        goals.give_up(&[2; 16], start);
        assert_eq!(goals.accepted(), [GOAL, [2; 16]]);
        assert!(goals.lose(&GOAL) && goals.lose(&[2; 16]) && !goals.lose(&GOAL), "once");
        assert!(!goals.lose(&[3; 16]) && goals.has(&[3; 16]));
        assert!(goals.has_lost(&GOAL) && !goals.has_lost(&[3; 16]));
        goals.leave();
        assert!(goals.has_lost(&[3; 16]) && goals.accepted().is_empty(), "nobody is there who runs it");
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
