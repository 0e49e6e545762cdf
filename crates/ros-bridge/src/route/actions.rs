//! Routes of actions: a goal, its feedback and its result through the ledger.
//!
//! An action of ROS 2 is three services (send a goal, cancel it, get its result) and two topics (feedback, status). All of it
//! goes over two services of the ledger, as a service does. Requests go over the one that users hold, and what the robot says
//! over the one for replies. See [`frame`] for the bytes.
//!
//! A goal runs under the grant of whoever has set it. The bridge of the robot cancels the goals that it has passed on when the gate
//! says that the robot must stop. While a goal runs and its client is there, the user's bridge gives a sign of life, which uses the
//! grant. So a lease that ends tells the robot that the user's bridge is gone. The robot's bridge answers it with the goals that it has
//! lost: else the grant would be used for them for ever.

mod frame;
mod goals;

use std::time::Duration;

use ledger_base::settings::Section;

pub(super) use self::{
    frame::{
        CANCEL_REFUSED, FEEDBACK, GOAL_REFUSED, GoalId, LOST, Part, STATUS, Stated, aborted, cancel_of, goal_of,
        goals_in, ids_in, is_accepted, is_of_no_goal, is_over, is_unknown_or_over, request_of, split_request,
    },
    goals::Goals,
};
use super::calls::WAIT_MS_MIN;
use crate::{
    error::Result,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
};

/// The setting of how long a result is waited for.
pub(super) const RESULT_KEY: &str = "result_timeout_ms";
/// Longest time that a result is waited for, or that a goal runs.
pub(super) const RUN_MS_MAX: u64 = 86_400_000;
/// `result_timeout_ms` by default: actions take their time.
const RESULT_MS_DEFAULT: u64 = 3_600_000;
/// How long a result is waited for by default.
pub(super) const RESULT_PATIENCE: Duration = Duration::from_millis(RESULT_MS_DEFAULT);
/// Depth of the topic of feedback.
const FEEDBACK_DEPTH: u32 = 10;

/// A topic of an action, with its type and its quality of service.
pub(super) struct Told {
    pub(super) topic: TopicName,
    pub(super) message: TypeName,
    pub(super) qos: Qos,
}

/// The topic of feedback.
///
/// # Errors
/// The name of the action is too long for it.
pub(super) fn feedback(action: &TopicName, of: &TypeName) -> Result<Told> {
    let qos = Qos {
        reliability: Reliability::Reliable,
        durability: Durability::Volatile,
        depth: FEEDBACK_DEPTH,
        keyed: false,
    };
    Ok(Told { topic: action.below("/_action/feedback")?, message: of.part("_FeedbackMessage"), qos })
}

/// The topic of the states of goals.
///
/// # Errors
/// As [`feedback`].
pub(super) fn status(action: &TopicName) -> Result<Told> {
    let qos =
        Qos { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: 1, keyed: false };
    let message = TypeName::parse("action_msgs/msg/GoalStatusArray")?;
    Ok(Told { topic: action.below("/_action/status")?, message, qos })
}

/// Reads how long a result is waited for.
pub(super) fn result_patience(section: &mut Section<'_, '_>) -> Duration {
    let mut wait_ms = RESULT_MS_DEFAULT;
    section.integer(RESULT_KEY, WAIT_MS_MIN..=RUN_MS_MAX, &mut wait_ms);
    Duration::from_millis(wait_ms)
}
