//! The configuration of a node: `ledgerd.toml`. Every setting has a default; `ledgerd.toml` in the repository lists
//! them all.
//!
//! All faults of a file are found at once, each with its line. Settings are read one by one from the parsed text, which
//! keeps the place of each value, because serde would stop at the first fault.

/// A number of the configuration as a count of things in memory.
pub(crate) fn count(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
}

mod dialling;
#[cfg(test)]
mod tests;

use ledger::block::PAYLOAD_BYTES_MAX;
use ledger::transaction::TRANSACTION_BYTES_MAX;
use ledger_base::hash::Hash;
use ledger_base::settings::{Reader, Section};
use ledger_replica::{ELECTION_TIME_MAX, ELECTION_TIME_MIN, Timing};
use ledger_storage::retention::Retention;
use ledger_traces::Settings as Traces;
use std::path::{Path, PathBuf};
use tracing_subscriber::filter::LevelFilter;

pub use dialling::AllowedAddress;
pub(crate) use dialling::DialRules;
pub use ledger_base::settings::Fault;

/// Bytes of the unit of `storage.segment_mib`.
const SEGMENT_UNIT: u64 = 1024 * 1024;
/// How `storage.retention` is written.
const RETENTION: &str =
    "forever, an age of at least 10min such as 30d or 12h, or a size of at least 64MiB such as 20GiB";

/// Most addresses of `peers.allow`.
const ALLOWED_MAX: usize = 64;

/// Days for which certificates are valid, unless `[ca]` says otherwise.
pub const CERTIFICATE_DAYS: u32 = 365;
/// Days for which secrets can be used, unless `[ca]` says otherwise.
pub const SECRET_DAYS: u32 = 7;

/// The configuration of a node.
#[derive(Clone, Debug)]
pub struct Config {
    /// The file, for commands that are told.
    pub file: PathBuf,
    /// `data`: the directory with everything that the node keeps.
    pub data: PathBuf,
    /// `listen`: `HOST:PORT` at which it accepts connections.
    pub listen: String,
    /// `profile`: what counts more, power or the time that a command takes.
    pub profile: Profile,
    /// `[member]`
    pub member: MemberOf,
    /// `[limits]`
    pub limits: Limits,
    /// `[storage]`
    pub storage: Storage,
    /// `[order]`
    pub order: Order,
    /// `[peers] allow`: addresses of other organisations' nodes that this node dials although they are of its own machine, or have a
    /// privileged port.
    pub allow: Vec<AllowedAddress>,
    /// `[ca]`
    pub ca: Ca,
    /// `[log]`
    pub log: Log,
    /// `[bridge]`; none if the node runs no bridge.
    pub bridge: Option<ros_bridge::Config>,
    /// `[admin] listen`: `HOST:PORT` of the page for whoever watches the node; empty = none.
    pub admin: String,
    /// `[console]`
    pub console: Console,
    /// `[traces]`
    pub traces: Traces,
    /// Not in the file: the node is the only one of a network for trials, which ends with it.
    pub is_trial: bool,
}

/// The console for browsers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Console {
    /// `HOST:PORT` where it listens; empty = there is none.
    pub listen: String,
    /// The host name by which browsers reach it; empty = an address, or the name in `listen`.
    pub name: String,
    /// Its certificate for TLS, with those of its issuers; empty = one that it makes at each start.
    pub certificate: PathBuf,
    /// The key of that certificate.
    pub key: PathBuf,
}

/// The preference of this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// `balanced`: power. The processors sleep whenever nothing is to be done.
    Balanced,
    /// `low-latency`: the time that a command takes. The processors do not sleep while transactions come, and threads
    /// take short turns while many wait for them.
    LowLatency,
}

/// Which node of which network this configuration is for, as `ledgerd init` and `ledgerd join` write it; empty = not said.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MemberOf {
    /// Name of the network: 64 hexadecimal digits.
    pub network: String,
    /// The node, `ORGANISATION/NAME`.
    pub node: String,
    /// `HOST:PORT` at which the others reach it.
    pub address: String,
}

/// The limits of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one transaction.
    pub payload_bytes_max: u64,
    /// Transactions that have come and are not answered yet.
    pub in_flight_max: u64,
    /// Subscriptions that are open at a time.
    pub subscribers_max: u64,
}

/// How blocks are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Storage {
    /// Size of a segment file, in MiB.
    pub segment_mib: u64,
    /// How long blocks are kept.
    pub retention: Retention,
    /// Where blocks are copied to before they are dropped; empty = nowhere.
    pub archive: PathBuf,
}

