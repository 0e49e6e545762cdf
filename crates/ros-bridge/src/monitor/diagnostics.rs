//! The state of the bridge and of each route on `/diagnostics`, as `diagnostic_msgs/msg/DiagnosticArray` once a second:
//! where ROS 2's own tools look (REP 107).

use std::{net::Ipv4Addr, time::SystemTime};

use ledger_base::rejection::Rejection;
use ros_message::Message;
use serde_json::{Value, json};

use crate::{
    graph::{
        dds::UNREACHABLE,
        endpoint::Role,
        local::{Middleware, Output, OutputSettings},
        messages::builtin,
        names::{TopicName, TypeName},
        qos::Qos,
    },
    routes::{counters::RouteSummary, silence::Silence},
};

const TOPIC: &str = "/diagnostics";
const TYPE: &str = "diagnostic_msgs/msg/DiagnosticArray";
/// Messages that are kept for a slow reader.
const DEPTH: u32 = 10;

/// How a part of the bridge does, with the numbers of `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// It works, or has nothing to do.
    Ok = 0,
    /// It works not as it should.
    Warn = 1,
    /// It does not work.
    Error = 2,
    /// Nobody knows: the ledger is silent.
    Stale = 3,
}

/// A part of the bridge: `ledger`, or a route.
#[derive(Debug, Clone)]
pub struct Status {
    /// How it does.
    pub level: Level,
    /// Its name; on `/diagnostics` after that of the bridge.
    pub name: String,
    /// The reason of the level, for people.
    pub message: String,
    /// Its counters, by name; of a route also `holder`, who holds its service.
    pub values: Vec<(String, String)>,
}

impl Status {
    /// That of the local graph. `hosts` are those of participants that exchange no message with this bridge, one for each.
    pub(crate) fn of_graph(hosts: &[Ipv4Addr]) -> Self {
        let (level, message) = match hosts {
            [] => (Level::Ok, "every participant can be reached".to_owned()),
            [host, ..] => {
                let count = hosts.len();
                (Level::Error, format!("{count} participant(s), the first on {host}: each {UNREACHABLE}"))
            }
        };
        Self { level, name: "graph".to_owned(), message, values: Vec::new() }
    }

    /// That of a route, with its counters and the holders of its service.
    pub(crate) fn of_route(summary: &RouteSummary, holder: String, state: State<'_>) -> Self {
        let (level, message) = match state {
            State::Waits(reason) => (Level::Error, format!("waits: {reason}")),
            State::Unknown => (Level::Stale, "the ledger gives no sign of life".to_owned()),
            State::NearbyEndpoint { others, topic } => {
                let message =
                    format!("{others} publish on {topic} beside this bridge: their messages go around the ledger");
                (Level::Warn, message)
            }
            State::Unreachable { others, role, topic } => {
                let role = role.name();
                (Level::Error, format!("{others} {role}(s) on {topic}: each {UNREACHABLE}"))
            }
            State::Silent(Silence { reason, is_fault: true, .. }) => (Level::Warn, format!("silent: {reason}")),
            State::Silent(Silence { reason, .. }) => (Level::Ok, format!("silent: {reason}")),
            State::Works => (Level::Ok, "carries what comes".to_owned()),
        };
        let name = format!("{} {}", summary.service, summary.direction);
        let mut values = values(summary);
        values.push(("holder".to_owned(), holder));
        Self { level, name, message, values }
    }
}

