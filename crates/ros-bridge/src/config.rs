//! The settings of a bridge: `bridge.toml`, or the table `[bridge]` of a node.
//!
//! ```toml
//! context = "Salma"            # who the bridge is towards the ledger; or context_dir = "/path/to/contexts/Salma"
//! domain_id = 1                # ROS 2 domain of the local graph; by default ROS_DOMAIN_ID, else 0
//! discovery_range = "localhost" # "subnet": other hosts too; by default ROS_AUTOMATIC_DISCOVERY_RANGE, else "localhost"
//! static_peers = "10.0.0.5;nuc.local" # hosts beyond that range; by default ROS_STATIC_PEERS
//! interfaces = "10.0.0.4"      # addresses of the interfaces that are used; by default all
//! node_name = "ledgerd_bridge" # as `ros2 node list` shows it
//! shared_memory = true         # iceoryx2 for local processes, beside DDS
//! checkpoint = "fleet.checkpoint" # where to begin to follow who governs; by default at the genesis
//! grant_services = false       # /<robot>/acquire, release and stop as services of the local graph
//! diagnostics = true           # the state of every route on /diagnostics, once a second
//! report_s = 60                # between two lines with counters, while something is refused
//!
//! [[route]]
//! service = "Turtlebot4/cmd_vel"
//! direction = "to_ledger"      # "from_ledger" on the robot's side; services and actions have kinds of their own
//! topic = "/cmd_vel"           # by default the service's topic
//! type = "geometry_msgs/msg/Twist"
//! qos = { reliability = "reliable", durability = "volatile", depth = 100 }
//! sample_bytes_max = 4194304
//! batch_max = 1                # to_ledger: samples that wait share a transaction, up to so many
//! latched_depth = 1            # to_ledger: samples kept of each publisher of a latched topic
//! latched_again_s = 3600       # to_ledger: until they are said again
//! max_rate_hz = 20             # at most so many a second, the newest; alone, without batch_max; from_ledger: feeds only
//! reply_timeout_ms = 10000     # servers of calls and goals: one without a reply is forgotten after so long
//! server_timeout_ms = 10000    # clients of them: the robot's server is waited for so long
//! result_timeout_ms = 3600000  # actions: the result of a goal is waited for so long
//! goal_timeout_ms = 60000      # clients of actions: a goal that runs longer is cancelled
//! feedback_rate_hz = 10        # clients of actions: feedback goes to the ledger at most so often
//! max_age_ms = 1000            # from_ledger: may only shorten the service's own limit
//! stale_after_ms = 1000        # from_ledger: so long without a sign of life of the ledger, then the robot stops
//! stop = '{"axes": [0, 0]}'    # from_ledger: the stop message, if the type has none or another is wanted
//! stop_hex = "00010000…"       # from_ledger: the same as CDR, for a type whose definition the bridge does not know
//! goal_topic = "/goal_pose"    # from_ledger: the next point of the running task, as geometry_msgs/msg/PoseStamped
//! holder_topic = "/holder"     # messages: who holds the service, as JSON in a std_msgs/msg/String
//! path_topic = "/task/path"    # from_ledger: all points that are left of it, as nav_msgs/msg/Path
//! ```
//! With a section `[discover]` ([`crate::discover`]) there are routes for what is on the ledger, too, and none need be set.
//! A bridge that is a process of its own has the sections `[log]`, `[admin]` and `[traces]` like a node's, which the program reads.
//! Everything has a default but `service`, `direction` and `type`. Every fault is reported, not only the first.

#[cfg(test)]
mod tests;

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::{Fault, Reader, Section, Spot};
use ledger_gate::sample::{SAMPLE_BYTES_MAX, Sample};
use ledger_traces::Tracer;

use crate::{
    dds::DOMAIN_MAX,
    discover,
    names::{TopicName, TypeName},
    qos::{Copied, Qos},
    queue::Limits,
    reach,
    route::kind::{Given, KINDS, Kind, Plan},
};

/// The sections of the file of a bridge that the program which runs it reads.
pub const PROGRAM_SECTIONS: [&str; 3] = ["admin", "log", "traces"];
/// Most routes of one bridge.
pub const ROUTES_MAX: usize = 128;
/// How often the ledger gives a sign of life.
pub(crate) const HEARTBEAT_MS: u32 = 250;
/// The range of `sample_bytes_max`.
pub(crate) const SAMPLE_BYTES_RANGE: RangeInclusive<u64> = 64..=SAMPLE_BYTES_MAX as u64;
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
    /// With which hosts it shares that domain.
    pub reach: reach::Settings,
    /// Name of the bridge in that graph.
    pub node_name: String,
    /// Whether local processes are served over iceoryx2 as well.
    pub shared_memory: bool,
    /// The file of a checkpoint, from which it follows who governs the network; none = from the genesis.
    pub checkpoint: Option<PathBuf>,
    /// Whether a robot's grant can be had from the local graph.
    pub grant_services: bool,
    /// Whether `/diagnostics` shows the state of every route.
    pub diagnostics: bool,
    /// Time between two lines with counters, while something is refused.
    pub report_every: Duration,
    /// Which routes are discovered on the ledger; none = no route is.
    pub(crate) discover: Option<discover::Settings>,
    /// The routes that are set.
    pub routes: Vec<RouteConfig>,
    /// Where the steps of messages are told.
    pub(crate) tracer: Tracer,
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
    /// Which of it is only where the route begins, before it finds others on its topic.
    pub(crate) copied: Copied,
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

