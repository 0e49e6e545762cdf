//! How grants end, and what that means for the tasks that they serve.

use super::tasks::State;
use super::{Grant, Model};

/// Why a grant ends, as far as it matters to a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Why {
    /// Its holder gave it back.
    GivenBack,
    /// Somebody or something with more right: a higher priority, one above every rule, a stop of the robot.
    Interrupted,
    /// Its lease, its certificate, policies, or the owner.
    Failed,
}

impl Model {
    /// Ends grants of a service.
    pub(super) fn end_of(&mut self, id: &str, why: Why, time: u64, ends: impl Fn(&Grant) -> bool) {
        let Some(grants) = self.grants.get_mut(id) else { return };
        let served: Vec<u64> = grants.iter().filter(|grant| ends(grant)).filter_map(|grant| grant.task).collect();
        grants.retain(|grant| !ends(grant));
        for task in served {
            self.interrupted(task, why, time);
        }
    }

    /// Ends grants of all services.
    pub(super) fn end_everywhere(&mut self, why: Why, time: u64, ends: impl Fn(&Grant) -> bool) {
        let ids: Vec<String> = self.grants.keys().cloned().collect();
        for id in ids {
            self.end_of(&id, why, time, &ends);
        }
    }

    /// Ends the grant with this epoch, if one is given.
    pub(super) fn end_epoch(&mut self, id: &str, epoch: Option<u64>, why: Why, time: u64) {
        if let Some(epoch) = epoch {
            self.end_of(id, why, time, |grant| grant.epoch == epoch);
        }
    }

    /// A running task has lost its grant.
    fn interrupted(&mut self, task: u64, why: Why, time: u64) {
        let Some(task) = self.task_mut(task).filter(|task| task.state == State::Running) else { return };
        match why {
            Why::GivenBack => task.end(State::Cancelled, time),
            Why::Interrupted if task.requeue => {
                // It goes to the end of the line with the next block.
                task.state = State::Waiting;
                task.joins = Some(time);
            }
            Why::Interrupted => task.end(State::Preempted, time),
            Why::Failed => task.end(State::Failed, time),
        }
    }
}
