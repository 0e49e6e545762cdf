//! A network on disk with its nodes as processes, and identities of it.

use super::process::Process;
use super::wait::{PATIENCE, until};
use super::{Ctl, programs};
use bytes::Bytes;
use ledger_api::context::Context;
use ledger_api::{Client, Options};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::ca::CertificateAuthority;
use ledgerd::setup::{Founded, NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use rustls_pki_types::CertificateDer;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{SystemTime, UNIX_EPOCH};
use tempfile::TempDir;

/// The service that most tests publish on.
pub const SERVICE: &str = "Turtlebot4/cmd_vel";

/// The machine's clock, microseconds since the UNIX epoch.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros() as u64
}

/// An address that nobody uses. The port lies below those that the system gives to outgoing connections, so that it
/// is still free when a node that was killed comes back.
pub fn free_address() -> String {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let first = first_port();
    for _ in 0..PORTS {
        let address = format!("127.0.0.1:{}", first + NEXT.fetch_add(1, Ordering::Relaxed) % PORTS);
        if TcpListener::bind(&address).is_ok() {
            return address;
        }
    }
    panic!("no free port on 127.0.0.1 from {first} on");
}

/// The ports of one process.
const PORTS: u16 = 120;

/// The first of the ports that this process has for itself: tests run in many processes at a time.
fn first_port() -> u16 {
    const FIRST: u16 = 12_000;
    const PROCESSES: u16 = 150;
    static TAKEN: OnceLock<(u16, File)> = OnceLock::new();
    let take = |place: u16| {
        let path = std::env::temp_dir().join(format!("ledgerd-test-ports-{place}"));
        let file = File::options().create(true).append(true).open(path).ok()?;
        file.try_lock().ok().map(|()| (place, file))
    };
    let (place, _locked) =
        TAKEN.get_or_init(|| (0..PROCESSES).find_map(take).expect("a block of ports that no other test has"));
    FIRST + place * PORTS
}

/// A node's place: directory, address, configuration.
pub struct NodePlace {
    /// The name of the node.
    pub name: String,
    /// The organisation that runs it.
    pub organisation: String,
    /// Its data directory.
    pub data: PathBuf,
    /// Its address, with the port.
    pub address: String,
    /// Its configuration file.
    pub config: PathBuf,
    logs: PathBuf,
}

impl NodePlace {
    /// `ledgerd run` with its configuration.
    pub fn command(&self) -> Command {
        let mut command = programs::node();
        command.args(["run", "--config"]).arg(&self.config);
        command
    }

    /// Starts the node.
    pub fn start(&self) -> Process {
        self.start_as(self.command())
    }

    /// Starts another program in the node's place.
    pub fn start_as(&self, command: Command) -> Process {
        Process::start(&self.name, &self.logs, command)
    }

    /// Another place of the same node, with a data directory of its own.
    pub fn beside(&self, name: &str, data: PathBuf) -> Self {
        let text = std::fs::read_to_string(&self.config).unwrap();
        let config = self.config.with_file_name(format!("{name}.toml"));
        std::fs::write(&config, text.replace(&self.data.display().to_string(), &data.display().to_string())).unwrap();
        let (organisation, address, logs) = (self.organisation.clone(), self.address.clone(), self.logs.clone());
        Self { name: name.to_owned(), organisation, data, address, config, logs }
    }

    /// Adds settings to the configuration: TOML sections, or settings of the top level before any section.
    pub fn configure(&self, settings: &str) {
        let text = std::fs::read_to_string(&self.config).unwrap();
        std::fs::write(&self.config, format!("{text}\n{settings}\n")).unwrap();
    }

    /// The log of its processes so far.
    pub fn logged(&self) -> String {
        std::fs::read_to_string(self.logs.join(format!("{}.err", self.name))).unwrap_or_default()
    }

    /// The segments of its log, oldest first.
    pub fn segments(&self) -> Vec<PathBuf> {
        let mut found: Vec<_> = std::fs::read_dir(self.data.join("blocks"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|extension| extension == "seg"))
            .collect();
        found.sort();
        found
    }
}

