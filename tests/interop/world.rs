//! A real network for the tests of this folder: a `ledgerd` process, two users, a robot called Rover, and bridges as
//! processes of their own.

use crate::python::{Python, is_zenoh};
use crate::support::programs;
use bytes::Bytes;
use ledger_api::{Client, Context, Enrolment};
use ledger_base::hash::Hash;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::setup::{Founded, NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const START_TIME_MAX: Duration = Duration::from_secs(20);
const LINE_TIME_MAX: Duration = Duration::from_secs(60);
/// Each test is alone in its network namespace: any port is free.
const ADDRESS: &str = "127.0.0.1:7450";
/// A node refuses no message because a busy machine has made it wait.
const PATIENT_NODE: &str = "[order]\nwait_ms = 60000\n";
/// The silence that a busy machine makes stops no robot. Without a limit for its driver, only a grant's end and a stop do.
const PATIENT_ROBOT: &str = "command_timeout_ms = 0\nstale_after_ms = 10000\n";

/// Runs a test's body on a runtime of its own.
pub(crate) fn run(body: impl Future<Output = ()>) {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap().block_on(body);
}

/// A process that ends with the test.
pub(crate) struct Process(Child);

impl Process {
    /// One that was started.
    pub(crate) fn new(child: Child) -> Self {
        Self(child)
    }

    /// Its number.
    pub(crate) fn id(&self) -> u32 {
        self.0.id()
    }

    /// Does it still run?
    pub(crate) fn is_running(&mut self) -> bool {
        self.0.try_wait().unwrap().is_none()
    }

    /// Sends a signal.
    pub(crate) fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(i32::try_from(self.0.id()).unwrap()).unwrap();
        rustix::process::kill_process(pid, signal).unwrap();
    }
}

impl Process {
    /// Ends it as a service unit would, and answers with what it reported.
    pub(crate) fn report(mut self) -> serde_json::Value {
        self.send(rustix::process::Signal::TERM);
        let mut printed = String::new();
        self.0.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
        assert!(self.0.wait().unwrap().success());
        serde_json::from_str(printed.lines().last().unwrap()).unwrap()
    }

    pub(crate) fn send(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(i32::try_from(self.0.id()).unwrap()).unwrap();
        rustix::process::kill_process(pid, signal).unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The bridges of Salma, Farhad and the robot, in this order.
pub(crate) struct Bridges([Process; 3]);

impl Bridges {
    /// Ends the bridges and answers with what each reported.
    pub(crate) fn stop(self) -> [serde_json::Value; 3] {
        self.0.map(Process::report)
    }
}

/// The network: one node with both organisations.
pub(crate) struct World {
    pub(crate) salma: Client,
    pub(crate) farhad: Client,
    nodes: Vec<Process>,
    directory: TempDir,
    /// Where the graphs are those of rmw_zenoh.
    _router: Option<Python>,
}

fn ledgerd() -> Command {
    programs::node()
}

impl World {
    /// Starts the node, enrols everybody and registers the robot with one exclusive service.
    pub(crate) async fn start(topic: &str, kind: &str) -> Self {
        Self::start_with_mode(topic, kind, "exclusive").await
    }

    /// The same with a service of this mode.
    pub(crate) async fn start_with_mode(topic: &str, kind: &str, mode: &str) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let (home, data) = (directory.path().join("home"), directory.path().join("net"));
        let founded = found_by(vec![planned("node1", "Org1", &data, ADDRESS, true)]);
        let [admin, owner] = ["Org1", "Org2"].map(|organisation| {
            let mut context = issue_by(&data, organisation, ("Admin", Role::Admin), ADDRESS);
            context.name = format!("dev-{}-admin", organisation.to_lowercase());
            context.save(&home).unwrap();
            context
        });
        let console = "[console]\nlisten = \"127.0.0.1:0\"\n";
        let node = start_node(directory.path(), "node", &data, ADDRESS, console);
        let (admin, owner) = (connect(&admin).await, connect(&owner).await);
        let fingerprint = founded.authorities[0].fingerprint;
        let salma = enrol(&admin, &home, ("Salma", Role::Member), "Rover", ADDRESS, fingerprint).await;
        let farhad = enrol(&admin, &home, ("Farhad", Role::Member), "Rover", ADDRESS, fingerprint).await;
        enrol(&owner, &home, ("Rover", Role::Robot), "robot", ADDRESS, fingerprint).await;
        register_rover(&owner, topic, kind, mode).await;
        Self { salma, farhad, nodes: vec![node], directory, _router: router() }
    }

    /// The same with two nodes: the users' one orders, the robot's one follows and carries the robot's bridge.
    pub(crate) async fn start_with_inner_bridge(topic: &str, kind: &str) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let home = directory.path().join("home");
        let names = ["Org1", "Org2"];
        let addresses = ["127.0.0.1:7451", "127.0.0.1:7452"];
        let data = names.map(|name| directory.path().join(name));
        let nodes = (0..2).map(|i| planned(&format!("node{i}"), names[i], &data[i], addresses[i], i == 0));
        let founded = found_by(nodes.collect());
        let identity = |i: usize, name: &str, role| issue_by(&data[i], names[i], (name, role), addresses[i]);
        let (admin, owner, robot) =
            (identity(0, "Admin", Role::Admin), identity(1, "Admin", Role::Admin), identity(1, "Rover", Role::Robot));
        robot.save(&home).unwrap();
        let route = route("from_ledger", topic, kind).replace("[[route]]", "[[bridge.route]]");
        let bridge = format!(
            "[bridge]\ncontext_dir = {:?}\ndomain_id = 3\nshared_memory = false\n{route}",
            home.join("contexts/Rover")
        );
        let started = (0..2)
            .map(|i| start_node(directory.path(), names[i], &data[i], addresses[i], if i == 1 { &bridge } else { "" }));
        let nodes = started.collect();
        let (admin, owner) = (connect(&admin).await, connect(&owner).await);
        let fingerprint = founded.authorities[0].fingerprint;
        let salma = enrol(&admin, &home, ("Salma", Role::Member), "Rover", addresses[0], fingerprint).await;
        let farhad = enrol(&admin, &home, ("Farhad", Role::Member), "Rover", addresses[0], fingerprint).await;
        let height = register_rover(&owner, topic, kind, "exclusive").await;
        // The owner asked the other node: Salma's may be a moment behind it.
        salma.query_at(height, "abac", "robots", Vec::new()).await.unwrap();
        Self { salma, farhad, nodes, directory, _router: router() }
    }