/// Ordering.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Order {
    /// Length of a tick, in milliseconds; leaders are heard once in a tick.
    pub tick_ms: u64,
    /// Ticks without a leader after which a new one is elected.
    pub election_ticks: u64,
    /// How long data waits at most to be looked at, and again for its block, in milliseconds; then it is refused.
    pub wait_ms: u64,
    /// Between two attestations, in milliseconds.
    pub attest_ms: u64,
}

/// The enrolment CA, if the node carries one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ca {
    /// Days for which certificates are valid.
    pub certificate_days: u32,
    /// Days for which one-time secrets can be used.
    pub secret_days: u32,
}

/// The level and the form of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Log {
    /// Lines that are less important than this are left out.
    pub level: LevelFilter,
    /// For people or for machines.
    pub format: LogFormat,
}

/// The form of log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// `auto`: text where somebody reads it on a terminal, JSON elsewhere.
    Auto,
    /// `text`: one line for people.
    Text,
    /// `json`: one object a line.
    Json,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            file: PathBuf::from("ledgerd.toml"),
            data: PathBuf::from("data"),
            listen: "127.0.0.1:7450".into(),
            profile: Profile::Balanced,
            member: MemberOf::default(),
            limits: Limits {
                payload_bytes_max: TRANSACTION_BYTES_MAX as u64,
                in_flight_max: 65_536,
                subscribers_max: 1024,
            },
            storage: Storage { segment_mib: 64, retention: Retention::FOREVER, archive: PathBuf::new() },
            order: Order::default(),
            allow: Vec::new(),
            ca: Ca { certificate_days: CERTIFICATE_DAYS, secret_days: SECRET_DAYS },
            log: Log::default(),
            bridge: None,
            admin: String::new(),
            console: Console::default(),
            traces: Traces::default(),
            is_trial: false,
        }
    }
}

impl Default for Order {
    fn default() -> Self {
        let Timing { tick, election_ticks, data_wait } = Timing::default();
        Self {
            tick_ms: tick / 1000,
            election_ticks: election_ticks as u64,
            wait_ms: data_wait / 1000,
            attest_ms: 10_000,
        }
    }
}

impl Order {
    /// The times of the replica.
    pub(crate) fn timing(&self) -> Timing {
        Timing {
            tick: self.tick_ms.saturating_mul(1000),
            election_ticks: count(self.election_ticks),
            data_wait: self.wait_ms.saturating_mul(1000),
        }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self { level: LevelFilter::INFO, format: LogFormat::Auto }
    }
}

impl Config {
    /// Reads a file. Relative paths in it are relative to it.
    ///
    /// # Errors
    /// Every fault of the file, in the order of its lines.
    pub fn load(path: &Path) -> Result<Self, Vec<Fault>> {
        Self::parse(&ledger_base::settings::load(path)?, path)
    }

