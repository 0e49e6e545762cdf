//! The settings of a bridge: `bridge.toml`, or the table `[bridge]` of a node.
//!
//! ```toml
//! context = "Salma"            # who the bridge is towards the ledger; or context_dir = "/path/to/contexts/Salma"
//! domain_id = 1                # ROS 2 domain of the local graph; by default ROS_DOMAIN_ID, else 0
//! node_name = "ledgerd_bridge" # as `ros2 node list` shows it
//! shared_memory = true         # iceoryx2 for local processes, beside DDS
//! report_s = 60                # between two lines with counters, while something is refused
//!
//! [[route]]
//! service = "Turtlebot4/cmd_vel"
//! direction = "to_ledger"      # "from_ledger" on the robot's side
//! topic = "/cmd_vel"           # by default the service's topic
//! type = "geometry_msgs/msg/Twist"
//! qos = { reliability = "reliable", durability = "volatile", depth = 100 }
//! sample_bytes_max = 1048576
//! batch_max = 1                # to_ledger: samples that wait share a transaction, up to so many
//! max_age_ms = 1000            # from_ledger: may only shorten the service's own limit
//! stale_after_ms = 1000        # from_ledger: so long without a sign of life of the ledger, then the robot stops
//! stop_hex = "00010000…"       # from_ledger: the stop message, if the type has none or another is wanted
//! ```
//! A bridge that is a process of its own has a section `[log]` like a node's, which the program reads.
//! Everything has a default but `service`, `direction` and `type`. Every fault is reported, not only the first.

mod table;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use bytes::Bytes;
use ledger_rejection::{Code, Rejection};

pub(crate) use self::table::Table;
use crate::{
    dds::DOMAIN_MAX,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::Limits,
    route::kind::{KINDS, Kind, Plan},
    sample::{SAMPLE_BYTES_MAX, Sample},
};

/// Largest configuration file, in bytes.
const CONFIG_BYTES_MAX: u64 = 1024 * 1024;
/// Most routes of one bridge.
pub const ROUTES_MAX: usize = 64;
/// How often the ledger gives a sign of life.
pub(crate) const HEARTBEAT_MS: u32 = 250;
/// Longest `report_s`.
const REPORT_S_MAX: u64 = 86_400;
const REPORT_S_DEFAULT: u64 = 60;

/// The settings of a bridge.
#[derive(Debug, Clone)]
pub struct Config {
    /// The context that it uses towards the ledger.
    pub identity: IdentitySource,
    /// ROS 2 domain of the local graph; none = that of `ROS_DOMAIN_ID`, else 0.
    pub domain_id: Option<u16>,
    /// Name of the bridge in that graph.
    pub node_name: String,
    /// Whether local processes are served over iceoryx2 as well.
    pub shared_memory: bool,
    /// Time between two lines with counters, while something is refused.
    pub report_every: Duration,
    /// The routes.
    pub routes: Vec<RouteConfig>,
}

/// Where the identity of a bridge comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum IdentitySource {
    /// The context that `ledgerctl` has selected.
    Selected,
    /// A context of this user, by name.
    Context(String),
    /// The directory of a context, `<home>/contexts/<NAME>`.
    Directory(PathBuf),
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
    /// Largest sample, in bytes with its encapsulation header.
    pub sample_bytes_max: usize,
}

impl RouteConfig {
    /// The limits of the local readers of this route: they keep its depth of samples, the newest.
    pub(crate) fn limits(&self) -> Limits {
        Limits {
            sample_bytes_max: self.sample_bytes_max,
            queue_samples_max: usize::try_from(self.qos.depth).unwrap_or(1),
            ..Limits::default()
        }
    }
}

