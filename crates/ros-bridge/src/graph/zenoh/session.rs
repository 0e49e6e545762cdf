//! The session of a bridge.

use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use ledger_gate::sample::{CDR_LE, HEADER_BYTES};
use ros_message::Library;
use ros_zenoh::{graph::RemoteEndpoint, key::Subject, node::Node, qos::TokenQos, settings::Settings};

use super::failure::zenoh_error;
use crate::{
    error::Result,
    graph::{
        dds::{Exchange, node_name},
        mark::Mark,
        names::{TopicName, TypeName},
        qos::{Durability, Qos, Reliability},
        reach::{Range, Reach},
    },
};

/// Our presence in one domain of a graph of `rmw_zenoh`. Cloning shares it; it leaves when the last clone and endpoint are gone.
#[derive(Clone)]
pub(crate) struct Session {
    pub(super) node: Node,
    /// Is every process of the graph on this host, with the same clock, as far as the settings say?
    pub(super) is_alone: bool,
}

impl Session {
    /// Joins a domain as the node `name`.
    ///
    /// # Errors
    /// [`crate::error::Error::Zenoh`] if the router does not answer, or refuses; [`crate::error::Error::Name`].
    pub(crate) async fn join(domain: u16, name: &str, settings: &Settings, reach: &Reach) -> Result<Self> {
        let name = node_name(name)?;
        let joined = Node::join(domain, name.base_name(), settings).await;
        let node =
            joined.map_err(|error| zenoh_error(&format!("cannot join ROS domain {domain} over zenoh"), &error))?;
        Ok(Self { node, is_alone: reach.range == Range::Localhost })
    }

    /// The identifier of the session: unique in the world, new with every start.
    pub(crate) fn identity(&self) -> [u8; 16] {
        participant(&self.node.identity().session)
    }

    /// Is this publisher of another still in the graph, according to its token?
    pub(crate) fn has_publisher(&self, gid: &[u8; 16]) -> bool {
        !self.node.graph().has_left(gid)
    }

    /// Ends as a fault would end it.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        self.node.end();
    }

    /// A topic with its type.
    pub(super) fn topic(&self, topic: &TopicName, message: &TypeName) -> Subject {
        self.subject(topic.as_str(), message)
    }

    /// A service with its type.
    pub(super) fn service(&self, exchange: &Exchange) -> Subject {
        self.subject(exchange.name().as_str(), exchange.service_type())
    }

    fn subject(&self, name: &str, of: &TypeName) -> Subject {
        let type_name = of.dds();
        let hash = hash_of(of).or_else(|| self.hash_in_graph(&type_name));
        Subject { name: name.to_owned(), type_name, hash }
    }

    /// The hash that an endpoint in the graph announces for a type that this bridge does not know.
    fn hash_in_graph(&self, type_name: &str) -> Option<String> {
        let endpoints = self.node.graph().endpoints();
        let mut subjects = endpoints.iter().map(|endpoint| &endpoint.token.subject);
        subjects.find(|subject| subject.type_name == type_name && subject.hash.is_some())?.hash.clone()
    }
}

/// The hash of a type that this bridge knows.
pub(super) fn hash_of(of: &TypeName) -> Option<String> {
    Library::builtin().message(&of.to_string()).ok().map(|message| message.type_hash())
}

/// The identifier of a session as 16 bytes: that of `rmw_zenoh` has up to 32 hexadecimal digits.
pub(super) fn participant(session: &str) -> [u8; 16] {
    u128::from_str_radix(session, 16).unwrap_or_default().to_le_bytes()
}

/// The quality of service of a token with a mark.
pub(super) fn token_qos(qos: &Qos, mark: Option<Mark>) -> TokenQos {
    TokenQos {
        is_reliable: qos.reliability == Reliability::Reliable,
        is_latched: qos.durability == Durability::TransientLocal,
        depth: usize::try_from(qos.depth).ok(),
        lifespan: mark.map(|mark| Duration::from_nanos(mark.nanos())),
    }
}

/// The mark of an endpoint.
pub(super) fn mark_of(endpoint: &RemoteEndpoint) -> Option<Mark> {
    Mark::from_nanos(u64::try_from(endpoint.token.qos.lifespan?.as_nanos()).ok()?)
}

/// A message of a service as it travels.
pub(super) fn wire_of(message: &[u8]) -> Bytes {
    let mut wire = BytesMut::with_capacity(HEADER_BYTES.saturating_add(message.len()));
    wire.put_slice(&CDR_LE);
    wire.put_slice(&[0, 0]);
    wire.put_slice(message);
    wire.freeze()
}

/// The message in such bytes; none if it is not little endian CDR.
pub(super) fn message_in(wire: &Bytes) -> Option<Bytes> {
    (wire.starts_with(&CDR_LE) && wire.len() >= HEADER_BYTES).then(|| wire.slice(HEADER_BYTES..))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ros_zenoh::{
        gid::gid_of,
        token::{Kind, NodeIdentity, Token},
    };

    #[test]
    fn a_mark_comes_back_from_a_token() {
        let mark = Mark::new(&Hash([3; 32]), "T/cmd_vel");
        let node = NodeIdentity {
            domain: 0,
            session: "a1".to_owned(),
            number: 0,
            namespace: "/".to_owned(),
            name: "bridge".to_owned(),
        };
        let subject = Subject { name: "/cmd_vel".to_owned(), type_name: "a::msg::dds_::T_".to_owned(), hash: None };
        let qos = token_qos(&Qos::default(), Some(mark));
        let key = Token { node, number: 1, kind: Kind::Publisher, subject, qos }.to_string();
        let endpoint = RemoteEndpoint { gid: gid_of(&key), token: Token::parse(&key).unwrap() };
        assert_eq!(mark_of(&endpoint), Some(mark));
        assert_eq!(token_qos(&Qos::default(), None).lifespan, None);
    }

    #[test]
    fn a_type_that_the_bridge_knows_has_the_hash_of_ros_jazzy_and_others_have_none() {
        let hash = |name: &str| hash_of(&TypeName::parse(name).unwrap());
        assert_eq!(
            hash("std_msgs/msg/String"),
            Some("RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18".to_owned())
        );
        assert_eq!(hash("own_msgs/msg/Own"), None);
    }

    #[test]
    fn messages_of_services_have_a_header_on_their_way() {
        assert_eq!(wire_of(b"abc")[..], [0, 1, 0, 0, b'a', b'b', b'c']);
        assert_eq!(message_in(&wire_of(b"abc")).unwrap(), Bytes::from_static(b"abc"));
        for bad in [&[0, 1, 0][..], &[0, 0, 0, 0, 1], b""] {
            assert_eq!(message_in(&Bytes::copy_from_slice(bad)), None);
        }
    }
}
