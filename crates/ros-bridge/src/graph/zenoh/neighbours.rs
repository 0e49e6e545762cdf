//! Neighbours in the domain, in the names of DDS: those of topics and services differ in each middleware, and routes know one.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use ros_zenoh::{graph::RemoteEndpoint, node::Node, token::Kind};
use tokio::{
    sync::watch,
    time::{sleep, timeout},
};

use super::session::{Session, hash_of, mark_of, participant};
use crate::graph::{
    dds::{Change, Neighbour},
    endpoint::Role,
    names::{TypeName, quoted},
    qos::{Durability, Qos, Reliability},
};

/// Between two looks, however much changes: a look costs as much as there are endpoints in the domain.
const LOOK_PAUSE: Duration = Duration::from_millis(100);
/// At least so often it looks whether the session has ended.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Most endpoints that are followed; more are not reported.
const NEIGHBOURS_MAX: usize = 4096;

impl Session {
    /// Reports, as long as it runs, publishers and subscribers that come and leave. Those that are there already come first: all that are
    /// marked, and those on the DDS topics of `topics`, which may change.
    pub(crate) fn follow(
        &self,
        topics: watch::Receiver<BTreeSet<String>>,
        report: Box<dyn FnMut(Change) + Send>,
    ) -> impl Future<Output = ()> + Send + use<> {
        follow(self.node.clone(), topics, report)
    }
}

async fn follow(node: Node, mut topics: watch::Receiver<BTreeSet<String>>, mut report: Box<dyn FnMut(Change) + Send>) {
    let mut changes = node.graph().changes();
    let mut known: BTreeMap<[u8; 16], Neighbour> = BTreeMap::new();
    let mut hashes = Hashes::default();
    while !node.is_ended() {
        changes.mark_unchanged();
        let meant = topics.borrow_and_update().clone();
        let endpoints = node.graph().endpoints();
        let all = endpoints.iter().map(|endpoint| neighbour(endpoint, &meant, &mut hashes));
        let all = all.filter(|neighbour| neighbour.mark.is_some() || meant.contains(&neighbour.topic));
        let now: BTreeMap<_, _> = all.take(NEIGHBOURS_MAX).map(|neighbour| (neighbour.guid, neighbour)).collect();
        let before = std::mem::replace(&mut known, now);
        before
            .iter()
            .filter(|(guid, _)| !known.contains_key(*guid))
            .for_each(|(_, left)| report(Change::Left(left.clone())));
        known
            .iter()
            .filter(|(guid, _)| !before.contains_key(*guid))
            .for_each(|(_, came)| report(Change::Came(came.clone())));
        sleep(LOOK_PAUSE).await;
        tokio::select! {
            _ = timeout(LOOK_EVERY, changes.changed()) => {}
            Ok(()) = topics.changed() => {}
        }
    }
    // Readers and writers say that it has ended.
    std::future::pending().await
}

/// The hashes of types that this bridge knows, by their names in DDS; none for a type that it does not know.
#[derive(Default)]
struct Hashes(BTreeMap<String, Option<String>>);

impl Hashes {
    /// Most types that are remembered; beyond it all are computed again.
    const TYPES_MAX: usize = 1024;

    fn of(&mut self, type_name: &str) -> Option<&str> {
        if self.0.len() >= Self::TYPES_MAX && !self.0.contains_key(type_name) {
            self.0.clear();
        }
        let compute = || hash_of(&TypeName::parse(&ros_name(type_name)?).ok()?);
        self.0.entry(type_name.to_owned()).or_insert_with(compute).as_deref()
    }
}

/// `geometry_msgs/msg/Twist` for `geometry_msgs::msg::dds_::Twist_`. The parts of services have other names, and none here.
fn ros_name(type_name: &str) -> Option<String> {
    let (package, rest) = type_name.split_once("::")?;
    let (middle, name) = rest.split_once("::dds_::")?;
    Some(format!("{package}/{middle}/{}", name.strip_suffix('_')?))
}

