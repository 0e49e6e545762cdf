//! Each node of a network dies in turn, and `ledgerctl`, bridges and the Rust client go on through another one. All that
//! their contexts say at the beginning is one node of their organisation.

use crate::world::{Process, default_route, run};
use crate::{call, network, programs};
use bytes::Bytes;
use ledger_api::{Client, Context};
use ledger_gate::sample::Sample;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use ros_bridge::{names::TopicName, queue::Limits, shm};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Far more than anything here takes.
const PATIENCE: Duration = Duration::from_secs(90);
/// The nodes by organisation. Any two of them order, and certify, without the third.
const ORGANISATIONS: [&str; 3] = ["Org1", "Org2", "Org3"];
/// Alone in this network namespace: any port is free.
pub(crate) const ADDRESSES: [&str; 3] = ["127.0.0.1:7451", "127.0.0.1:7452", "127.0.0.1:7453"];
pub(crate) const TYPE: &str = "geometry_msgs/msg/Twist";

pub(crate) struct Trio {
    pub(crate) nodes: [Option<Process>; 3],
    directory: TempDir,
}

impl Trio {
    /// Founds the network with Salma, the robot Rover and the admins; nothing runs yet.
    pub(crate) fn found() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let nodes = (0..3).map(|i| PlannedNode {
            name: format!("node{i}"),
            organisation: ORGANISATIONS[i].into(),
            data: directory.path().join(format!("node{i}")),
            address: ADDRESSES[i].into(),
            voter: true,
        });
        let plan = NetworkPlan {
            snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
            label: "trio".into(),
            organisations: ORGANISATIONS
                .map(|name| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 })
                .into(),
            nodes: nodes.collect(),
        };
        let now = u64::try_from(std::time::UNIX_EPOCH.elapsed().unwrap().as_micros()).unwrap();
        found(&plan, now).unwrap();
        let home = directory.path().join("home");
        for (node, name, role) in [(0, "Salma", Role::Member), (2, "Owner", Role::Admin), (2, "Rover", Role::Robot)] {
            let attributes = BTreeMap::from([("Rover".to_owned(), "true".to_owned())]);
            let data = directory.path().join(format!("node{node}"));
            issue(&data, ORGANISATIONS[node], (name, role), attributes, ADDRESSES[node], now)
                .unwrap()
                .save(&home)
                .unwrap();
        }
        for (i, address) in ADDRESSES.iter().enumerate() {
            let data = directory.path().join(format!("node{i}"));
            let config = directory.path().join(format!("node{i}.toml"));
            fs::write(config, format!("data = {data:?}\nlisten = {address:?}\n")).unwrap();
        }
        Self { nodes: [const { None }; 3], directory }
    }

    fn home(&self) -> PathBuf {
        self.directory.path().join("home")
    }

    pub(crate) fn context(&self, name: &str) -> Context {
        Context::load(&self.home(), Some(name)).unwrap()
    }

    pub(crate) fn start(&mut self, node: usize) {
        let config = self.directory.path().join(format!("node{node}.toml"));
        let log = File::options().create(true).append(true).open(self.directory.path().join(format!("node{node}.log")));
        let mut command = programs::node();
        command.args(["run", "--config"]).arg(config).stderr(log.unwrap()).stdout(Stdio::null());
        self.nodes[node] = Some(Process::new(command.spawn().unwrap()));
    }

    /// Registers the robot; the owner's client.
    pub(crate) async fn register(&self) -> Client {
        let owner = self.until("the owner connects", async || Client::connect(&self.context("Owner")).await.ok()).await;
        let service = serde_json::json!({"topic": "/cmd_vel", "type": TYPE, "mode": "exclusive", "max_age_ms": 5000});
        let rover = serde_json::json!({"name": "Rover", "attribute_required": "Rover", "trusted": ORGANISATIONS, "services": [service]});
        let registered = owner.invoke("abac", "setup", vec![Bytes::from(rover.to_string())]).await.unwrap();
        self.has_caught_up(0, registered.height).await;
        owner
    }

    /// Waits until this node has executed everything up to a height.
    pub(crate) async fn has_caught_up(&self, node: usize, height: u64) {
        let credentials = self.context("Salma").credentials().unwrap();
        let address = vec![ADDRESSES[node].to_owned()];
        self.until("a node that came back follows", async || {
            let client = Client::connect_to(address.clone(), credentials.clone()).await.ok()?;
            let status = client.status().await.ok()?;
            (status.height >= height && status.leader_id != 0).then_some(())
        })
        .await;
    }

    /// A bridge between shared memory and the ledger, with more settings of its route.
    pub(crate) fn bridge(&self, name: &str, domain: u16, direction: &str, settings: &str) -> Process {
        let config = self.directory.path().join(format!("{name}.toml"));
        let context = self.home().join("contexts").join(name);
        let route = default_route(direction, "/cmd_vel", TYPE);
        fs::write(
            &config,
            format!("context_dir = {context:?}\ndomain_id = {domain}\nshared_memory = true\n{route}\n{settings}\n"),
        )
        .unwrap();
        let log = File::create(self.directory.path().join(format!("{name}.log"))).unwrap();
        let mut command = programs::node();
        Process::new(
            command.args(["bridge", "--config"]).arg(config).stdout(Stdio::null()).stderr(log).spawn().unwrap(),
        )
    }

    /// Runs `ledgerctl` as Salma; says why it failed.
    fn ledgerctl(&self, arguments: &[&str]) -> Result<(), String> {
        let mut command = Command::new(programs::ledgerctl());
        command.args(["--context", "Salma"]).args(arguments).env("LEDGERD_HOME", self.home());
        let done = command.output().unwrap();
        if done.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&done.stderr).into_owned()) }
    }

    pub(crate) async fn until<T>(&self, what: &str, mut look: impl AsyncFnMut() -> Option<T>) -> T {
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(found) = look().await {
                return found;
            }
            assert!(Instant::now() < deadline, "never happened: {what}\n{}", self.logs());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    pub(crate) fn logs(&self) -> String {
        let logs = fs::read_dir(self.directory.path()).unwrap().flatten().map(|entry| entry.path());
        let logs = logs.filter(|path| path.extension().is_some_and(|extension| extension == "log"));
        logs.map(|path| format!("--- {}\n{}", path.display(), fs::read_to_string(&path).unwrap())).collect()
    }
}

