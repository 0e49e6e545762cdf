//! The topics of an action.

use crate::{
    error::Result,
    graph::{
        names::{TopicName, TypeName},
        qos::{Durability, Qos, Reliability},
    },
};

/// Depth of the topic of feedback.
const FEEDBACK_DEPTH: u32 = 10;

/// A topic of an action, with its type and its quality of service.
pub(super) struct ActionTopic {
    pub(super) topic: TopicName,
    pub(super) message: TypeName,
    pub(super) qos: Qos,
}

/// The topic of feedback.
///
/// # Errors
/// The name of the action is too long for it.
pub(super) fn feedback(action: &TopicName, of: &TypeName) -> Result<ActionTopic> {
    let qos = Qos::new(Reliability::Reliable, Durability::Volatile, FEEDBACK_DEPTH);
    Ok(ActionTopic { topic: action.below("/_action/feedback")?, message: of.part("_FeedbackMessage"), qos })
}

/// The topic of the states of goals.
///
/// # Errors
/// As [`feedback`].
pub(super) fn status(action: &TopicName) -> Result<ActionTopic> {
    let qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 1);
    let message = TypeName::parse("action_msgs/msg/GoalStatusArray")?;
    Ok(ActionTopic { topic: action.below("/_action/status")?, message, qos })
}
