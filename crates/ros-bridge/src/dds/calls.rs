//! Services of ROS 2, of which DDS knows nothing: requests go over one topic, replies over another one. A [`Server`] answers
//! on such a pair of topics, a [`Client`] calls there. Bytes go in and out as they are.
//!
//! The middlewares of ROS 2 tell in two ways to which request a reply belongs; see [`mapping`]. A server replies to each
//! client in the client's way, and a client calls in the way of the server that it finds.

mod client;
mod link;
mod mapping;
mod server;

pub use self::{
    client::{Client, Number, Reply},
    mapping::Caller,
    server::{Request, Server},
};
use crate::names::{TopicName, TypeName};

/// Most requests or replies that wait to be taken; more are dropped.
const WAITING_MAX: usize = 64;

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
}
