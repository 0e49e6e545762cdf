//! The paper's network with its two bridges. The operator's is a process of its own beside the node of her
//! organisation; the robot's is inside the node that its owner has on it.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::{Founding, PAPER, clock, robots};
use crate::network::Network;
use bytes::Bytes;
use ledger_api::{Client, Context};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledgerd::setup::issue;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time for a node to answer after it was started.
const START_TIME_MAX: Duration = Duration::from_secs(20);
const BRIDGE_LOG: &str = "bridge.log";
/// Longest lease: no bench shall measure a renewal.
const LEASE_MS: &str = "600000";

/// A running network with bridges; all of it ends with it.
pub(crate) struct Site {
    bridge: Option<Bridge>,
    pub(crate) network: Network,
    home: TempDir,
}

struct Bridge(Child);

impl Drop for Site {
    fn drop(&mut self) {
        // What a bridge said tells why nothing arrived.
        let robots = self.network.founding().nodes.last().map(|(data, _)| data.with_extension("log"));
        let logs = std::iter::once(self.home.path().join(BRIDGE_LOG)).chain(robots);
        for log in logs.filter(|_| std::thread::panicking()) {
            println!("{log:?}: {}", std::fs::read_to_string(&log).unwrap_or_default());
        }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _status = self.0.wait();
    }
}

impl Site {
    /// Starts everything. Salma holds the Turtlebot4, and her bridge joins that domain; the robot's bridge the other one.
    pub(crate) async fn start(operator_domain: u16, robot_domain: u16) -> Self {
        let home = tempfile::tempdir().unwrap();
        let founding = Founding::new(PAPER);
        let (owners, address) = founding.nodes.last().cloned().unwrap();
        // By its CA, before a node owns that.
        let robot = issue(&owners, "Org2", ("Turtlebot4", Role::Robot), BTreeMap::new(), &address, clock()).unwrap();
        let (salma, owner) = (founding.salma.clone(), founding.owner.clone());
        for identity in [&salma, &robot] {
            identity.save(home.path()).unwrap();
        }
        let inside =
            format!("[bridge]\n{}", bridge_settings(home.path(), "Turtlebot4", robot_domain, "from_ledger", "bridge."));
        let mut network = Network::of(founding);
        for node in 0..PAPER.voters {
            network.start_node(node, "");
        }
        network.start_node(PAPER.voters, &inside);
        network.raise_quotas().await;
        connect(&owner).await.invoke("abac", "setup", robots()).await.unwrap();
        let lease = ["Turtlebot4", LEASE_MS].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let granted = connect(&salma).await.invoke("abac", "acquire", lease.into()).await.unwrap();
        // The robot's node may be a moment behind.
        connect(&robot).await.query_at(granted.height, "abac", "robots", Vec::new()).await.unwrap();
        let bridge = Bridge::start(home.path(), "Salma", operator_domain, "to_ledger");
        Self { bridge: Some(bridge), network, home }
    }

    /// The process of the robot's node, which only follows, with the robot's bridge inside.
    pub(crate) fn robots_node(&self) -> u32 {
        *self.network.processes().last().unwrap()
    }

    /// All processes: nodes, and the operator's bridge.
    pub(crate) fn processes(&self) -> Vec<u32> {
        let bridge = self.bridge.iter().map(|bridge| bridge.0.id());
        self.network.processes().into_iter().chain(bridge).collect()
    }

    /// Somebody else acquires the Turtlebot4, and has a bridge in this domain instead of Salma's.
    pub(crate) async fn drive(&mut self, who: &Context, domain: u16) {
        who.save(self.home.path()).unwrap();
        let lease = ["Turtlebot4", LEASE_MS].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        connect(who).await.invoke("abac", "acquire", lease.into()).await.unwrap();
        self.bridge = Some(Bridge::start(self.home.path(), &who.name, domain, "to_ledger"));
    }

    /// Ends the operator's bridge in order; answers with what it has done.
    pub(crate) fn stop(mut self) -> serde_json::Value {
        self.bridge.take().unwrap().stop()
    }
}

/// The settings of a bridge; everything else is as it is by default: DDS and shared memory.
fn bridge_settings(home: &Path, name: &str, domain: u16, direction: &str, section: &str) -> String {
    let context = home.join("contexts").join(name);
    format!(
        "context_dir = {context:?}\ndomain_id = {domain}\n\n[[{section}route]]\nservice = \"Turtlebot4/cmd_vel\"\n\
         direction = \"{direction}\"\ntype = \"geometry_msgs/msg/Twist\"\n"
    )
}

impl Bridge {
    fn start(home: &Path, name: &str, domain: u16, direction: &str) -> Self {
        let config = home.join(format!("{name}.toml"));
        std::fs::write(&config, bridge_settings(home, name, domain, direction, "")).unwrap();
        let log = File::create(home.join(BRIDGE_LOG)).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_ledgerd"));
        command.args(["bridge", "--config"]).arg(config).stdout(Stdio::piped()).stderr(log);
        Self(command.spawn().unwrap())
    }

    fn stop(mut self) -> serde_json::Value {
        let process = rustix::process::Pid::from_raw(i32::try_from(self.0.id()).unwrap()).unwrap();
        rustix::process::kill_process(process, rustix::process::Signal::TERM).unwrap();
        let mut printed = String::new();
        self.0.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
        serde_json::from_str(printed.lines().last().expect("a bridge prints its summary")).unwrap()
    }
}

/// Connects as soon as the node answers.
async fn connect(context: &Context) -> Client {
    let deadline = Instant::now() + START_TIME_MAX;
    loop {
        match Client::connect_to(context.nodes.clone(), context.credentials().unwrap()).await {
            Ok(client) => return client,
            Err(refused) => {
                assert!(refused.code == Code::Unreachable && Instant::now() < deadline, "{refused}");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    }
}
