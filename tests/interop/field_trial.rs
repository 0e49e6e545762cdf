//! Settings of ROS 2 in which a node cannot exchange messages with a bridge: the log and the diagnostics name them.

use crate::world::{self, World};
use crate::{network, python, rclpy};
use ros_bridge::dds::Participant;
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use ros_message::Library;
use std::process::Command;
use std::time::Duration;

const TYPE: &str = "geometry_msgs/msg/Twist";
const DIAGNOSTICS: &str = "diagnostic_msgs/msg/DiagnosticArray";

fn rover(world: &World, environment: &[(&str, &str)]) -> world::Process {
    let settings = format!(
        "domain_id = 3\nshared_memory = false\n[[route]]\nservice = 'Rover/cmd_vel'\ndirection = 'from_ledger'\ntype = '{TYPE}'\n"
    );
    world.start_bridge_as("Rover", &settings, environment)
}

/// Waits for a message on `/diagnostics` with all these words.
async fn diagnosed(words: &[&str]) {
    let graph = Participant::open(3, "watcher").await.unwrap();
    let (topic, message) = (TopicName::parse("/diagnostics").unwrap(), TypeName::parse(DIAGNOSTICS).unwrap());
    let mut reader = graph.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
    let array = Library::builtin().message(DIAGNOSTICS).unwrap();
    let comes = async {
        loop {
            let yaml = array.decode(reader.next().await.unwrap().sample.wire()).unwrap().to_yaml(None);
            if words.iter().all(|word| yaml.contains(word)) {
                return;
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(60), comes).await.expect("the diagnostics name it");
}

/// Fast DDS with LARGE_DATA announces itself by UDP, and takes everything else by TCP and shared memory: its endpoints are never seen.
#[test]
fn a_robot_of_fast_dds_without_udp_for_samples_is_an_error_in_the_diagnostics() {
    if !rclpy::is_there() || !network::isolated(&|| ()) {
        return;
    }
    // It announces itself by multicast alone.
    for words in [["link", "set", "lo", "multicast", "on"], ["route", "add", "239.0.0.0/8", "dev", "lo"]] {
        assert!(Command::new("ip").args(words).status().unwrap().success(), "{words:?}");
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let _rover = rover(&world, &[]);
        world.line("Rover", &["is ready"]).await;
        let mut robot = rclpy::command("listener.py", 3, &["/cmd_vel", "1"]);
        robot.env("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA").env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
        let _robot = python::Python::run(robot);
        world.line("Rover", &["WARN", "a participant cannot be reached", "UDP over IPv4"]).await;
        diagnosed(&["1 participant(s), the first on ", "FASTDDS_BUILTIN_TRANSPORTS=DEFAULT", "level: 2"]).await;
    });
}

#[test]
fn variables_that_hide_nodes_from_a_bridge_are_warned_of_once() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let hidden = [("ROS_DISCOVERY_SERVER", "127.0.0.1:11811"), ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")];
        let _rover = rover(&world, &hidden);
        world.line("Rover", &["is ready"]).await;
        for (variable, value) in hidden {
            let wanted = format!("{variable}={value}: ");
            world.line("Rover", &["WARN", &wanted, "remedy="]).await;
            assert_eq!(world.logs().matches(&wanted).count(), 1, "{}", world.logs());
        }
    });
}