/// Salma's messages as they reach the robot, through two bridges.
struct Drive {
    publisher: shm::Publisher,
    subscriber: shm::Subscriber,
    number: u64,
}

impl Drive {
    /// Publishes until something arrives that was published after this began.
    async fn one_message(&mut self, trio: &Trio) {
        let first = self.number;
        let Self { publisher, subscriber, number } = self;
        trio.until("a message passes both bridges", async || {
            *number += 1;
            let mut content = [0; 48];
            content[..8].copy_from_slice(&number.to_le_bytes());
            publisher.write(&Sample::new([0, 1], &content).unwrap()).unwrap();
            let received = tokio::time::timeout(Duration::from_millis(50), subscriber.next()).await.ok()??;
            let bytes: [u8; 8] = received.sample.body()[..8].try_into().unwrap();
            (u64::from_le_bytes(bytes) > first).then_some(())
        })
        .await;
    }
}

#[test]
fn each_node_dies_in_turn_and_ledgerctl_bridges_and_the_rust_client_go_on_through_another() {
    if !network::isolated(&|| ()) {
        return;
    }
    run(async {
        let mut trio = Trio::found();
        (0..3).for_each(|node| trio.start(node));
        trio.register().await;
        let salma = Client::connect(&trio.context("Salma")).await.unwrap();
        call(&salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let mut bridges = [trio.bridge("Salma", 211, "to_ledger", ""), trio.bridge("Rover", 212, "from_ledger", "")];
        let topic = TopicName::parse("/cmd_vel").unwrap();
        let operator = shm::Node::open(211, "operator", [7; 16]).await.unwrap();
        let robot = shm::Node::open(212, "robot", [8; 16]).await.unwrap();
        let publisher = operator.publisher(&topic).await.unwrap();
        let subscriber = robot.subscriber(&topic, Limits::default()).await.unwrap();
        let mut drive = Drive { publisher, subscriber, number: 0 };
        drive.one_message(&trio).await;

        for dead in [0, 1, 2] {
            // Killed: nobody listens any more. Then stopped: it takes connections, and says nothing.
            for killed in [true, false] {
                match killed {
                    true => trio.nodes[dead] = None,
                    false => trio.nodes[dead].as_ref().unwrap().signal(Signal::STOP),
                }
                trio.until("the client goes on", async || {
                    salma.invoke("abac", "renew", vec!["Rover/cmd_vel".into()]).await.ok()
                })
                .await;
                drive.one_message(&trio).await;
                for arguments in [&["robot", "list"][..], &["renew", "Rover/cmd_vel", "--for", "10m"]] {
                    let mut last = String::new();
                    let told = async || trio.ledgerctl(arguments).map_err(|reason| last = reason).ok();
                    trio.until("ledgerctl goes on", told).await;
                }
                assert_ne!(*salma.node(), *ADDRESSES[dead]);
                match killed {
                    true => trio.start(dead),
                    false => trio.nodes[dead].as_ref().unwrap().signal(Signal::CONT),
                }
                let height = salma.invoke("abac", "renew", vec!["Rover/cmd_vel".into()]).await.unwrap().height;
                trio.has_caught_up(dead, height).await;
            }
        }
        for bridge in &mut bridges {
            assert!(bridge.is_running(), "{}", trio.logs());
        }
    });
}