impl Config {
    /// Reads a file. Relative paths in it start at its directory. `program` reads the settings of the program that runs
    /// the bridge, such as `[log]`.
    ///
    /// # Errors
    /// Every fault: [`Code::BadFile`], [`Code::BadConfiguration`], [`Code::BadName`].
    pub fn load(path: &Path, program: impl FnOnce(&mut Section<'_, '_>)) -> Result<Self, Vec<Fault>> {
        Self::parse(&ledger_base::settings::load(path)?, path, program)
    }

    /// Reads the text of a file; the path is for messages, and relative paths in the text start at its directory.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, path: &Path, program: impl FnOnce(&mut Section<'_, '_>)) -> Result<Self, Vec<Fault>> {
        let mut reader = Reader::parse(text, path);
        let mut config = Self::default();
        reader.root(|root| {
            program(root);
            config.read(root, path.parent().unwrap_or(Path::new("")));
        });
        reader.finish().map(|()| config)
    }

    /// The same, with the steps of messages told there: whoever runs the bridge says it, not its file.
    #[must_use]
    pub fn traced(self, tracer: Tracer) -> Self {
        Self { tracer, ..self }
    }

    /// Are all settings the same, whatever the routes are?
    pub(crate) fn is_same_beside_routes(&self, other: &Self) -> bool {
        let text = |config: &Self| format!("{:?}", Self { discover: None, routes: Vec::new(), ..config.clone() });
        text(self) == text(other)
    }

    /// Is the same discovered?
    pub(crate) fn discovers_as(&self, other: &Self) -> bool {
        format!("{:?}", self.discover) == format!("{:?}", other.discover)
    }

    /// Reads a section, such as `[bridge]` of a node; `directory` is where relative paths in it start.
    pub fn read(&mut self, section: &mut Section<'_, '_>, directory: &Path) {
        let (mut context, mut context_dir, mut domain_id, mut report_s) = (None, None, None, REPORT_S_DEFAULT);
        section.text("context", "the name of a context", &mut context, |name| Some(Some(name.to_owned())));
        section.text("context_dir", "the directory of a context", &mut context_dir, |path| {
            Some(Some(directory.join(path)))
        });
        self.identity = match (context, context_dir) {
            (None, None) => IdentitySource::Selected,
            (Some(name), None) => IdentitySource::Context(name),
            (None, Some(path)) => IdentitySource::Directory(path),
            (Some(name), Some(path)) => {
                let found = format!("{name:?} and {:?}", path.display().to_string());
                section.conflict(["context", "context_dir"], found, "one of them".to_owned());
                IdentitySource::Directory(path)
            }
        };
        section.integer("domain_id", 0..=u64::from(DOMAIN_MAX), &mut domain_id);
        self.domain_id = domain_id.and_then(|id: u64| u16::try_from(id).ok());
        self.reach.read(section);
        section.text("node_name", "a ROS 2 node name", &mut self.node_name, |name| Some(name.to_owned()));
        section.boolean("shared_memory", &mut self.shared_memory);
        section.boolean("diagnostics", &mut self.diagnostics);
        section.boolean("grant_services", &mut self.grant_services);
        section.text("checkpoint", "the file of a checkpoint", &mut self.checkpoint, |path| {
            Some(Some(directory.join(path)))
        });
        section.integer("report_s", 1..=REPORT_S_MAX, &mut report_s);
        self.report_every = Duration::from_secs(report_s);
        section.section("discover", |section| self.discover = Some(discover::Settings::read(section)));
        let mut routes = Vec::new();
        let routes_min = usize::from(self.discover.is_none());
        section.sections("route", routes_min..=ROUTES_MAX, |number, section| {
            if let Some(route) = route(section) {
                routes.push(Numbered { number, spot: section.spot(), route });
            }
        });
        for (spot, fault) in twice(&routes).chain(circles(&routes)) {
            section.refuse(spot, fault);
        }
        self.routes = routes.into_iter().map(|numbered| numbered.route).collect();
    }
}