impl Config {
    /// Reads a file. Relative paths in it start at its directory.
    ///
    /// # Errors
    /// Every fault: [`Code::BadFile`], [`Code::BadConfiguration`], [`Code::BadName`].
    pub fn load(path: &Path) -> Result<Self, Vec<Rejection>> {
        let unreadable = |found: String| {
            let message = format!("cannot read the bridge configuration {}", path.display());
            vec![
                Rejection::new(Code::BadFile, message)
                    .found(found)
                    .wanted(format!("a TOML file of at most {CONFIG_BYTES_MAX} bytes")),
            ]
        };
        let length = std::fs::metadata(path).map_err(|error| unreadable(error.to_string()))?.len();
        if length > CONFIG_BYTES_MAX {
            return Err(unreadable(format!("{length} bytes")));
        }
        let text = std::fs::read_to_string(path).map_err(|error| unreadable(error.to_string()))?;
        Self::parse(&text, path.parent().unwrap_or(Path::new("")))
    }

    /// Reads the text of a file; `directory` is where relative paths in it start.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, directory: &Path) -> Result<Self, Vec<Rejection>> {
        let mut table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
            vec![
                Rejection::new(Code::BadConfiguration, "the bridge configuration is not TOML")
                    .found(error.to_string().trim_end().to_owned()),
            ]
        })?;
        // Of the program that runs the bridge. Inside a node the node has its own.
        table.remove("log");
        Self::from_table(table, directory)
    }

    /// Reads a table, such as `[bridge]` of a node.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn from_table(table: toml::Table, directory: &Path) -> Result<Self, Vec<Rejection>> {
        let mut faults = Vec::new();
        let mut root = Table::new("", table, &mut faults);
        let context: Option<String> = root.take("context", "the name of a context");
        let context_dir: Option<PathBuf> = root.take("context_dir", "the directory of a context");
        let identity = match (context, context_dir) {
            (None, None) => IdentitySource::Selected,
            (Some(name), None) => IdentitySource::Context(name),
            (None, Some(path)) => IdentitySource::Directory(directory.join(path)),
            (Some(_), Some(path)) => {
                root.fault("context and context_dir exclude each other", "both", "one of them", "remove one");
                IdentitySource::Directory(path)
            }
        };
        let domain_id = root.integer("domain_id", 0..=u64::from(DOMAIN_MAX));
        let node_name = root.take("node_name", "a ROS 2 node name").unwrap_or_else(|| "ledgerd_bridge".to_owned());
        let shared_memory = root.take("shared_memory", "true or false").unwrap_or(true);
        let report_s = root.integer("report_s", 1..=REPORT_S_MAX).unwrap_or(REPORT_S_DEFAULT);
        let routes: Vec<toml::Table> = root.take("route", "tables: [[route]]").unwrap_or_default();
        if routes.is_empty() || routes.len() > ROUTES_MAX {
            let wanted = format!("1 to {ROUTES_MAX}: [[route]]");
            root.fault("the bridge has no usable number of routes", &routes.len().to_string(), &wanted, "");
        }
        root.finish();
        let routes = (1..).zip(routes).take(ROUTES_MAX).filter_map(|(number, table)| route(number, table, &mut faults));
        let routes: Vec<RouteConfig> = routes.collect();
        let mut known = BTreeSet::new();
        for route in &routes {
            if !known.insert((&route.service, route.kind.name)) {
                let message = format!("two routes carry {} in the same direction", route.service);
                faults.push(Rejection::new(Code::BadConfiguration, message).wanted("each service once per direction"));
            }
        }
        faults.extend(circles(&routes));
        let domain_id = domain_id.and_then(|id| u16::try_from(id).ok());
        let report_every = Duration::from_secs(report_s);
        if faults.is_empty() {
            Ok(Self { identity, domain_id, node_name, shared_memory, report_every, routes })
        } else {
            Err(faults)
        }
    }
}

