//! A real network for the tests of this folder: a `ledgerd` process, two users, a robot called Rover, and bridges as
//! processes of their own.

use crate::support::programs;
use bytes::Bytes;
use ledger_api::{Client, Context, Enrolment};
use ledger_hash::Hash;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const START_TIME_MAX: Duration = Duration::from_secs(20);
const LINE_TIME_MAX: Duration = Duration::from_secs(60);

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
pub(crate) struct Bridges(RefCell<Vec<Process>>);

impl Bridges {
    /// Ends the bridges and answers with what each reported.
    pub(crate) fn stop(self) -> [serde_json::Value; 3] {
        let reports = self.0.take().into_iter().map(Process::report);
        reports.collect::<Vec<_>>().try_into().unwrap()
    }

    /// Kills Salma's bridge as a crash would.
    pub(crate) fn kill_first(&self) {
        drop(self.0.borrow_mut().remove(0));
    }
}

/// The network: one node with both organisations.
pub(crate) struct World {
    pub(crate) salma: Client,
    pub(crate) farhad: Client,
    nodes: Vec<Process>,
    directory: TempDir,
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
        let home = directory.path().join("home");
        let mut node = ledgerd()
            .args(["dev", "--json", "--listen", "127.0.0.1:0", "--data"])
            .arg(directory.path().join("net"))
            .env("LEDGERD_HOME", &home)
            .stdout(Stdio::piped())
            .stderr(File::create(directory.path().join("node.log")).unwrap())
            .spawn()
            .map(Process)
            .unwrap();
        let mut line = String::new();
        BufReader::new(node.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let facts: serde_json::Value = serde_json::from_str(&line).unwrap();
        let (address, fingerprint) = (facts["address"].as_str().unwrap(), facts["ca_fingerprint"].as_str().unwrap());
        let fingerprint = Hash::from_hex(fingerprint).unwrap();
        let admin = Client::connect(&Context::load(&home, Some("dev-org1-admin")).unwrap()).await.unwrap();
        let owner = Client::connect(&Context::load(&home, Some("dev-org2-admin")).unwrap()).await.unwrap();
        let salma = enrol(&admin, &home, ("Salma", Role::Member), "Rover", address, fingerprint).await;
        let farhad = enrol(&admin, &home, ("Farhad", Role::Member), "Rover", address, fingerprint).await;
        enrol(&owner, &home, ("Rover", Role::Robot), "robot", address, fingerprint).await;
        register_rover(&owner, topic, kind, mode).await;
        Self { salma, farhad, nodes: vec![node], directory }
    }

    /// The same with two nodes: the users' one orders, the robot's one follows and carries the robot's bridge.
    pub(crate) async fn start_with_inner_bridge(topic: &str, kind: &str) -> Self {
        use ledgerd::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
        let directory = tempfile::tempdir().unwrap();
        let home = directory.path().join("home");
        let now = u64::try_from(std::time::UNIX_EPOCH.elapsed().unwrap().as_micros()).unwrap();
        // Alone in this network namespace: any port is free.
        let names = ["Org1", "Org2"];
        let addresses = ["127.0.0.1:7451", "127.0.0.1:7452"];
        let data = names.map(|name| directory.path().join(name));
        let nodes = (0..2).map(|i| PlannedNode {
            name: format!("node{i}"),
            organisation: names[i].into(),
            data: data[i].clone(),
            address: addresses[i].into(),
            voter: i == 0,
        });
        let organisations = names.map(|name| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 });
        let plan = NetworkPlan {
            snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
            label: "interop".into(),
            organisations: organisations.into(),
            nodes: nodes.collect(),
        };
        let founded = found(&plan, now).unwrap();
        let identity = |i: usize, name: &str, role| {
            issue(&data[i], names[i], (name, role), BTreeMap::new(), addresses[i], now).unwrap()
        };
        let (admin, owner, robot) =
            (identity(0, "Admin", Role::Admin), identity(1, "Admin", Role::Admin), identity(1, "Rover", Role::Robot));
        robot.save(&home).unwrap();
        let route = route("from_ledger", topic, kind).replace("[[route]]", "[[bridge.route]]");
        let bridge = format!(
            "[bridge]\ncontext_dir = {:?}\ndomain_id = 3\nshared_memory = false\n{route}",
            home.join("contexts/Rover")
        );
        let started = (0..2).map(|i| {
            let config = directory.path().join(format!("{}.toml", names[i]));
            let text =
                format!("data = {:?}\nlisten = {:?}\n{}", data[i], addresses[i], if i == 1 { &bridge } else { "" });
            fs::write(&config, text).unwrap();
            let log = File::create(directory.path().join(format!("{}.log", names[i]))).unwrap();
            Process(ledgerd().args(["run", "--config"]).arg(config).stderr(log).spawn().unwrap())
        });
        let nodes = started.collect();
        let (admin, owner) = (connect(&admin).await, connect(&owner).await);
        let fingerprint = founded.authorities[0].fingerprint;
        let salma = enrol(&admin, &home, ("Salma", Role::Member), "Rover", addresses[0], fingerprint).await;
        let farhad = enrol(&admin, &home, ("Farhad", Role::Member), "Rover", addresses[0], fingerprint).await;
        let height = register_rover(&owner, topic, kind, "exclusive").await;
        // The owner asked the other node: Salma's may be a moment behind it.
        salma.query_at(height, "abac", "robots", Vec::new()).await.unwrap();
        Self { salma, farhad, nodes, directory }
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
        Bridges(RefCell::new(sides.map(|(name, domain, way)| self.start_bridge(name, domain, way, topic, kind)).into()))
    }

    /// One bridge.
    pub(crate) fn start_bridge(&self, name: &str, domain: u16, direction: &str, topic: &str, kind: &str) -> Process {
        let config = self.bridge_config(name, domain, direction, topic, kind);
        let log = File::create(self.directory.path().join(format!("{name}.log"))).unwrap();
        let mut command = ledgerd();
        command.args(["bridge", "--config"]).arg(config).stdout(Stdio::piped()).stderr(log);
        Process(command.spawn().unwrap())
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
        fs::write(&config, format!("context_dir = {context:?}\n{settings}")).unwrap();
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
        fs::write(&config, format!("context_dir = {context:?}\ndomain_id = {domain}\nshared_memory = false\n{route}"))
            .unwrap();
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

pub(crate) fn route(direction: &str, topic: &str, kind: &str) -> String {
    format!("[[route]]\nservice = \"Rover{topic}\"\ndirection = {direction:?}\ntopic = {topic:?}\ntype = {kind:?}\n")
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
    let spec = serde_json::json!({"name": robot, "attribute_required": "Rover", "services": [service]});
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