/// All defaults, and no route.
impl Default for Config {
    fn default() -> Self {
        Self {
            identity: IdentitySource::Selected,
            domain_id: None,
            reach: reach::Settings::default(),
            node_name: "ledgerd_bridge".to_owned(),
            shared_memory: true,
            grant_services: false,
            diagnostics: true,
            checkpoint: None,
            report_every: Duration::from_secs(REPORT_S_DEFAULT),
            discover: None,
            routes: Vec::new(),
            tracer: Tracer::default(),
        }
    }
}

/// A route, and where it stands.
struct Numbered {
    /// From 1.
    number: usize,
    spot: Spot,
    route: RouteConfig,
}

/// Pairs of routes, each once.
fn pairs(routes: &[Numbered]) -> impl Iterator<Item = (&Numbered, &Numbered)> {
    routes.iter().enumerate().flat_map(|(at, one)| routes.iter().skip(at + 1).map(move |other| (one, other)))
}

/// Routes that carry the same as one before them.
fn twice(routes: &[Numbered]) -> impl Iterator<Item = (&Spot, Rejection)> {
    let same =
        |one: &RouteConfig, other: &RouteConfig| (&one.service, one.kind.name) == (&other.service, other.kind.name);
    pairs(routes).filter(move |(one, other)| same(&one.route, &other.route)).map(|(one, other)| {
        let (service, numbers) = (&other.route.service, format!("routes {} and {}", one.number, other.number));
        let message = format!("two routes carry {service} in the same direction");
        let fault = Rejection::new(Code::BadConfiguration, message).found(numbers);
        (&other.spot, fault.wanted("each service once per direction").next("remove one of both"))
    })
}

/// Pairs of routes that are a circle by what the configuration alone says.
fn circles(routes: &[Numbered]) -> impl Iterator<Item = (&Spot, Rejection)> {
    let closed = |one: &RouteConfig, other: &RouteConfig| {
        one.service == other.service && one.topic == other.topic && one.kind.takes_in() != other.kind.takes_in()
    };
    pairs(routes).filter(move |(one, other)| closed(&one.route, &other.route)).map(|(one, other)| {
        let topic = one.route.topic.as_ref().map_or("the service's topic", TopicName::as_str);
        let both = [one, other].map(|numbered| (numbered.number, numbered.route.kind));
        (&other.spot, circle(&one.route.service, topic, both))
    })
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

fn route(section: &mut Section<'_, '_>) -> Option<RouteConfig> {
    const SERVICE: &str = "ROBOT/TOPIC in full, e.g. \"Turtlebot4/cmd_vel\"";
    const TYPE: &str = "a ROS 2 type, e.g. \"geometry_msgs/msg/Twist\"";
    let (mut service, mut kind, mut topic, mut message) = (None, None, None, None);
    section.required("service", SERVICE);
    section.text("service", SERVICE, &mut service, |text| {
        let usable = text.split_once('/').is_some_and(|(robot, topic)| !robot.is_empty() && !topic.is_empty());
        usable.then(|| Some(text.to_owned()))
    });
    section.required("direction", &Kind::names());
    section.text("direction", &Kind::names(), &mut kind, |name| Kind::named(name).map(Some));
    section.parsed("topic", "a ROS 2 topic name", &mut topic, |text| TopicName::parse(text).map(Some));
    section.required("type", TYPE);
    section.parsed("type", TYPE, &mut message, |text| TypeName::parse(text).map(Some));
    let (mut qos, mut copied) = (Qos::default(), Copied::default());
    section.section("qos", |section| copied = qos.read(section));
    let mut sample_bytes_max = Limits::default().sample_bytes_max as u64;
    section.integer("sample_bytes_max", SAMPLE_BYTES_RANGE, &mut sample_bytes_max);
    let sample_bytes_max = usize::try_from(sample_bytes_max).unwrap_or(SAMPLE_BYTES_MAX);
    if let (Some(kind), Some(message)) = (kind, &message)
        && let (Kind { name, carries, .. }, found) = (kind, TypeName::interface(message))
        && found != *carries
    {
        let wanted = format!("a type of the form PACKAGE/{}/NAME for {name:?}", carries.name());
        section.conflict(["direction", "type"], format!("{name:?} and {:?}", message.to_string()), wanted);
    }
    let given = Given { message: message.as_ref(), sample_bytes_max };
    let plan = kind.map(|kind: &Kind| (kind.read)(section, &given));
    if kind.is_none() {
        KINDS.iter().for_each(|kind| section.ignore(kind.keys));
    }
    let (service, kind, plan, message) = (service?, kind?, plan?, message?);
    Some(RouteConfig { service, kind, plan, topic, message, qos, copied, sample_bytes_max })
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
    Sample::from_wire(Bytes::from(bytes), bytes_max)
}