/// An endpoint in the names of DDS. A server receives requests, and a client sends them.
fn neighbour(endpoint: &RemoteEndpoint, meant: &BTreeSet<String>, hashes: &mut Hashes) -> Neighbour {
    let token = &endpoint.token;
    let (name, of) = (&token.subject.name, token.subject.type_name.as_str());
    let (role, topic, type_name) = match token.kind {
        Kind::Publisher => (Role::Publisher, format!("rt{name}"), of.to_owned()),
        Kind::Subscriber => (Role::Subscriber, format!("rt{name}"), of.to_owned()),
        Kind::Server => (Role::Subscriber, format!("rq{name}Request"), request_type(of)),
        Kind::Client => (Role::Publisher, format!("rq{name}Request"), request_type(of)),
    };
    // A type of the same name with another definition is another type.
    let mut differs = |hash: &String| hashes.of(of).is_some_and(|known| known != hash);
    let type_name = match &token.subject.hash {
        Some(hash) if meant.contains(&topic) && differs(hash) => {
            format!("{type_name} with another definition, {}", quoted(hash))
        }
        _ => type_name,
    };
    let qos = Qos {
        reliability: if token.qos.is_reliable { Reliability::Reliable } else { Reliability::BestEffort },
        durability: if token.qos.is_latched { Durability::TransientLocal } else { Durability::Volatile },
        ..Qos::default()
    };
    let participant = participant(&token.node.session);
    let (guid, mark) = (endpoint.gid, mark_of(endpoint));
    Neighbour {
        guid,
        role,
        topic,
        type_name,
        qos: qos.policies(),
        mark,
        participant,
        is_strict: false,
        is_reachable: true,
    }
}

/// The type of the requests of a service.
fn request_type(of: &str) -> String {
    format!("{}_Request_", of.strip_suffix('_').unwrap_or(of))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ros_zenoh::token::Token;

    fn endpoint(kind: &str, name: &str, of: &str, hash: &str) -> RemoteEndpoint {
        let key = format!("@ros2_lv/0/a1/0/3/{kind}/%/%/n/{name}/{of}/{hash}/2:1:,1:,:,:,,");
        RemoteEndpoint { gid: [7; 16], token: Token::parse(&key).unwrap() }
    }

    fn named(endpoint: &RemoteEndpoint) -> Neighbour {
        let meant = BTreeSet::from(["rt/cmd_vel".to_owned()]);
        neighbour(endpoint, &meant, &mut Hashes::default())
    }

    #[test]
    fn endpoints_have_the_names_of_dds() {
        let twist = "geometry_msgs::msg::dds_::Twist_";
        let hash = hash_of(&TypeName::parse("geometry_msgs/msg/Twist").unwrap()).unwrap();
        let publisher = named(&endpoint("MP", "%cmd_vel", twist, &hash));
        assert_eq!(
            (publisher.role, publisher.topic.as_str(), publisher.type_name.as_str()),
            (Role::Publisher, "rt/cmd_vel", twist)
        );
        assert!(!publisher.qos.is_reliable() && !publisher.is_keyed() && publisher.mark.is_none());
        let trigger = "std_srvs::srv::dds_::Trigger_";
        for (kind, role) in [("SS", Role::Subscriber), ("SC", Role::Publisher)] {
            let service = named(&endpoint(kind, "%arm%reset", trigger, "TypeHashNotSupported"));
            let names = (service.role, service.topic.as_str(), service.type_name.as_str());
            assert_eq!(names, (role, "rq/arm/resetRequest", "std_srvs::srv::dds_::Trigger_Request_"));
        }
    }

    #[test]
    fn a_type_with_another_definition_is_another_type_and_an_unknown_one_is_not() {
        let twist = "geometry_msgs::msg::dds_::Twist_";
        let other = named(&endpoint("MP", "%cmd_vel", twist, "RIHS01_00"));
        assert!(other.type_name.contains("another definition") && other.type_name.contains("RIHS01_00"));
        let unknown = named(&endpoint("MP", "%cmd_vel", "own_msgs::msg::dds_::Own_", "RIHS01_00"));
        assert_eq!(unknown.type_name, "own_msgs::msg::dds_::Own_");
    }
}
