//! A route and its kind: what each kind of route says of itself, and what a route of it is opened with.
//!
//! The rest of the bridge reads what a kind says of itself, never its name. A new kind is a new file and a new line in
//! [`super::kinds`].

use std::{fmt, ops::RangeInclusive, sync::Arc};

use futures::future::BoxFuture;
use ledger_api::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;
use ledger_gate::{sample::SAMPLE_BYTES_MAX, service::Service};
use tokio::sync::watch;

use super::{
    counters::Counters,
    silence::{Cause, Facts, Silence},
};
use crate::{
    graph::{
        endpoint::Role,
        local::LocalGraph,
        mark::Mark,
        names::{Interface, TopicName, TypeName},
        qos::{AdoptedQos, Qos},
        queue::Limits,
        shm::Peers,
    },
    ledger::{gateway::Gateway, robot_state::RobotStateQuery},
    shutdown::Shutdown,
};

/// The range of `sample_bytes_max`.
pub(crate) const SAMPLE_BYTES_RANGE: RangeInclusive<u64> = 64..=SAMPLE_BYTES_MAX as u64;

/// Makes the settings of a route that was discovered.
pub(crate) type Discovered = fn(&DiscoveryTerms) -> Arc<dyn Plan>;

/// A kind of route.
pub(crate) struct Kind {
    /// Its name in the configuration, in the log and in the summary.
    pub(crate) name: &'static str,
    /// The types that it carries.
    pub(crate) carries: Interface,
    /// The right on the service that the bridge's identity needs.
    pub(crate) right: &'static str,
    /// The endpoints of the local graph with which the route is connected.
    pub(crate) other_end: Role,
    /// The keys that only this kind has.
    pub(crate) keys: &'static [&'static str],
    /// Reads the settings under these keys.
    pub(crate) read: fn(&mut Section<'_, '_>, &CommonSettings<'_>) -> Arc<dyn Plan>,
    /// The settings of a route that was discovered; none if this kind cannot be.
    pub(crate) discovered: Option<Discovered>,
    /// The words for a cause of silence.
    pub(crate) silence: fn(&Facts<'_>, Cause<'_>) -> Silence,
    /// The warning about an endpoint that does beside this route what the route does.
    pub(crate) nearby: fn(&NearbyEndpoint<'_>) -> Option<String>,
}

/// The part of a route that is known when the settings of its kind are read.
pub(crate) struct CommonSettings<'a> {
    /// The type of its messages; none if that is a fault.
    pub(crate) message: Option<&'a TypeName>,
    /// Its largest sample, in bytes.
    pub(crate) sample_bytes_max: usize,
}

/// The own settings of a route, read and checked: it can be opened.
pub(crate) trait Plan: fmt::Debug + Send + Sync {
    /// Joins the topic, and learns from the ledger where the route stands.
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>>;
}

/// The settings that `[discover]` has for a route.
pub(crate) struct DiscoveryTerms {
    /// Most samples a second; none = any number.
    pub(crate) max_rate_hz: Option<u32>,
    /// Does publishing need a grant?
    pub(crate) needs_grant: bool,
    /// Do users publish and the robot listens?
    pub(crate) is_command: bool,
}

/// The surroundings of a route that is being opened.
pub(crate) struct Opening<'a> {
    pub(crate) route: &'a RouteConfig,
    pub(crate) gateway: Arc<dyn Gateway>,
    pub(crate) context: &'a Context,
    pub(crate) local: &'a LocalGraph,
    pub(crate) service: Service,
    /// The local topic.
    pub(crate) topic: &'a TopicName,
    pub(crate) mark: Mark,
    /// Asks how the robot stands.
    pub(crate) query: Arc<RobotStateQuery>,
    /// Those of the route, from its first opening on.
    pub(crate) counters: Counters,
    /// The quality of service that meets the others on the topic.
    pub(crate) qos: watch::Receiver<Qos>,
    /// Tells the route to end.
    pub(crate) shutdown: Shutdown,
}

/// An open route.
pub(crate) struct RouteTask {
    /// The other users of the topic in shared memory.
    pub(crate) in_memory: Option<Peers>,
    /// Runs until it is told to end, or the middleware ends.
    pub(crate) running: BoxFuture<'static, ()>,
}

/// An endpoint of another node on the same side of a route's topic.
pub(crate) struct NearbyEndpoint<'a> {
    pub(crate) service: &'a str,
    pub(crate) topic: &'a str,
    /// Is it a bridge of this network, with a route of the same service?
    pub(crate) is_same_service: bool,
    /// Do users publish and the robot listens?
    pub(crate) is_command: bool,
}

impl Kind {
    /// Does a route of this kind take samples in from the local graph, rather than deliver them there?
    pub(crate) fn takes_in(&self) -> bool {
        self.other_end == Role::Publisher
    }

    /// The way of the samples.
    pub(crate) fn arrow(&self, topic: &TopicName, service: &str) -> String {
        if self.takes_in() { format!("{topic} -> {service}") } else { format!("{service} -> {topic}") }
    }
}

impl fmt::Debug for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// One topic, one kind.
#[derive(Debug, Clone)]
pub struct RouteConfig {
    /// The service, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// Its kind.
    pub(crate) kind: &'static Kind,
    /// The settings that only its kind has.
    pub(crate) plan: Arc<dyn Plan>,
    /// The local topic; none = the service's.
    pub topic: Option<TopicName>,
    /// The type of its messages; must be the service's.
    pub message: TypeName,
    /// Quality of service of the local topic.
    pub qos: Qos,
    /// Which of it is only where the route begins, before it finds others on its topic.
    pub(crate) copied: AdoptedQos,
    /// Largest sample, in bytes with its encapsulation header.
    pub sample_bytes_max: usize,
}

impl RouteConfig {
    /// All settings, those of the kind too: routes with the same text are the same.
    pub(crate) fn text(&self) -> String {
        format!("{self:?}")
    }

    /// The limits of the local readers of this route: they keep its depth of samples, the newest.
    pub(crate) fn limits(&self) -> Limits {
        Limits {
            sample_bytes_max: self.sample_bytes_max,
            queue_samples_max: usize::try_from(self.qos.depth).unwrap_or(1),
            ..Limits::default()
        }
    }
}

/// Two routes between which each message would go round.
pub(crate) fn circle(service: &str, topic: &str, mut routes: [(usize, &Kind); 2]) -> Rejection {
    routes.sort_by_key(|(_, kind)| !kind.takes_in());
    let [(one, up), (two, down)] = routes;
    Rejection::new(Code::BadConfiguration, format!("routes {one} and {two} close a circle: {service} on {topic}"))
        .found(format!(
            "route {one}: {service} {} from {topic}; route {two}: {service} {} to {topic}",
            up.name, down.name
        ))
        .wanted("different topics for the two directions")
        .next(format!("give route {two} another topic, e.g. topic = \"/watched\", or remove one of both"))
}
