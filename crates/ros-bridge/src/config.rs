//! The settings of a bridge: `bridge.toml`, or the table `[bridge]` of a node.
//!
//! ```toml
//! context = "Salma"            # who the bridge is towards the ledger; or context_dir = "/path/to/contexts/Salma"
//! domain_id = 1                # ROS 2 domain of the local graph; by default ROS_DOMAIN_ID, else 0
//! discovery_range = "localhost" # "subnet": other hosts too; by default ROS_AUTOMATIC_DISCOVERY_RANGE, else "localhost"
//! static_peers = "10.0.0.5;nuc.local" # hosts beyond that range; by default ROS_STATIC_PEERS
//! interfaces = "10.0.0.4"      # addresses of the interfaces that are used; by default all
//! transport = "dds"            # "zenoh": a graph of rmw_zenoh, in ledgerd-bridge-zenoh
//! node_name = "ledgerd_bridge" # as `ros2 node list` shows it
//! shared_memory = true         # iceoryx2 for local processes, beside DDS
//! checkpoint = "fleet.checkpoint" # where to begin to follow who governs; by default at the genesis
//! grant_services = false       # /<robot>/acquire, release and stop as services of the local graph
//! diagnostics = true           # the state of every route on /diagnostics, once a second
//! report_s = 60                # between two lines with counters, while something is refused
//!
//! [zenoh]                      # with transport = "zenoh"
//! mode = "client"              # "peer": with links to other peers
//! endpoint = "tcp/127.0.0.1:7447" # the router; off this host only with discovery_range = "subnet"
//! listen = "tcp/127.0.0.1:0"   # peers only
//! ca = "ca.pem"                # with an endpoint tls/HOST:PORT: who certifies routers
//! certificate = "bridge.pem"   # the bridge's own, for mutual TLS
//! key = "bridge.key"           # its key
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
//! With a section `[discover]` ([`crate::routes::discovery`]) there are routes for what is on the ledger, too, and none need be set.
//! A bridge that is a process of its own has the sections `[log]`, `[admin]` and `[traces]` like a node's, which the program reads.
//! Everything has a default but `service`, `direction` and `type`. Every fault is reported, not only the first.

#[cfg(test)]
mod tests;

mod guarded;
mod identity;
mod route;

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use ledger_api::Context;
use ledger_base::rejection::Rejection;
use ledger_base::settings::{Fault, Reader, Section};
use ledger_contract::RobotAsset;
use ledger_traces::Tracer;

pub use self::{guarded::Guarded, identity::IdentitySource};

use crate::{
    graph::{choice::MiddlewareChoice, domain::DOMAIN_MAX, reach},
    routes::{discovery, kind::RouteConfig},
};

/// The sections of the file of a bridge that the program which runs it reads.
pub const PROGRAM_SECTIONS: [&str; 3] = ["admin", "log", "traces"];
/// Most routes of one bridge.
pub const ROUTES_MAX: usize = 128;
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
    /// The middleware of that graph.
    pub middleware: MiddlewareChoice,
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
    pub(crate) discover: Option<discovery::Settings>,
    /// The routes that are set.
    pub routes: Vec<RouteConfig>,
    /// Where the steps of messages are told.
    pub(crate) tracer: Tracer,
}

impl Config {
    /// Reads a file. Relative paths in it start at its directory. `program` reads the settings of the program that runs
    /// the bridge, such as `[log]`.
    ///
    /// # Errors
    /// Every fault: [`Code::BadFile`], [`Code::BadConfiguration`], [`Code::BadName`].
    ///
    /// [`Code::BadFile`]: ledger_base::rejection::Code::BadFile
    /// [`Code::BadConfiguration`]: ledger_base::rejection::Code::BadConfiguration
    /// [`Code::BadName`]: ledger_base::rejection::Code::BadName
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

    /// All that a bridge with these settings guards, given the robots on the ledger; each once.
    ///
    /// # Errors
    /// [`Code::UnknownService`] if a route is set for a service that no robot offers; [`Code::BadName`] if the topic of one
    /// is no name of ROS 2.
    ///
    /// [`Code::UnknownService`]: ledger_base::rejection::Code::UnknownService
    /// [`Code::BadName`]: ledger_base::rejection::Code::BadName
    pub fn guarded(&self, robots: &[RobotAsset]) -> Result<Vec<Guarded>, Rejection> {
        guarded::all(&self.routes, self.discover.as_ref(), robots)
    }

    /// Reads a section, such as `[bridge]` of a node; `directory` is where relative paths in it start.
    pub fn read(&mut self, section: &mut Section<'_, '_>, directory: &Path) {
        let (mut domain_id, mut report_s) = (None, REPORT_S_DEFAULT);
        self.identity = IdentitySource::read(section, directory);
        section.integer("domain_id", 0..=u64::from(DOMAIN_MAX), &mut domain_id);
        self.domain_id = domain_id.and_then(|id: u64| u16::try_from(id).ok());
        self.reach.read(section);
        self.middleware.read(section, directory);
        section.text("node_name", "a ROS 2 node name", &mut self.node_name, |name| Some(name.to_owned()));
        section.boolean("shared_memory", &mut self.shared_memory);
        section.boolean("diagnostics", &mut self.diagnostics);
        section.boolean("grant_services", &mut self.grant_services);
        section.text("checkpoint", "the file of a checkpoint", &mut self.checkpoint, |path| {
            Some(Some(directory.join(path)))
        });
        section.integer("report_s", 1..=REPORT_S_MAX, &mut report_s);
        self.report_every = Duration::from_secs(report_s);
        section.section("discover", |section| self.discover = Some(discovery::Settings::read(section)));
        let routes_min = usize::from(self.discover.is_none());
        self.routes = route::read_all(section, routes_min..=ROUTES_MAX);
    }
}

/// The identity of a bridge towards the ledger, as its configuration names it.
///
/// # Errors
/// As [`Context::load`].
pub fn context_of(config: &Config) -> Result<Context, Rejection> {
    config.identity.context()
}

/// All defaults, and no route.
impl Default for Config {
    fn default() -> Self {
        Self {
            identity: IdentitySource::Selected,
            domain_id: None,
            reach: reach::Settings::default(),
            middleware: MiddlewareChoice::default(),
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