/// Pairs of routes that are a circle by what the configuration alone says.
fn circles(routes: &[RouteConfig]) -> Vec<Rejection> {
    let mut found = Vec::new();
    for (number, one) in (1..).zip(routes).filter(|(_, route)| route.kind.takes_in()) {
        for (other_number, other) in (1..).zip(routes).filter(|(_, route)| !route.kind.takes_in()) {
            if one.service == other.service && one.topic == other.topic {
                let topic = one.topic.as_ref().map_or("the service's topic", TopicName::as_str);
                found.push(circle(&one.service, topic, [(number, one.kind), (other_number, other.kind)]));
            }
        }
    }
    found
}

/// Two routes between which each message would go round.
pub(crate) fn circle(service: &str, topic: &str, routes: [(usize, &Kind); 2]) -> Rejection {
    let [(one, up), (two, down)] = routes;
    Rejection::new(Code::BadConfiguration, format!("routes {one} and {two} close a circle: {service} on {topic}"))
        .found(format!(
            "route {one}: {service} {} from {topic}; route {two}: {service} {} to {topic}",
            up.name, down.name
        ))
        .wanted("different topics for the two directions")
        .next(format!("give route {two} another topic, e.g. topic = \"/watched\", or remove one of both"))
}

fn route(number: usize, table: toml::Table, faults: &mut Vec<Rejection>) -> Option<RouteConfig> {
    let mut table = Table::new(&format!("route {number}: "), table, faults);
    let service: Option<String> = table.required("service", "ROBOT/TOPIC, e.g. \"Turtlebot4/cmd_vel\"");
    let service = service.filter(|service| {
        let usable = service.split_once('/').is_some_and(|(robot, topic)| !robot.is_empty() && !topic.is_empty());
        if !usable {
            table.fault(
                "service is not usable",
                &format!("{service:?}"),
                "ROBOT/TOPIC, in full",
                "ledgerctl robot list",
            );
        }
        usable
    });
    let kind: Option<&'static Kind> = table.required("direction", &Kind::names());
    let topic: Option<String> = table.take("topic", "a ROS 2 topic name");
    let topic = topic.and_then(|topic| table.checked(TopicName::parse(&topic)));
    let message: Option<String> = table.required("type", "a ROS 2 message type, e.g. \"geometry_msgs/msg/Twist\"");
    let message = message.and_then(|message| table.checked(TypeName::parse(&message)));
    let qos: Qos = table.take("qos", "{ reliability, durability, depth }").unwrap_or_default();
    table.checked(qos.validate());
    let bytes_max = table.integer("sample_bytes_max", 64..=SAMPLE_BYTES_MAX as u64);
    let sample_bytes_max = bytes_max.and_then(|bytes| usize::try_from(bytes).ok());
    let sample_bytes_max = sample_bytes_max.unwrap_or(Limits::default().sample_bytes_max);
    let plan = kind.map(|kind| (kind.read)(&mut table, sample_bytes_max));
    if kind.is_none() {
        KINDS.iter().for_each(|kind| table.ignore(kind.keys));
    }
    table.finish();
    Some(RouteConfig { service: service?, kind: kind?, plan: plan?, topic, message: message?, qos, sample_bytes_max })
}

/// The stop message that hexadecimal digits stand for.
///
/// # Errors
/// [`Code::BadArgument`] if they are none, or no CDR.
pub(crate) fn stop_sample(text: &str, bytes_max: usize) -> Result<Sample, Rejection> {
    let bytes = hex::decode(text.trim()).map_err(|error| {
        Rejection::new(Code::BadArgument, "stop_hex is not usable")
            .found(error.to_string())
            .wanted("hexadecimal digits: CDR with its 4-byte encapsulation header")
    })?;
    Ok(Sample::from_wire(Bytes::from(bytes), bytes_max)?)
}

