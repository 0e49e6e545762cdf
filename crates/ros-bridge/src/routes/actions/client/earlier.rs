//! The goals of earlier bridges: those that run when this one comes. Without IO.
//!
//! A bridge that was killed, or has lost DDS, has cancelled nothing. A status does not say who has set a goal, and a server keeps its last
//! status for readers that come late. So each goal in the first status of a server counts as an earlier bridge's. Goals that were
//! accepted since this bridge came are others': it knows its own. Only the server's clock tells that, so it counts for no later status:
//! by a simulated clock every goal is old.

use std::collections::BTreeSet;

use crate::routes::actions::frame::{GoalId, GoalState};

/// Most servers that are remembered; beyond it all count as new again.
const SERVERS_MAX: usize = 64;

/// Finds the goals that ran when the bridge came.
#[derive(Debug)]
pub(super) struct EarlierGoals {
    /// When the bridge came (microseconds since 1970). None where no bridge can have set a goal.
    came: Option<u64>,
    /// The servers whose first status was looked at.
    heard: BTreeSet<[u8; 16]>,
}

impl EarlierGoals {
    pub(super) fn new(came: Option<u64>) -> Self {
        Self { came, heard: BTreeSet::new() }
    }

    /// Takes a status of a server, and the time (microseconds since 1970). Answers with the goals that ran when the bridge came; none if
    /// it is not the first one.
    pub(super) fn look(&mut self, server: [u8; 16], status: &[GoalState], now: u64) -> Option<Vec<GoalId>> {
        let came = self.came?;
        if self.heard.len() >= SERVERS_MAX && !self.heard.contains(&server) {
            self.heard.clear();
        }
        if !self.heard.insert(server) {
            return None;
        }
        // Where somebody has set the clock back, a goal of before seems to be of the future.
        let is_since = |stated: &GoalState| came < stated.accepted && stated.accepted <= now;
        let ran = status.iter().filter(|stated| !stated.is_over() && !is_since(stated));
        Some(ran.map(|stated| stated.goal).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAME: u64 = 1_000_000;
    const NOW: u64 = 1_500_000;
    const SERVER: [u8; 16] = [1; 16];

    fn runs(goal: u8, accepted: u64) -> GoalState {
        GoalState { goal: [goal; 16], accepted, state: 2 }
    }

    #[test]
    fn the_goals_that_run_in_the_first_status_of_a_server_are_those_of_earlier_bridges() {
        let mut earlier = EarlierGoals::new(Some(CAME));
        let over = GoalState { state: 4, ..runs(3, 10) };
        assert_eq!(earlier.look(SERVER, &[runs(1, 10), over, runs(2, CAME)], NOW), Some(vec![[1; 16], [2; 16]]));
        assert_eq!(earlier.look(SERVER, &[runs(4, 10)], NOW), None, "somebody else has set it since");
        assert_eq!(earlier.look([2; 16], &[runs(4, 10)], NOW), Some(vec![[4; 16]]), "a server that was found later");
        assert_eq!(earlier.look([3; 16], &[], NOW), Some(Vec::new()));
    }

    #[test]
    fn a_goal_that_was_accepted_since_the_bridge_came_is_somebody_elses() {
        let mut earlier = EarlierGoals::new(Some(CAME));
        let status = [runs(1, CAME + 1), runs(2, NOW), runs(3, NOW + 1)];
        assert_eq!(earlier.look(SERVER, &status, NOW), Some(vec![[3; 16]]), "the clock was set back");
    }

    #[test]
    fn where_no_bridge_can_have_set_a_goal_none_is_found() {
        assert_eq!(EarlierGoals::new(None).look(SERVER, &[runs(1, 10)], NOW), None);
    }

    #[test]
    fn servers_do_not_fill_the_memory() {
        let mut earlier = EarlierGoals::new(Some(CAME));
        for server in 0..3 * SERVERS_MAX as u128 {
            assert!(earlier.look(server.to_be_bytes(), &[], NOW).is_some());
            assert!(earlier.look(server.to_be_bytes(), &[], NOW).is_none());
        }
        assert!(earlier.heard.len() <= SERVERS_MAX);
    }
}
