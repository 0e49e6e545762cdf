//! The topics of a service, and of the services of an action.

use crate::{
    error::Result,
    graph::names::{TopicName, TypeName},
};

/// A ROS 2 service by its name and type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exchange {
    name: TopicName,
    of: TypeName,
}

impl Exchange {
    /// The service of that name, such as `/reset`, and type, such as `std_srvs/srv/Trigger`.
    pub fn new(name: &TopicName, of: &TypeName) -> Self {
        Self { name: name.clone(), of: of.clone() }
    }

    /// The service on which an action of that name, such as `/navigate_to_pose`, takes goals.
    ///
    /// # Errors
    /// [`crate::error::Error::Name`] if the name is too long with what ROS 2 puts behind it.
    pub fn of_goals(action: &TopicName, of: &TypeName) -> Result<Self> {
        Ok(Self { name: action.below("/_action/send_goal")?, of: of.part("_SendGoal") })
    }

    /// The service on which it is asked for results.
    ///
    /// # Errors
    /// As [`Exchange::of_goals`].
    pub fn of_results(action: &TopicName, of: &TypeName) -> Result<Self> {
        Ok(Self { name: action.below("/_action/get_result")?, of: of.part("_GetResult") })
    }

    /// The service on which goals are cancelled.
    ///
    /// # Errors
    /// As [`Exchange::of_goals`].
    pub fn of_cancels(action: &TopicName) -> Result<Self> {
        Ok(Self { name: action.below("/_action/cancel_goal")?, of: TypeName::parse("action_msgs/srv/CancelGoal")? })
    }

    /// The name of the service, `/reset`.
    #[cfg(feature = "zenoh")]
    pub(crate) fn name(&self) -> &TopicName {
        &self.name
    }

    /// Its type, `std_srvs/srv/Trigger`.
    #[cfg(feature = "zenoh")]
    pub(crate) fn service_type(&self) -> &TypeName {
        &self.of
    }

    /// The name of the DDS topic of the requests, `rq/resetRequest`.
    pub fn requests(&self) -> String {
        format!("rq{}Request", self.name)
    }

    /// The name of the DDS type of the requests, `std_srvs::srv::dds_::Trigger_Request_`.
    pub fn request_type(&self) -> TypeName {
        self.of.part("_Request")
    }

    /// The name of the DDS topic of the replies, `rr/resetReply`.
    pub fn replies(&self) -> String {
        format!("rr{}Reply", self.name)
    }

    /// The name of the DDS type of the replies, `std_srvs::srv::dds_::Trigger_Response_`.
    pub fn reply_type(&self) -> TypeName {
        self.of.part("_Response")
    }
}

impl std::fmt::Display for Exchange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} [{}]", self.name, self.of)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_service_has_two_topics_and_types() {
        let of = TypeName::parse("std_srvs/srv/Trigger").unwrap();
        let service = Exchange::new(&TopicName::parse("/arm/reset").unwrap(), &of);
        assert_eq!((service.requests(), service.replies()), ("rq/arm/resetRequest".into(), "rr/arm/resetReply".into()));
        assert_eq!(service.request_type().dds(), "std_srvs::srv::dds_::Trigger_Request_");
        assert_eq!(service.reply_type().dds(), "std_srvs::srv::dds_::Trigger_Response_");
    }
    #[test]
    fn an_action_has_three_services() {
        let of = TypeName::parse("nav2_msgs/action/NavigateToPose").unwrap();
        let action = TopicName::parse("/navigate_to_pose").unwrap();
        let [goals, results, cancels] =
            [Exchange::of_goals(&action, &of), Exchange::of_results(&action, &of), Exchange::of_cancels(&action)]
                .map(|exchange| exchange.unwrap());
        assert_eq!(goals.requests(), "rq/navigate_to_pose/_action/send_goalRequest");
        assert_eq!(goals.request_type().dds(), "nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_");
        assert_eq!(results.replies(), "rr/navigate_to_pose/_action/get_resultReply");
        assert_eq!(results.reply_type().dds(), "nav2_msgs::action::dds_::NavigateToPose_GetResult_Response_");
        assert_eq!(cancels.requests(), "rq/navigate_to_pose/_action/cancel_goalRequest");
        assert_eq!(cancels.request_type().dds(), "action_msgs::srv::dds_::CancelGoal_Request_");
        let long = TopicName::parse(&format!("/{}", "a".repeat(240))).unwrap();
        assert!(Exchange::of_goals(&long, &of).is_err(), "no name for its goals fits into DDS");
    }
}