/// One rejection for all faults, for those who can show only one.
pub(crate) fn all_faults(mut faults: Vec<Rejection>) -> Rejection {
    if faults.len() == 1
        && let Some(only) = faults.pop()
    {
        return only;
    }
    let lines: Vec<String> = faults.iter().map(|fault| fault.to_string().replace("\n  ", "; ")).collect();
    Rejection::new(Code::BadConfiguration, format!("the bridge configuration has {} faults", faults.len()))
        .found(lines.join("\n          "))
        .wanted("a configuration as the documentation of the bridge describes it")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    const ROUTE: &str = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\n";

    fn parse(text: &str) -> Result<Config, Vec<Rejection>> {
        Config::parse(text, Path::new("/etc/ledgerd"))
    }

    #[test]
    fn a_short_configuration_has_defaults() {
        let config = parse(&format!("{ROUTE}direction = 'from_ledger'")).unwrap();
        assert_eq!(config.identity, IdentitySource::Selected);
        assert_eq!((config.domain_id, config.shared_memory), (None, true));
        let route = &config.routes[0];
        assert_eq!(route.kind.name, "from_ledger");
        assert_eq!(format!("{:?}", route.plan), "Settings { max_age: None, stale_after: 1s, stop: None }");
        assert_eq!(route.limits().queue_samples_max, 100);
    }

    #[test]
    fn a_context_directory_is_relative_to_the_file() {
        let config = parse(&format!("context_dir = 'contexts/Salma'\n{ROUTE}direction = 'to_ledger'")).unwrap();
        assert_eq!(config.identity, IdentitySource::Directory("/etc/ledgerd/contexts/Salma".into()));
    }

    #[test]
    fn every_fault_is_named_at_once() {
        let text = "domain_id = 233\ncontexts = 'x'\n[[route]]\nservice = 'T'\ndirection = 'to_ledger'\ntopic = 'cmd'\n\
                    type = 'Twist'\nbatch_max = 0\nmax_age_ms = 5\n[[route]]\nservise = 'a/b'\nqos = { depth = 0 }";
        let faults = parse(text).unwrap_err();
        let all: Vec<String> = faults.iter().map(ToString::to_string).collect();
        for wanted in [
            "domain_id",
            "did you mean context?",
            "service is not usable",
            "\"/cmd\"",
            "geometry_msgs/msg/Twist",
            "batch_max",
            "max_age_ms",
            "did you mean service?",
            "qos depth",
        ] {
            assert!(all.iter().any(|fault| fault.contains(wanted)), "{wanted} is not in {all:#?}");
        }
        assert!(all_faults(faults).to_string().contains("max_age_ms"));
    }

    #[test]
    fn a_service_goes_one_way_once() {
        let twice = format!("{ROUTE}direction = 'to_ledger'\n{ROUTE}direction = 'to_ledger'");
        assert!(parse(&twice).unwrap_err()[0].message.contains("same direction"));
        let watched = format!("{ROUTE}direction = 'to_ledger'\n{ROUTE}direction = 'from_ledger'\ntopic = '/watched'");
        assert!(parse(&watched).is_ok());
    }

    #[test]
    fn two_routes_that_close_a_circle_are_refused_and_both_named() {
        for topic in ["", "topic = '/drive'\n"] {
            let text = format!("{ROUTE}{topic}direction = 'to_ledger'\n{ROUTE}{topic}direction = 'from_ledger'");
            let faults = parse(&text).unwrap_err();
            let [fault] = faults.as_slice() else { unreachable!("{faults:?}") };
            assert!(fault.message.contains("routes 1 and 2 close a circle"), "{fault}");
            assert!(
                fault.found.contains("T/cmd_vel to_ledger") && fault.found.contains("T/cmd_vel from_ledger"),
                "{fault}"
            );
        }
    }

    #[test]
    fn a_stop_message_is_cdr() {
        for (hex, good) in [("00010000ff", true), ("0001", false), ("ffff0000", false), ("zz", false)] {
            let text = format!("{ROUTE}direction = 'from_ledger'\nstop_hex = '{hex}'");
            assert_eq!(parse(&text).is_ok(), good, "{hex}");
        }
    }
}