    /// Reads the text of a file; the path is for messages, and what relative paths in it are relative to.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, Vec<Fault>> {
        let mut config = Self { file: path.to_owned(), ..Self::default() };
        let mut reader = Reader::parse(text, path);
        let directory = path.parent().unwrap_or(Path::new(""));
        reader.root(|root| config.read(root, directory));
        config.data = directory.join(&config.data);
        if !config.storage.archive.as_os_str().is_empty() {
            config.storage.archive = directory.join(&config.storage.archive);
        }
        reader.finish().map(|()| config)
    }

    /// The addresses that this node dials for other organisations.
    pub(crate) fn dial_rules(&self) -> DialRules {
        let own = if self.member.address.is_empty() { &self.listen } else { &self.member.address };
        DialRules::new(own, &self.allow)
    }

    /// Each setting in one line: its name, its range, where it goes.
    fn read(&mut self, root: &mut Section<'_, '_>, directory: &Path) {
        let Self { file: _, data, listen, profile, member, limits, storage, order, allow, ca, log, .. } = self;
        let Self { bridge, admin, console, traces, .. } = self;
        root.text("data", "a path", data, |text| (!text.is_empty()).then(|| text.into()));
        root.text("listen", "HOST:PORT, for example \"0.0.0.0:7450\"", listen, |text| {
            is_address(text).then(|| text.to_owned())
        });
        root.text("profile", "balanced or low-latency", profile, |text| match text {
            "balanced" => Some(Profile::Balanced),
            "low-latency" => Some(Profile::LowLatency),
            _ => None,
        });
        root.section("member", |s| {
            let network = |text: &str| (text.is_empty() || Hash::from_hex(text).is_some()).then(|| text.to_owned());
            s.text(
                "network",
                "64 hexadecimal digits, as ledgerd init or join wrote them",
                &mut member.network,
                network,
            );
            let node = |text: &str| (text.is_empty() || text.split('/').count() == 2).then(|| text.to_owned());
            s.text("node", "ORGANISATION/NAME", &mut member.node, node);
            let address = |text: &str| (text.is_empty() || is_address(text)).then(|| text.to_owned());
            s.text("address", "HOST:PORT as the others use it", &mut member.address, address);
        });
        root.section("storage", |s| {
            s.integer("segment_mib", 1..=1024, &mut storage.segment_mib);
            s.text("retention", RETENTION, &mut storage.retention, |text| text.parse().ok());
            s.text("archive", "a path", &mut storage.archive, |text| Some(text.into()));
        });
        // Where nobody sets it, the largest transaction is one of which a segment holds two.
        limits.payload_bytes_max = limits.payload_bytes_max.min(storage.segment_mib.saturating_mul(SEGMENT_UNIT / 2));
        root.section("limits", |s| {
            s.integer("payload_bytes_max", 1024..=TRANSACTION_BYTES_MAX as u64, &mut limits.payload_bytes_max);
            s.integer("in_flight_max", 1..=1_000_000, &mut limits.in_flight_max);
            s.integer("subscribers_max", 1..=100_000, &mut limits.subscribers_max);
        });
        root.section("order", |s| {
            s.integer("tick_ms", 1..=10_000, &mut order.tick_ms);
            s.integer("election_ticks", 2..=1000, &mut order.election_ticks);
            s.integer("wait_ms", 10..=60_000, &mut order.wait_ms);
            s.integer("attest_ms", 100..=3_600_000, &mut order.attest_ms);
            s.replaced("awake_us", "profile = \"low-latency\" instead of a time, profile = \"balanced\" instead of 0");
        });
        root.section("peers", |s| {
            let given = s.texts("allow", ALLOWED_MAX, str::parse::<AllowedAddress>);
            allow.extend(given.into_iter().flatten());
        });
        root.section("ca", |s| {
            s.integer("certificate_days", 1..=3650, &mut ca.certificate_days);
            s.integer("secret_days", 1..=365, &mut ca.secret_days);
        });
        log.read(root);
        root.section("admin", |s| s.text("listen", ADMIN_LISTEN, admin, address));
        console.read(root, directory);
        traces.read(root);
        root.section("bridge", |s| bridge.get_or_insert_default().read(s, directory));

        let timing = order.timing();
        if !timing.can_elect() {
            let [found, least, most] =
                [timing.election_time(), ELECTION_TIME_MIN, ELECTION_TIME_MAX].map(|us| us / 1000);
            root.conflict(
                ["order.tick_ms", "order.election_ticks"],
                format!("{} ms x {} ticks = {found} ms", order.tick_ms, order.election_ticks),
                format!("{least} to {most} ms until a new leader is elected"),
            );
        }
        let (payload, segment_mib) = (limits.payload_bytes_max, storage.segment_mib);
        if payload > segment_mib.saturating_mul(SEGMENT_UNIT / 2) {
            root.conflict(
                ["limits.payload_bytes_max", "storage.segment_mib"],
                format!("transactions of up to {payload} bytes and segments of {segment_mib} MiB"),
                "segments that hold at least two transactions of the largest size".into(),
            );
        }
    }
}

impl Console {
    fn read(&mut self, root: &mut Section<'_, '_>, directory: &Path) {
        let Self { listen, name, certificate, key } = self;
        let file = |text: &str| Some(if text.is_empty() { PathBuf::new() } else { directory.join(text) });
        root.section("console", |s| {
            s.text("listen", "HOST:PORT, for example \"127.0.0.1:7452\"", listen, address);
            let host = |text: &str| (!text.contains([':', '/', ' '])).then(|| text.to_ascii_lowercase());
            s.text("name", "a host name, for example \"robots.example.org\"", name, host);
            s.text("certificate", "a path", certificate, file);
            s.text("key", "a path", key, file);
        });
        if certificate.as_os_str().is_empty() != key.as_os_str().is_empty() {
            root.conflict(
                ["console.certificate", "console.key"],
                "one of the two".into(),
                "both, or none of them".into(),
            );
        }
    }
}