    /// Changes the configuration of a node with a bridge inside, or beside it, and sends it SIGHUP.
    pub(crate) fn change_node(&self, index: usize, name: &str, change: impl FnOnce(String) -> String) {
        let config = self.directory.path().join(format!("{name}.toml"));
        fs::write(&config, change(fs::read_to_string(&config).unwrap())).unwrap();
        self.nodes[index].send(rustix::process::Signal::HUP);
    }

    /// The bridges of Salma (domain 1), Farhad (domain 2) and the robot (domain 3).
    pub(crate) fn start_bridges(&self, topic: &str, kind: &str) -> Bridges {
        let sides = [("Salma", 1, "to_ledger"), ("Farhad", 2, "to_ledger"), ("Rover", 3, "from_ledger")];
        Bridges(sides.map(|(name, domain, way)| self.start_bridge(name, domain, way, topic, kind)))
    }

    /// One bridge.
    pub(crate) fn start_bridge(&self, name: &str, domain: u16, direction: &str, topic: &str, kind: &str) -> Process {
        let config = self.bridge_config(name, domain, direction, topic, kind);
        let log = File::create(self.directory.path().join(format!("{name}.log"))).unwrap();
        let mut command = ledgerd();
        command.args(["bridge", "--config"]).arg(config).stdout(Stdio::piped()).stderr(log);
        Process(command.spawn().unwrap())
    }

    /// One bridge that stops the robot as soon as it does by default: for tests whose subject is silence.
    pub(crate) fn start_default_bridge(
        &self,
        name: &str,
        domain: u16,
        direction: &str,
        topic: &str,
        kind: &str,
    ) -> Process {
        let route = default_route(direction, topic, kind);
        self.start_bridge_as(name, &format!("domain_id = {domain}\nshared_memory = false\n{route}"), &[])
    }

    /// One bridge that serves local processes through shared memory as well.
    pub(crate) fn start_shared_memory_bridge(
        &self,
        name: &str,
        domain: u16,
        direction: &str,
        topic: &str,
        kind: &str,
    ) -> Process {
        let config = self.bridge_config(name, domain, direction, topic, kind);
        let text = fs::read_to_string(&config).unwrap().replace("shared_memory = false", "shared_memory = true");
        fs::write(&config, text).unwrap();
        let log = File::create(self.directory.path().join(format!("{name}.log"))).unwrap();
        Process(ledgerd().args(["bridge", "--config"]).arg(config).stdout(Stdio::null()).stderr(log).spawn().unwrap())
    }

    /// A bridge of this user with exactly these settings, and these variables in its environment.
    pub(crate) fn start_bridge_as(&self, name: &str, settings: &str, environment: &[(&str, &str)]) -> Process {
        let mut command = ledgerd();
        command.args(["bridge", "--config"]).arg(self.config_of(name, settings)).env_remove("ROS_DOMAIN_ID");
        command.envs(environment.iter().copied()).stdout(Stdio::piped());
        command.stderr(File::create(self.directory.path().join(format!("{name}.log"))).unwrap());
        Process(command.spawn().unwrap())
    }

