//! Emergency stops of a robot that is driven: from the call of `stop` to the stop message on the robot's topic, over DDS.

use crate::founding::{Founding, clock, twist};
use crate::load::histogram;
use crate::network::Network;
use bytes::Bytes;
use hdrhistogram::Histogram;
use ledger_abac::Grant;
use ledger_api::Client;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledgerd::setup::issue;
use ros_bridge::dds::{Participant, Reader};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::collections::BTreeMap;
use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::time::timeout;

/// The robot, as `Network::register` makes it.
pub(crate) const ROBOT: &str = "Stopped";
/// ROS domain of the robot.
const DOMAIN: u16 = 221;
/// Time for the bridge to be there.
const CONNECT_MAX: Duration = Duration::from_secs(30);
/// A command that did not arrive within this time is sent again.
const ARRIVAL_MAX: Duration = Duration::from_millis(500);

/// The robot's bridge, a process of its own, which is not founded with the network.
pub(crate) struct Site {
    home: TempDir,
}

impl Site {
    /// The robot's identity, by the CA of its owner, before a node owns that.
    pub(crate) fn of(founding: &Founding) -> Self {
        let home = tempfile::tempdir().unwrap();
        let (owners, address) = founding.nodes.last().unwrap();
        let robot = issue(owners, "Org2", (ROBOT, Role::Robot), BTreeMap::new(), address, clock()).unwrap();
        robot.save(home.path()).unwrap();
        Self { home }
    }

    /// Starts the bridge of the registered robot, and listens to the robot's topic.
    pub(crate) async fn open(self, network: &Network, driver: usize) -> Stops {
        let context = self.home.path().join("contexts").join(ROBOT);
        let config = self.home.path().join("bridge.toml");
        let settings = format!(
            "context_dir = {context:?}\ndomain_id = {DOMAIN}\nshared_memory = false\n[[route]]\n\
             service = \"{ROBOT}/cmd_vel\"\ndirection = \"from_ledger\"\ntype = \"geometry_msgs/msg/Twist\"\n\
             command_timeout_ms = 0\n"
        );
        std::fs::write(&config, settings).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_ledgerd"));
        command.args(["bridge", "--config"]).arg(config).stdout(Stdio::null());
        let bridge = command.stderr(File::create(self.home.path().join("bridge.log")).unwrap()).spawn().unwrap();
        let topic = TopicName::parse("/cmd_vel").unwrap();
        let message = TypeName::parse("geometry_msgs/msg/Twist").unwrap();
        let robot = Participant::open(DOMAIN, "robot").await.unwrap();
        let reader = robot.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
        assert!(timeout(CONNECT_MAX, reader.matched().at_least(1)).await.expect("no bridge was discovered"));
        let owner = network.owner_at(0).await;
        let driver = network.connect(&network.founding().drivers[driver]).await;
        Stops { bridge, _home: self.home, owner, driver, reader }
    }
}

/// Somebody who drives, somebody who stops, and the robot that hears both.
pub(crate) struct Stops {
    bridge: Child,
    _home: TempDir,
    owner: Client,
    driver: Client,
    reader: Reader,
}

impl Drop for Stops {
    fn drop(&mut self) {
        let _gone = self.bridge.kill();
        let _status = self.bridge.wait();
    }
}

impl Stops {
    /// Stops the robot again and again, each time in the middle of a drive. Answers with the times until the call was committed,
    /// and until the robot heard it.
    pub(crate) async fn run(&mut self, duration: Duration) -> [Histogram<u64>; 2] {
        let (mut committed, mut heard, end) = (Vec::new(), Vec::new(), Instant::now() + duration);
        while heard.is_empty() || Instant::now() < end {
            self.owner.invoke("abac", "resume", vec![ROBOT.into()]).await.unwrap();
            let granted = self.driver.invoke("abac", "acquire", vec![ROBOT.into()]).await.unwrap();
            self.drive(&serde_json::from_slice(&granted.response).unwrap()).await;
            let called = Instant::now();
            let stop = async {
                self.owner.invoke("abac", "stop", vec![ROBOT.into()]).await.unwrap();
                called.elapsed()
            };
            let (stopped, at) = tokio::join!(stop, timeout(CONNECT_MAX, hears(&mut self.reader, true)));
            committed.push(stopped);
            heard.push(at.expect("the robot hears the stop") - called);
        }
        [committed, heard].map(|samples| histogram(samples.into_iter()))
    }

    /// Drives until the robot hears it.
    async fn drive(&mut self, grant: &Grant) {
        for seq in grant.next_seq.. {
            let args = [grant.service.clone(), grant.epoch.to_string(), seq.to_string()].map(Bytes::from);
            let args = args.into_iter().chain([twist()]).collect();
            match self.driver.invoke("abac", "set", args).await {
                Ok(_) => {}
                Err(refused) if refused.code == Code::Overloaded => continue,
                Err(refused) => panic!("{refused}"),
            }
            if timeout(ARRIVAL_MAX, hears(&mut self.reader, false)).await.is_ok() {
                return;
            }
        }
    }
}

/// When the robot hears the next stop message, or the next command.
async fn hears(reader: &mut Reader, stop: bool) -> Instant {
    loop {
        let incoming = reader.next().await.expect("DDS runs");
        if incoming.sample.body().iter().all(|byte| *byte == 0) == stop {
            return Instant::now();
        }
    }
}