impl LogFormat {
    /// The format of that name.
    pub(crate) fn named(name: &str) -> Option<Self> {
        match name {
            "auto" => Some(Self::Auto),
            "text" => Some(Self::Text),
            "json" => Some(Self::Json),
            _ => None,
        }
    }
}

impl Log {
    /// The log of a command for people who try things: text also where it goes into a file, from this level on.
    pub(crate) fn for_people(level: LevelFilter) -> Self {
        Self { level, format: LogFormat::Text }
    }

    /// Reads the section `[log]`, of a node or of a bridge that is a process of its own.
    pub(crate) fn read(&mut self, root: &mut Section<'_, '_>) {
        root.section("log", |s| {
            s.text("level", "off, error, warn, info, debug or trace", &mut self.level, level);
            s.text("format", "auto, text or json", &mut self.format, LogFormat::named);
        });
    }
}

/// The page for whoever watches a bridge.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct BridgePage {
    /// `HOST:PORT` where it listens; empty = none.
    pub(crate) listen: String,
    /// Its certificate for TLS, with those of its issuers; empty = none, and the page is for its own machine.
    pub(crate) certificate: PathBuf,
    /// The key of that certificate.
    pub(crate) key: PathBuf,
    /// The authorities whose certificates clients show.
    pub(crate) clients: PathBuf,
}

impl BridgePage {
    /// Has it a certificate?
    pub(crate) fn is_secured(&self) -> bool {
        !self.certificate.as_os_str().is_empty()
    }

    fn read(&mut self, root: &mut Section<'_, '_>, directory: &Path) {
        let Self { listen, certificate, key, clients } = self;
        let file = |text: &str| Some(if text.is_empty() { PathBuf::new() } else { directory.join(text) });
        root.section("admin", |s| {
            s.text("listen", ADMIN_LISTEN, listen, address);
            for (name, place) in [("certificate", &mut *certificate), ("key", &mut *key), ("clients", &mut *clients)] {
                s.text(name, "a path", place, file);
            }
        });
        let given = [certificate, key, clients].iter().filter(|path| !path.as_os_str().is_empty()).count();
        if ![0, 3].contains(&given) {
            root.conflict(
                ["admin.certificate", "admin.clients"],
                format!("{given} of certificate, key and clients"),
                "all three, or none of them".into(),
            );
        }
    }
}

/// The settings of the process of a bridge, beside those of the bridge: they are a node's.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct OfBridge {
    /// `[log]`
    pub(crate) log: Log,
    /// `[admin]`
    pub(crate) admin: BridgePage,
    /// `[traces]`
    pub(crate) traces: Traces,
}

impl OfBridge {
    /// Reads them, and those of the bridge.
    ///
    /// # Errors
    /// Every fault of the file.
    pub(crate) fn load(path: &Path) -> Result<(Self, ros_bridge::Config), Vec<Fault>> {
        let mut program = Self::default();
        let bridge = ros_bridge::Config::load(path, |root| {
            program.log.read(root);
            program.admin.read(root, path.parent().unwrap_or(Path::new("")));
            program.traces.read(root);
        })?;
        Ok((program, bridge))
    }
}

/// How `admin.listen` is written.
const ADMIN_LISTEN: &str = "HOST:PORT, for example \"127.0.0.1:7451\"";

/// An address to listen at, or none.
fn address(text: &str) -> Option<String> {
    (text.is_empty() || is_address(text)).then(|| text.to_owned())
}

fn level(text: &str) -> Option<LevelFilter> {
    match text {
        "off" => Some(LevelFilter::OFF),
        "error" => Some(LevelFilter::ERROR),
        "warn" => Some(LevelFilter::WARN),
        "info" => Some(LevelFilter::INFO),
        "debug" => Some(LevelFilter::DEBUG),
        "trace" => Some(LevelFilter::TRACE),
        _ => None,
    }
}

/// Is it `HOST:PORT`? Port 0 lets the system choose. An IPv6 address stands in brackets.
pub(crate) fn is_address(text: &str) -> bool {
    let Some((host, port)) = text.rsplit_once(':') else { return false };
    let host = match host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
        Some(inner) => inner.parse::<std::net::Ipv6Addr>().is_ok(),
        None => !host.is_empty() && !host.contains([':', '[', ']', '/', ' ']),
    };
    host && port.parse::<u16>().is_ok()
}

const _: () = assert!(TRANSACTION_BYTES_MAX * 2 <= PAYLOAD_BYTES_MAX, "a block must hold the largest transaction");