/// How a route does.
pub(crate) enum State<'a> {
    /// It cannot be opened.
    Waits(&'a str),
    /// The ledger is silent.
    Unknown,
    /// So many others publish on the topic to which it delivers commands.
    NearbyEndpoint {
        others: usize,
        topic: &'a str,
    },
    /// Endpoints at its other end exchange no messages by UDP over IPv4.
    Unreachable {
        others: usize,
        role: Role,
        topic: &'a str,
    },
    Silent(&'a Silence),
    Works,
}

/// The counters as text, by their names in the summary.
fn values(summary: &RouteSummary) -> Vec<(String, String)> {
    let Ok(Value::Object(fields)) = serde_json::to_value(summary) else { return Vec::new() };
    let text = |value: Value| match value {
        Value::Object(tally) => {
            let parts: Vec<String> = tally.into_iter().map(|(name, count)| format!("{name} {count}")).collect();
            parts.join(", ")
        }
        Value::String(text) => text,
        other => other.to_string(),
    };
    fields.into_iter().map(|(name, value)| (name, text(value))).collect()
}

/// Publishes them.
pub(crate) struct Diagnostics {
    output: Box<dyn Output>,
    message: Message,
    node_name: String,
    /// The identity of the bridge, `Org2/Rover`.
    identity: String,
}

impl Diagnostics {
    pub(crate) async fn open(middleware: &dyn Middleware, node_name: &str, identity: &str) -> Result<Self, Rejection> {
        let qos = Qos { depth: DEPTH, ..Qos::default() };
        let settings = OutputSettings { topic: TopicName::parse(TOPIC)?, message: TypeName::parse(TYPE)?, mark: None };
        let output = middleware.output(&settings, &qos).await?;
        let (node_name, identity) = (node_name.to_owned(), identity.to_owned());
        Ok(Self { output, message: builtin::of(TYPE)?, node_name, identity })
    }

    pub(crate) fn publish(&self, statuses: &[Status], now: SystemTime) {
        let array = array(&self.node_name, &self.identity, statuses, now);
        let sample = builtin::sample(&self.message, &array).map_err(|refused| refused.to_string());
        if let Err(error) = sample.and_then(|sample| self.output.write(&sample).map_err(|error| error.to_string())) {
            tracing::debug!(error, "nothing was published on {TOPIC}");
        }
    }
}

fn array(node_name: &str, identity: &str, statuses: &[Status], now: SystemTime) -> Value {
    let status = |Status { level, name, message, values }: &Status| {
        let values: Vec<Value> = values.iter().map(|(key, value)| json!({ "key": key, "value": value })).collect();
        let name = format!("{node_name}: {name}");
        json!({ "level": *level as u8, "name": name, "message": message, "hardware_id": identity, "values": values })
    };
    json!({ "header": builtin::stamped(now), "status": statuses.iter().map(status).collect::<Vec<_>>() })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::routes::counters::Counters;
    use std::time::{Duration, UNIX_EPOCH};

    fn summary() -> RouteSummary {
        let counters = Counters::new("T/cmd_vel", "to_ledger");
        crate::routes::counters::count(&mut counters.lock().summary.refused, "NOT_HOLDER", 3);
        counters.summary()
    }

    #[test]
    fn each_state_of_a_route_has_its_level_and_says_why() {
        let summary = summary();
        let silence = |is_fault| Silence { name: "x", reason: "why".to_owned(), is_fault };
        let (fault, pause) = (silence(true), silence(false));
        let level = |state| Status::of_route(&summary, String::new(), state).level;
        assert_eq!(level(State::Works), Level::Ok);
        assert_eq!(level(State::Silent(&pause)), Level::Ok);
        assert_eq!(level(State::Silent(&fault)), Level::Warn);
        assert_eq!(level(State::Waits("LGR-3012")), Level::Error);
        assert_eq!(level(State::Unknown), Level::Stale);
        assert_eq!(level(State::NearbyEndpoint { others: 1, topic: "/cmd_vel" }), Level::Warn);
        assert_eq!(level(State::Unreachable { others: 1, role: Role::Subscriber, topic: "/cmd_vel" }), Level::Error);
        assert_eq!(Status::of_route(&summary, String::new(), State::Silent(&fault)).message, "silent: why");
        let graph = Status::of_graph(&[Ipv4Addr::LOCALHOST; 2]);
        assert_eq!((graph.level, Status::of_graph(&[]).level), (Level::Error, Level::Ok));
        assert!(
            graph.message.starts_with("2 participant(s), the first on 127.0.0.1: each has no address"),
            "{graph:?}"
        );
    }

    #[test]
    fn the_message_has_the_counters_under_the_names_of_the_summary_and_the_holders() {
        let status = Status::of_route(&summary(), "Org1/Farhad, Org1/Salma".to_owned(), State::Works);
        let now = UNIX_EPOCH + Duration::new(1_700_000_000, 5);
        let message = builtin::of(TYPE).unwrap();
        let sample = builtin::sample(&message, &array("bridge", "Org1/Salma", &[status], now)).unwrap();
        let yaml = message.decode(sample.wire()).unwrap().to_yaml(None);
        for wanted in [
            "sec: 1700000000",
            "nanosec: 5",
            "name: 'bridge: T/cmd_vel to_ledger'",
            "hardware_id: Org1/Salma",
            "value: NOT_HOLDER 3",
            "key: holder",
            "Org1/Farhad, Org1/Salma",
        ] {
            assert!(yaml.contains(wanted), "{wanted}: {yaml}");
        }
    }
}