    /// Writes the configuration of a user's bridge.
    pub(crate) fn config_of(&self, name: &str, settings: &str) -> PathBuf {
        let context = self.directory.path().join("home/contexts").join(name);
        let config = self.directory.path().join(format!("{name}.toml"));
        fs::write(&config, format!("context_dir = {context:?}\n{}{settings}", transport())).unwrap();
        config
    }

    /// Waits until the log of a process has a line with all these words, and answers with it.
    pub(crate) async fn line(&self, name: &str, words: &[&str]) -> String {
        let deadline = Instant::now() + LINE_TIME_MAX;
        loop {
            let log = fs::read_to_string(self.directory.path().join(format!("{name}.log"))).unwrap();
            if let Some(line) = log.lines().find(|line| words.iter().all(|word| line.contains(word))) {
                return line.to_owned();
            }
            assert!(Instant::now() < deadline, "{name} never said {words:?}\n{}", self.logs());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// How many lines of the log of a process have these words.
    pub(crate) fn lines(&self, name: &str, words: &str) -> usize {
        let log = fs::read_to_string(self.directory.path().join(format!("{name}.log"))).unwrap();
        log.lines().filter(|line| line.contains(words)).count()
    }

    /// Waits until the log of a process has more lines with these words than it had before.
    pub(crate) async fn another_line(&self, name: &str, words: &str, before: usize) {
        let deadline = Instant::now() + LINE_TIME_MAX;
        while self.lines(name, words) <= before {
            assert!(Instant::now() < deadline, "{name} did not say {words:?} again\n{}", self.logs());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Is this not in the log of a process?
    pub(crate) fn has_not_said(&self, name: &str, words: &str) -> bool {
        !fs::read_to_string(self.directory.path().join(format!("{name}.log"))).unwrap().contains(words)
    }

    /// How often is this in the log of a process?
    pub(crate) fn said(&self, name: &str, words: &str) -> usize {
        fs::read_to_string(self.directory.path().join(format!("{name}.log"))).unwrap().matches(words).count()
    }

    /// Ends a node with a bridge inside, or beside it, and starts it with a changed configuration.
    pub(crate) fn restart_node(&mut self, index: usize, name: &str, change: impl FnOnce(String) -> String) {
        let config = self.directory.path().join(format!("{name}.toml"));
        fs::write(&config, change(fs::read_to_string(&config).unwrap())).unwrap();
        let log = File::options().append(true).open(self.directory.path().join(format!("{name}.log"))).unwrap();
        self.nodes[index].send(rustix::process::Signal::TERM);
        assert!(self.nodes[index].0.wait().unwrap().success());
        self.nodes[index] = Process(ledgerd().args(["run", "--config"]).arg(config).stderr(log).spawn().unwrap());
    }

    /// The words of a bridge that refuses these settings.
    pub(crate) fn bridge_refuses(&self, name: &str, settings: &str) -> String {
        let output = ledgerd().args(["bridge", "--config"]).arg(self.config_of(name, settings)).output().unwrap();
        assert_eq!(output.status.code(), Some(3));
        String::from_utf8(output.stderr).unwrap()
    }

    /// The output of a bridge that cannot start.
    pub(crate) fn bridge_fails(&self, name: &str, topic: &str, kind: &str) -> String {
        let config = self.bridge_config(name, 1, "to_ledger", topic, kind);
        let output = ledgerd().args(["bridge", "--config"]).arg(config).output().unwrap();
        assert_eq!(output.status.code(), Some(3));
        String::from_utf8(output.stderr).unwrap()
    }

    fn bridge_config(&self, name: &str, domain: u16, direction: &str, topic: &str, kind: &str) -> PathBuf {
        let context = self.directory.path().join("home/contexts").join(name);
        let config = self.directory.path().join(format!("{name}.toml"));
        let route = route(direction, topic, kind);
        let settings = format!("domain_id = {domain}\nshared_memory = false\n{route}");
        fs::write(&config, format!("context_dir = {context:?}\n{}{settings}", transport())).unwrap();
        config
    }

    /// Registers another robot, with one exclusive service.
    pub(crate) async fn register(&self, robot: &str, topic: &str, kind: &str) {
        let home = self.directory.path().join("home");
        let owner = Client::connect(&Context::load(&home, Some("dev-org2-admin")).unwrap()).await.unwrap();
        register(&owner, robot, topic, kind, "exclusive").await;
    }

    /// A path below the directory of the test: `home` of the contexts, `net` of the node.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The process of a node.
    pub(crate) fn node(&self) -> &Process {
        self.nodes.first().unwrap()
    }

    /// The logs of all processes, for a failure's message.
    pub(crate) fn logs(&self) -> String {
        let logs = fs::read_dir(self.directory.path()).unwrap().flatten().map(|entry| entry.path());
        let logs = logs.filter(|path| path.extension().is_some_and(|extension| extension == "log"));
        logs.map(|path| format!("--- {}\n{}", path.display(), fs::read_to_string(&path).unwrap())).collect()
    }
}

/// The middleware of a bridge, as a line of its configuration.
fn transport() -> &'static str {
    if is_zenoh() { "transport = 'zenoh'\n" } else { "" }
}

/// The router of the graphs, which a graph of DDS does not have.
fn router() -> Option<Python> {
    is_zenoh().then(|| {
        let mut router = Python::start("router.py", &[]);
        assert_eq!(router.line().unwrap(), "ready");
        router
    })
}

/// A route that stops the robot for no silence of a busy machine.
pub(crate) fn route(direction: &str, topic: &str, kind: &str) -> String {
    let patience = if direction == "from_ledger" { PATIENT_ROBOT } else { "" };
    default_route(direction, topic, kind) + patience
}

/// A route that stops the robot as soon as it does by default.
pub(crate) fn default_route(direction: &str, topic: &str, kind: &str) -> String {
    format!("[[route]]\nservice = \"Rover{topic}\"\ndirection = {direction:?}\ntopic = {topic:?}\ntype = {kind:?}\n")
}

/// A node that is to be founded.
fn planned(name: &str, organisation: &str, data: &Path, address: &str, voter: bool) -> PlannedNode {
    let [name, organisation, address] = [name, organisation, address].map(str::to_owned);
    PlannedNode { name, organisation, data: data.to_owned(), address, voter }
}

/// Founds a network of both organisations with these nodes.
fn found_by(nodes: Vec<PlannedNode>) -> Founded {
    let organisation = |name: &str| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 };
    let plan = NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: "interop".into(),
        organisations: vec![organisation("Org1"), organisation("Org2")],
        nodes,
    };
    found(&plan, now()).unwrap()
}

/// An identity of an organisation whose CA lies there, before the node runs.
fn issue_by(data: &Path, organisation: &str, who: (&str, Role), address: &str) -> Context {
    issue(data, organisation, who, BTreeMap::new(), address, now()).unwrap()
}

/// The machine's clock, microseconds since the UNIX epoch.
fn now() -> u64 {
    u64::try_from(std::time::UNIX_EPOCH.elapsed().unwrap().as_micros()).unwrap()
}

/// Starts a node with these settings; its configuration and its log have its name.
fn start_node(directory: &Path, name: &str, data: &Path, address: &str, more: &str) -> Process {
    let config = directory.join(format!("{name}.toml"));
    fs::write(&config, format!("data = {data:?}\nlisten = {address:?}\n{PATIENT_NODE}{more}")).unwrap();
    let log = File::create(directory.join(format!("{name}.log"))).unwrap();
    Process(ledgerd().args(["run", "--config"]).arg(config).stdout(Stdio::null()).stderr(log).spawn().unwrap())
}

async fn enrol(
    admin: &Client,
    home: &Path,
    (name, role): (&str, Role),
    attribute: &str,
    address: &str,
    fingerprint: Hash,
) -> Client {
    let attributes = BTreeMap::from([(attribute.to_owned(), "true".to_owned())]);
    let secret = admin.register(name, role, &attributes).await.unwrap().secret;
    let context = Enrolment::new(address, fingerprint).enrol(name, &secret, KeyKind::Ed25519).await.unwrap();
    context.save(home).unwrap();
    Client::connect(&context).await.unwrap()
}

async fn register_rover(owner: &Client, topic: &str, kind: &str, mode: &str) -> u64 {
    register(owner, "Rover", topic, kind, mode).await
}

async fn register(owner: &Client, robot: &str, topic: &str, kind: &str, mode: &str) -> u64 {
    let service = serde_json::json!({"topic": topic, "type": kind, "mode": mode, "max_age_ms": 5000, "lease_ms": 4000});
    let spec = serde_json::json!({"name": robot, "attribute_required": "Rover", "trusted": ["Org1", "Org2"], "services": [service]});
    owner.invoke("abac", "setup", vec![Bytes::from(spec.to_string())]).await.unwrap().height
}

async fn connect(context: &Context) -> Client {
    let deadline = Instant::now() + START_TIME_MAX;
    loop {
        match Client::connect(context).await {
            Ok(client) => return client,
            Err(rejection) => assert!(Instant::now() < deadline, "{rejection}"),
        }
    }
}
