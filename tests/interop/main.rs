//! The whole path, with software that we did not write at both ends: Python processes with CycloneDDS publish and
//! receive, `ledgerd` carries the messages through a real ledger.
#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "tests"
)]

mod actions;
mod arena;
mod calls;
mod codec;
mod confidential;
mod console;
mod demo;
mod discovering;
mod field_trial;
mod keyed;
mod latched;
mod liar;
mod loops;
mod lost_graph;
mod nodes_die;
mod pages;
mod parameters;
mod passing;
mod readers;
mod real_ros;
mod recording;
mod reloading;
mod robot_stands;
mod sharing;
mod side_door;
mod sros2;
mod stop_early;
mod tasks;
mod telling;
mod traces;
mod watchdog;
mod watched;
mod world;

use ledgerd_support as support;
use testkit::{own_network as network, peer, python, rclpy};

use ledger_api::Client;
use python::Python;
use std::time::{Duration, Instant};
use support::programs;
use world::World;

/// A zero Twist: what the robot's bridge publishes when a grant ends.
fn stop_message() -> String {
    format!("00010000{}", "00".repeat(48))
}

/// The next message that is no stop. On a busy machine a publisher may pause for so long that the robot is stopped in between.
pub(crate) fn command(robot: &mut Python) -> Option<String> {
    loop {
        let line = robot.line()?;
        if line != stop_message() {
            return Some(line);
        }
    }
}

/// How many commands of a user's route have ended on their way. A machine that stands still makes them too old.
pub(crate) fn expired(route: &serde_json::Value) -> u64 {
    route["refused"]["EXPIRED"].as_u64().unwrap_or(0)
}

/// Hears what was sent, in its order. Answers how many messages did not come.
fn lost(world: &World, robot: &mut Python, sent: &[String]) -> u64 {
    let (mut coming, mut lost) = (sent.iter(), 0);
    while !coming.as_slice().is_empty() {
        // Silence: what is left does not come.
        let Some(received) = robot.line() else { break };
        let between = coming.position(|message| *message == received);
        lost += between.unwrap_or_else(|| panic!("a message was not sent, or came out of its turn\n{}", world.logs()));
    }
    (lost + coming.len()) as u64
}

/// Applies a set of one policy, or of none, also if nobody may publish to some robot then.
pub(crate) async fn apply(client: &Client, policies: &[(&str, &str)]) {
    let policies: Vec<_> = policies.iter().map(|(id, text)| serde_json::json!({ "id": id, "text": text })).collect();
    let set = serde_json::json!({ "policies": policies, "means_it": true }).to_string();
    call(client, "policy", &["apply", &set]).await;
}

pub(crate) async fn call(client: &Client, function: &str, args: &[&str]) {
    let args = args.iter().map(|arg| (*arg).to_owned().into()).collect();
    client.invoke("abac", function, args).await.unwrap();
}

/// Publishes `count` messages of `size` on the operator's side and expects exactly them on the robot's. Answers how many did
/// not come: as many as have expired.
async fn drive(world: &World, topic: &str, (count, rate, size): (usize, usize, usize), intruder: bool) -> u64 {
    let dds_topic = format!("rt{topic}");
    let robot_args = ["3", &dds_topic, &count.to_string(), "0", &size.to_string(), "60"].map(str::to_owned);
    let mut robot = Python::start("twist_subscriber.py", &robot_args.each_ref().map(String::as_str));
    assert_eq!(robot.line().unwrap(), "ready");
    assert_eq!(robot.line().unwrap(), "matched", "the robot's bridge is there");
    // Nobody acquired anything for Farhad, whose messages are numbered differently.
    let farhad = intruder.then(|| {
        let args =
            ["2", &dds_topic, &count.to_string(), &rate.to_string(), &size.to_string(), "1000"].map(str::to_owned);
        Python::start("twist_publisher.py", &args.each_ref().map(String::as_str))
    });
    let args = ["1", &dds_topic, &count.to_string(), &rate.to_string(), &size.to_string()].map(str::to_owned);
    let mut salma = Python::start("twist_publisher.py", &args.each_ref().map(String::as_str));
    assert_eq!(salma.line().unwrap(), "matched");
    let line = |number: usize| salma.line().unwrap_or_else(|| panic!("the publisher ended before message {number}"));
    let sent: Vec<_> = (0..count).map(line).collect();
    assert!(salma.finish(), "every message was acknowledged on Salma's side");
    let missing = lost(world, &mut robot, &sent);
    assert!(missing > 0 || robot.finish(), "the robot received exactly {count} messages");
    if let Some(farhad) = farhad {
        assert!(farhad.finish());
    }
    missing
}

#[test]
fn salma_drives_the_robot_and_farhad_does_not() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let bridges = world.start_bridges("/cmd_vel", "geometry_msgs/msg/Twist");
        let (mut sent, mut missing) = (150_u64, drive(&world, "/cmd_vel", (150, 50, 0), true).await);

        // When the holder lets go, the robot is told to stop; then the next holder drives.
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "2", "0", "0", "240"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        loop {
            let mut salma = Python::start("twist_publisher.py", &["1", "rt/cmd_vel", "1", "50", "0", "1000"]);
            assert_eq!(salma.line().unwrap(), "matched");
            let message = salma.line().unwrap();
            assert!(salma.finish());
            sent += 1;
            match lost(&world, &mut robot, &[message]) {
                0 => break,
                more => missing += more,
            }
        }
        call(&world.salma, "release", &["Rover/cmd_vel"]).await;
        assert_eq!(robot.line().unwrap(), stop_message());
        assert!(robot.finish());

        let reports = bridges.stop();
        let [salma, farhad, robot] = reports.each_ref().map(|report| &report["routes"][0]);
        assert_eq!((expired(salma), &salma["committed"]), (missing, &(sent - missing).into()), "{salma}");
        assert_eq!(farhad["committed"], 0, "{farhad}");
        assert_eq!(farhad["refused"]["NOT_HOLDER"].as_u64().unwrap() + expired(farhad), 150, "{farhad}");
        assert_eq!(robot["published"].as_u64().unwrap(), sent - missing, "{robot}");
        assert_eq!(robot["stops"]["released"], 1, "{robot}");
    });
}