/// A node that is to be founded.
#[derive(Clone)]
pub struct NodeWish {
    /// The name of the node.
    pub name: String,
    /// The organisation that runs it.
    pub organisation: String,
    /// A voter, or a learner.
    pub voter: bool,
    /// Its address, with the port.
    pub address: String,
}

impl NodeWish {
    /// A voter of Org1 and, if there are to be two nodes, a learner of Org2: the paper's topology.
    fn paper(nodes: usize) -> Vec<Self> {
        let wish = |name: &str, organisation: &str, voter| Self {
            name: name.into(),
            organisation: organisation.into(),
            voter,
            address: free_address(),
        };
        let mut both = vec![wish("org1-node", "Org1", true), wish("org2-node", "Org2", false)];
        both.truncate(nodes);
        both
    }
}

/// The paper's organisations on nodes in a temporary directory: Org1 with the users, Org2 which owns the robots.
pub struct Fleet {
    /// Its nodes.
    pub nodes: Vec<NodePlace>,
    /// The keys and certificates of its founding.
    pub founded: Founded,
    // Last: removed after everything else.
    directory: TempDir,
}

impl Fleet {
    /// Founds a network with one voter, and a learner of Org2 if there are to be two nodes. Nothing runs yet.
    pub fn found(nodes: usize) -> Self {
        Self::found_at(nodes, now())
    }

    /// As [`Fleet::found`], by another clock.
    pub fn found_at(nodes: usize, now: u64) -> Self {
        Self::found_with(&NodeWish::paper(nodes), now)
    }

    /// Founds a network of these nodes; the first one of each organisation carries its CA. Nothing runs yet.
    pub fn found_with(wishes: &[NodeWish], now: u64) -> Self {
        Self::found_every(wishes, now, ledger::network::SNAPSHOT_EVERY_DEFAULT)
    }

    /// As [`Fleet::found_with`], with so many blocks between snapshots.
    pub fn found_every(wishes: &[NodeWish], now: u64, snapshot_every: u64) -> Self {
        let directory = tempfile::Builder::new().prefix("ledgerd-test-").tempdir().unwrap();
        let place = |wish: &NodeWish| NodePlace {
            name: wish.name.clone(),
            organisation: wish.organisation.clone(),
            data: directory.path().join(&wish.name),
            address: wish.address.clone(),
            config: directory.path().join(format!("{}.toml", wish.name)),
            logs: directory.path().to_owned(),
        };
        let places: Vec<_> = wishes.iter().map(place).collect();
        let planned = places.iter().zip(wishes).map(|(place, wish)| PlannedNode {
            name: place.name.clone(),
            organisation: place.organisation.clone(),
            data: place.data.clone(),
            address: place.address.clone(),
            voter: wish.voter,
        });
        let owners = wishes.iter().map(|wish| &*wish.organisation);
        let names: BTreeSet<&str> = ["Org1", "Org2"].into_iter().chain(owners).collect();
        let organisation = |name: &str| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 };
        let plan = NetworkPlan {
            snapshot_every,
            label: "test".into(),
            organisations: names.iter().map(|name| organisation(name)).collect(),
            nodes: planned.collect(),
        };
        let founded = found(&plan, now).unwrap();
        for place in &places {
            let text = format!("data = {:?}\nlisten = {:?}\n", place.data.display().to_string(), place.address);
            std::fs::write(&place.config, text).unwrap();
        }
        Self { nodes: places, founded, directory }
    }

    /// The temporary directory.
    pub fn path(&self) -> &Path {
        self.directory.path()
    }

    /// The home directory of the people of this network.
    pub fn home(&self) -> PathBuf {
        self.path().join("home")
    }

    /// `ledgerctl` on that home.
    pub fn ctl(&self) -> Ctl {
        Ctl::at(&self.home())
    }

    /// The data directory that carries the CA of an organisation.
    fn ca_data(&self, organisation: &str) -> &Path {
        let authority = self.founded.authorities.iter().find(|ca| ca.organisation == organisation).unwrap();
        authority.directory.parent().unwrap().parent().unwrap()
    }

    /// An identity, by its CA without being asked over the network; its context is stored too. Before the node runs.
    pub fn issue(&self, organisation: &str, name: &str, role: Role, attributes: &[&str]) -> Context {
        let attributes: BTreeMap<_, _> = attributes.iter().map(|key| ((*key).into(), "true".into())).collect();
        let node = self.nodes.iter().find(|node| node.organisation == organisation).unwrap_or(&self.nodes[0]);
        let data = self.ca_data(organisation);
        let context = issue(data, organisation, (name, role), attributes, &node.address, now()).unwrap();
        context.save(&self.home()).unwrap();
        context
    }

    /// An identity whose certificate was issued at another time and for so many days.
    pub fn issue_at(&self, name: &str, issued: u64, days: u32) -> Context {
        let attributes: BTreeMap<_, _> = [("Turtlebot4".to_owned(), "true".to_owned())].into();
        let who = (name, Role::Member);
        let context =
            issue(self.ca_data("Org1"), "Org1", who, attributes.clone(), &self.nodes[0].address, issued).unwrap();
        let mut authority = CertificateAuthority::open(&self.founded.authorities[0].directory).unwrap();
        authority.set_days(days, 7);
        let shifted = authority.issue(name, Role::Member, attributes, KeyKind::Ed25519, issued).unwrap();
        let chain = std::iter::once(shifted.certificate).chain(shifted.chain).map(CertificateDer::from).collect();
        let context = Context { chain, key: Arc::new(shifted.key), ..context };
        context.save(&self.home()).unwrap();
        context
    }

    /// The admin of Org2, who owns the robots. Before the node runs.
    pub fn owner(&self) -> Context {
        self.issue("Org2", "Admin", Role::Admin, &[])
    }
}

