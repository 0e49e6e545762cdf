//! A publisher beside the bridge on the robot's own topic goes around the ledger: it is seen, and everybody can see so on the
//! ledger. CycloneDDS and Fast DDS are the robot and the one beside.

use crate::peer::{PEERS, Peer, number};
use crate::support::programs;
use crate::world::{self, World};
use crate::{call, network};
use ledger_abac::{RobotAsset, SideDoor};
use ledger_api::{Client, Subscription};
use ledger_base::rejection::Code;
use ledger_gate::sample::Sample;
use ros_bridge::{names::TopicName, shm};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const TYPE: &str = "geometry_msgs/msg/Twist";
const TOPIC: &str = "rt/cmd_vel";

/// The next report of a side door on the ledger, as this client hears it.
async fn reported(world: &World, client: &Client, from_height: u64) -> SideDoor {
    let mut events = client.subscribe(Subscription {
        from_height,
        chaincode: "abac".into(),
        subjects: vec!["Rover/cmd_vel".into()],
        names: vec!["side_door".into()],
        ..Subscription::default()
    });
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let delivery = tokio::time::timeout(deadline.saturating_duration_since(Instant::now()), events.next()).await;
        let delivery = delivery.unwrap_or_else(|_| panic!("nobody reports\n{}", world.logs())).unwrap();
        if let Some(event) = delivery.events.first() {
            return serde_json::from_slice(&event.payload).unwrap();
        }
    }
}

/// The report that any member sees at the robot.
async fn shown(client: &Client) -> Option<SideDoor> {
    let answer = client.query("abac", "robot", vec!["Rover".into()]).await.unwrap();
    let robot: RobotAsset = serde_json::from_slice(&answer.response).unwrap();
    robot.services.into_iter().next().unwrap().side_door
}

async fn is_reported(rogue: Peer, robot: Peer) {
    let world = World::start("/cmd_vel", TYPE).await;
    let _bridge = world.start_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
    let mut robot = robot.subscribes(3, TOPIC, (0, 0), &[]);
    assert_eq!((robot.line().as_deref(), robot.line().as_deref()), (Some("ready"), Some("matched")));
    assert_eq!(shown(&world.farhad).await, None);
    let height = world.farhad.status().await.unwrap().height;

    let _rogue = rogue.publishes(3, TOPIC, (100_000, 50, 0), &[]);
    assert!(number(&mut robot).is_some(), "the robot obeys the stranger");
    world.line("Rover", &["WARN", "a publisher beside this bridge on /cmd_vel", "go around the ledger"]).await;
    let report = reported(&world, &world.farhad, height + 1).await;
    assert_eq!((report.topic.as_str(), report.publishers, report.by.as_str()), ("/cmd_vel", 1, "Org2/Rover"));
    world.line("Rover", &["the ledger was told that 1 publish beside this bridge"]).await;
    assert_eq!(shown(&world.salma).await.as_ref(), Some(&report), "it stays, for those who look later");
    let mut command = Command::new(programs::ledgerctl());
    command.args(["--context", "dev-org2-admin", "robot", "show", "Rover"]).env("LEDGERD_HOME", world.path("home"));
    let told = String::from_utf8(command.output().unwrap().stdout).unwrap();
    assert!(told.contains("rogue publishers  1 on /cmd_vel, reported by Org2/Rover at "), "{told}");

    // Others cannot make one up, nor say that it is closed.
    let args = ["Rover/cmd_vel", "/cmd_vel", "0"].map(|arg| arg.to_owned().into());
    let refused = world.farhad.invoke("abac", "report_side_door", args.into()).await.unwrap_err();
    assert_eq!(refused.code, Code::NotOwner);
}

#[test]
fn a_stranger_on_the_robots_topic_is_reported_to_the_ledger_and_shown_to_all_members() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        for (rogue, robot) in PEERS.into_iter().zip(PEERS.into_iter().rev()) {
            is_reported(rogue, robot).await;
        }
    });
}

/// Tells the process below which topic to publish on.
const CHILD_TOPIC: &str = "LEDGERD_TEST_SIDE_DOOR";
/// Shared memory has no namespaces: a domain that no other test has.
const SHARED_DOMAIN: u16 = 203;

/// Not a test of its own: a stranger in shared memory.
#[test]
fn child_publishes_in_shared_memory_until_it_is_killed() {
    let Ok(topic) = std::env::var(CHILD_TOPIC) else { return };
    world::run(async {
        let stranger = shm::Node::open(SHARED_DOMAIN, "stranger", [3; 16]).await.unwrap();
        let publisher = stranger.publisher(&TopicName::parse(&topic).unwrap()).await.unwrap();
        let sample = Sample::new([0, 1], &[7; 48]).unwrap();
        loop {
            publisher.write(&sample).unwrap();
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
}

#[test]
fn a_stranger_in_shared_memory_is_reported_to_the_ledger_too() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let topic = format!("/cmd_vel{}", std::process::id());
        let world = World::start(&topic, TYPE).await;
        let _bridge = world.start_shared_memory_bridge("Rover", SHARED_DOMAIN, "from_ledger", &topic, TYPE);
        world.line("Rover", &["route 1: "]).await;
        assert!(world.has_not_said("Rover", "beside this bridge"));
        let mut child = Command::new(std::env::current_exe().unwrap());
        child.args(["--exact", "side_door::child_publishes_in_shared_memory_until_it_is_killed"]);
        let stranger = world::Process::new(child.env(CHILD_TOPIC, &topic).stdout(Stdio::null()).spawn().unwrap());
        let pid = format!("process={}", stranger.id());
        world.line("Rover", &["WARN", "beside this bridge on /cmd_vel", "in shared memory", &pid]).await;
        world.line("Rover", &["the ledger was told that 1 publish beside this bridge"]).await;
        assert_eq!(shown(&world.farhad).await.unwrap().publishers, 1);
    });
}

#[test]
fn a_bridge_that_may_not_report_a_side_door_says_so_and_how_it_may() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        // Anybody may bring a robot's commands into a graph, who may read them. That does not make them the robot.
        let _bridge = world.start_bridge("Farhad", 3, "from_ledger", "/cmd_vel", TYPE);
        let _robot = Peer::Cyclone.subscribes(3, TOPIC, (0, 0), &[]);
        let _rogue = Peer::Fast.publishes(3, TOPIC, (100_000, 50, 0), &[]);
        world
            .line("Farhad", &["WARN", "the ledger takes no report of a side door from this bridge", "NOT_OWNER"])
            .await;
        call(&world.salma, "acquire", &["Rover/cmd_vel"]).await;
        assert_eq!(shown(&world.salma).await, None);
    });
}

#[test]
fn a_killed_bridge_leaves_the_graphs_of_cyclonedds_and_fast_dds_within_seconds() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        for peer in PEERS {
            let bridge = world.start_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
            let mut robot = peer.subscribes(3, TOPIC, (0, 0), &["until_left"]);
            assert_eq!((robot.line().as_deref(), robot.line().as_deref()), (Some("ready"), Some("matched")));
            let killed = Instant::now();
            drop(bridge);
            // What was said before may still come.
            while robot.line().unwrap_or_else(|| panic!("it never leaves the graph of {peer:?}")) != "left" {}
            // RustDDS alone takes 50 s.
            assert!(killed.elapsed() < Duration::from_secs(40), "{peer:?}: {:?}", killed.elapsed());
            assert!(robot.finish());
        }
    });
}