#[test]
fn a_300_kb_message_passes() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/image", "sensor_msgs/msg/Image").await;
        call(&world.salma, "acquire", &["Rover/image", "60000"]).await;
        let bridges = world.start_bridges("/image", "sensor_msgs/msg/Image");
        let missing = drive(&world, "/image", (10, 5, 300_000), false).await;
        assert_eq!(expired(&bridges.stop()[0]["routes"][0]), missing);
    });
}

#[test]
fn a_message_of_4_mb_passes_whole() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/image", "sensor_msgs/msg/Image").await;
        call(&world.salma, "acquire", &["Rover/image", "60000"]).await;
        let bridges = world.start_bridges("/image", "sensor_msgs/msg/Image");
        let missing = drive(&world, "/image", (5, 1, 4_000_000), false).await;
        assert_eq!(expired(&bridges.stop()[0]["routes"][0]), missing);
    });
}

#[test]
fn local_processes_reach_the_robot_through_shared_memory() {
    use ledger_gate::sample::Sample;
    use ros_bridge::{names::TopicName, queue::Limits, shm};
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
        // Shared memory has no namespaces, so these domains are this test's own.
        let _bridges = [("Salma", 201, "to_ledger"), ("Rover", 202, "from_ledger")].map(|(name, domain, way)| {
            world.start_shared_memory_bridge(name, domain, way, "/cmd_vel", "geometry_msgs/msg/Twist")
        });
        let topic = TopicName::parse("/cmd_vel").unwrap();
        let (operator, robot) = (
            shm::Node::open(201, "operator", [7; 16]).await.unwrap(),
            shm::Node::open(202, "robot", [8; 16]).await.unwrap(),
        );
        let publisher = operator.publisher(&topic).await.unwrap();
        let mut subscriber = robot.subscriber(&topic, Limits::default()).await.unwrap();
        let deadline = Instant::now() + Duration::from_secs(30);
        while publisher.subscribers() == 0 || subscriber.publishers() == 0 {
            assert!(Instant::now() < deadline, "the bridges are not there\n{}", world.logs());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let speeds = |number: u8| [f64::from(number); 6].map(f64::to_le_bytes).concat();
        // A gate passes nothing from before it knew the holder, so the first messages may be dropped.
        let mut first = 100;
        'begun: loop {
            let sample = Sample::new([0, 1], &speeds(first)).unwrap();
            publisher.write(&sample).unwrap();
            while let Ok(received) = tokio::time::timeout(Duration::from_secs(1), subscriber.next()).await {
                if received.unwrap().sample == sample {
                    break 'begun;
                }
            }
            assert!(Instant::now() < deadline, "nothing arrives\n{}", world.logs());
            first += 1;
        }
        for number in 0..50u8 {
            let sample = Sample::new([0, 1], &speeds(number)).unwrap();
            publisher.write(&sample).unwrap();
            let received = tokio::time::timeout(Duration::from_secs(20), subscriber.next()).await;
            assert_eq!(received.unwrap_or_else(|_| panic!("{number}\n{}", world.logs())).unwrap().sample, sample);
        }
        assert!(subscriber.try_next().is_none(), "each message comes once, though DDS and shared memory carry it");
    });
}

#[test]
fn a_route_of_the_wrong_type_is_refused_with_both_types() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let refused = world.bridge_fails("Salma", "/cmd_vel", "geometry_msgs/msg/TwistStamped");
        assert!(refused.contains("LGR-3012"), "{refused}");
        assert!(
            refused.contains("geometry_msgs/msg/TwistStamped") && refused.contains("geometry_msgs/msg/Twist"),
            "{refused}"
        );
    });
}

#[test]
fn a_bridge_inside_the_robots_node_does_the_same() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start_with_inner_bridge("/cmd_vel", "geometry_msgs/msg/Twist").await;
        call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
        let bridge = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", "geometry_msgs/msg/Twist");
        let missing = drive(&world, "/cmd_vel", (50, 50, 0), false).await;
        assert_eq!(expired(&bridge.report()["routes"][0]), missing);
    });
}

#[test]
fn a_holder_who_is_killed_leaves_the_robot_stopped_and_free() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let bridge = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", "geometry_msgs/msg/Twist");
        let _rover = world.start_default_bridge("Rover", 3, "from_ledger", "/cmd_vel", "geometry_msgs/msg/Twist");
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "0", "0", "0", "60"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
        // Long enough for a publisher to start on a busy machine, short enough to be waited for.
        call(&world.salma, "acquire", &["Rover/cmd_vel", "20000"]).await;
        world.line("Salma", &["grant held"]).await;
        let salma = Python::start("twist_publisher.py", &["1", "rt/cmd_vel", "3000", "50", "0", "1"]);
        for number in 0..50 {
            assert!(command(&mut robot).is_some(), "message {number}");
        }
        drop(salma);
        drop(bridge);
        // Nothing more comes: the robot is told to stop. Nobody renews the lease: it runs out in block time.
        while robot.line().unwrap() != stop_message() {}
        let acquired = async {
            while world.farhad.invoke("abac", "acquire", vec!["Rover/cmd_vel".into()]).await.is_err() {
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), acquired).await.unwrap();
    });
}