/// A client that is more patient than any restart of a node takes.
pub async fn connect(context: &Context) -> Client {
    until(&format!("{} connects to {:?}", context.name, context.nodes), || async {
        let options = Options {
            deadline: PATIENCE,
            ttl: 2 * PATIENCE - std::time::Duration::from_secs(10),
            ..Options::default()
        };
        match Client::connect_with(context.nodes.clone(), context.credentials().unwrap(), options).await {
            Ok(client) => Some(client),
            Err(refused) if refused.code == Code::Unreachable => None,
            Err(refused) => panic!("{} cannot connect: {refused}", context.name),
        }
    })
    .await
}

/// The robots of the paper, with `/cmd_vel` in this mode. They trust each organisation of the network.
pub async fn register_robots(owner: &Client, mode: &str) {
    let members = owner.query("msp", "organisations", vec![]).await.unwrap().response;
    let members: Vec<String> = serde_json::from_slice(&members).unwrap();
    let robot = |name: &str| {
        let service = json!({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": mode});
        Bytes::from(
            json!({"name": name, "attribute_required": name, "trusted": members, "services": [service]}).to_string(),
        )
    };
    owner.invoke("abac", "setup", vec![robot("Turtlebot4"), robot("Husky")]).await.unwrap();
}

/// A robot that nobody uses.
pub const MARKER: &str =
    r#"{"name":"Marker","attribute_required":"Marker","services":[{"topic":"/m","type":"std_msgs/msg/Empty"}]}"#;

/// A transaction of an admin without consequence; answers with the height of its block.
pub async fn some_block(admin: &Client) -> u64 {
    let robot = MARKER.replace("Marker", &format!("Marker{}", now()));
    admin.invoke("abac", "setup", vec![robot.into()]).await.unwrap().height
}

/// The arguments of `set` for one message.
pub fn message(epoch: u64, seq: u64, content: &[u8]) -> Vec<Bytes> {
    let payload = [&[0, 1, 0, 0], content].concat();
    vec![SERVICE.into(), epoch.to_string().into(), seq.to_string().into(), payload.into()]
}
