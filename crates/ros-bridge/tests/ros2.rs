//! A bridge in the graph of a real ROS 2: `ros2`, rclpy and tf2 are the judges. Only where one is sourced; elsewhere each test
//! says that it is skipped, and only what reads the output of `ros2` is tested.
#![expect(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]

#[path = "../../../tests/support/own_network.rs"]
mod network;
#[path = "../../../tests/interop/python.rs"]
mod python;
#[path = "ros2/said.rs"]
mod said;

use std::{
    process::{Command, Output},
    time::Duration,
};

use ledger_gate::sample::{CDR_LE, Sample};
use python::{CYCLONE, Python, source};
use ros_bridge::{
    dds::{Participant, Reader, Writer},
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
};
use said::{Endpoint, endpoints, rate, under};

const DEADLINE: Duration = Duration::from_secs(60);
const DOMAIN: u16 = 5;
const TWIST: &str = "geometry_msgs/msg/Twist";
const LATCHED: Qos =
    Qos { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: 100, keyed: false };

/// Why there is no real ROS 2 here; none = there is one.
fn missing(distribution: Option<&str>) -> Option<String> {
    let sourced = distribution.is_some_and(|name| !name.is_empty());
    (!sourced).then(|| {
        "skipped: ROS_DISTRO is not set. Source the setup of a ROS 2 first: it runs this with ros2, rclpy and tf2"
            .to_owned()
    })
}

/// Is a real ROS 2 sourced? Otherwise it says why the test is skipped.
fn is_sourced() -> bool {
    let missing = missing(std::env::var("ROS_DISTRO").ok().as_deref());
    missing.iter().for_each(|reason| println!("{reason}"));
    missing.is_none()
}

/// The same network and domain for programs of ROS 2, whichever RMW they have.
fn in_our_graph(mut command: Command) -> Command {
    command.env("ROS_DOMAIN_ID", DOMAIN.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command.env("CYCLONEDDS_URI", CYCLONE);
    command
}

/// The output of `ros2`. Warnings of endpoints without a hash of their type would stand on its standard error.
fn ros2(words: &[&str]) -> String {
    let mut command = Command::new("timeout");
    command.args(["60", "ros2"]).args(words);
    let Output { status, stdout, stderr } = in_our_graph(command).output().unwrap();
    let (said, complained) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "ros2 {words:?}: {status}\n{said}{complained}");
    assert!(!complained.contains("type hash"), "{complained}");
    said.into_owned()
}

/// A script of tests/ros, with the Python of ROS 2.
fn script(name: &str, args: &[&str]) -> Python {
    let mut command = Command::new("python3");
    command.arg(source(&format!("../ros/{name}"))).args(args);
    Python::run(in_our_graph(command))
}

fn names(topic: &str, message: &str) -> (TopicName, TypeName) {
    (TopicName::parse(topic).unwrap(), TypeName::parse(message).unwrap())
}

fn twist(number: u32) -> Sample {
    let body: Vec<u8> = [f64::from(number), 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().flat_map(f64::to_le_bytes).collect();
    Sample::new(CDR_LE, &body).unwrap()
}

/// A bridge that publishes /cmd_vel and subscribes to /driven.
async fn bridge() -> (Participant, Writer, Reader) {
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let ((published, message), (read, _)) = (names("/cmd_vel", TWIST), names("/driven", TWIST));
    let writer = bridge.writer(&published, &message, &Qos::default()).unwrap();
    let reader = bridge.reader(&read, &message, &Qos::default(), Limits::default()).unwrap();
    (bridge, writer, reader)
}

#[tokio::test]
async fn ros2_node_and_topic_show_the_bridge_like_any_node() {
    if !is_sourced() || !network::isolated(&|| ()) {
        return;
    }
    let _bridge = bridge().await;
    let direct = ["--no-daemon", "--spin-time", "5"];
    let nodes = ros2(&[["node", "list"].as_slice(), &direct].concat());
    assert!(nodes.lines().any(|line| line == "/ledgerd_bridge"), "{nodes}");
    let node = ros2(&[["node", "info", "/ledgerd_bridge"].as_slice(), &direct].concat());
    assert!(under(&node, "Publishers:").any(|line| line == "/cmd_vel: geometry_msgs/msg/Twist"), "{node}");
    assert!(under(&node, "Subscribers:").any(|line| line == "/driven: geometry_msgs/msg/Twist"), "{node}");
    let topics = ros2(&[["topic", "list", "-t"].as_slice(), &direct].concat());
    assert!(topics.lines().any(|line| line == "/cmd_vel [geometry_msgs/msg/Twist]"), "{topics}");
    let info = ros2(&[["topic", "info", "-v", "/cmd_vel"].as_slice(), &direct].concat());
    let hash = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";
    let [Endpoint { node, role, type_hash, reliability }] = endpoints(&info).try_into().unwrap();
    assert_eq!(
        (&*node, &*role, &*type_hash, &*reliability),
        ("ledgerd_bridge", "PUBLISHER", hash, "RELIABLE"),
        "{info}"
    );
}

#[tokio::test]
async fn ros2_topic_echo_and_hz_hear_the_bridge() {
    if !is_sourced() || !network::isolated(&|| ()) {
        return;
    }
    let (_bridge, writer, _reader) = bridge().await;
    let publishing = tokio::spawn(async move {
        let mut due = tokio::time::interval(Duration::from_millis(20));
        loop {
            due.tick().await;
            writer.write(&twist(7)).unwrap();
        }
    });
    let heard = tokio::task::spawn_blocking(|| {
        let echo = ros2(&["topic", "echo", "--once", "/cmd_vel", TWIST]);
        assert!(under(&echo, "linear:").any(|line| line == "x: 7.0"), "{echo}");
        // It has no end of its own.
        let mut command = Command::new("timeout");
        command.args(["-s", "INT", "15", "ros2", "topic", "hz", "/cmd_vel"]).env("PYTHONUNBUFFERED", "1");
        let said = in_our_graph(command).output().unwrap().stdout;
        let said = String::from_utf8_lossy(&said);
        assert!(rate(&said).is_some_and(|hertz| hertz > 0.0), "{said}");
    });
    heard.await.unwrap();
    publishing.abort();
}

#[tokio::test]
async fn rclpy_publishes_to_the_bridge_and_hears_it() {
    if !is_sourced() || !network::isolated(&|| ()) {
        return;
    }
    let (_bridge, writer, mut reader) = bridge().await;
    let mut talker = script("talker.py", &["/driven", "50", "50"]);
    assert_eq!(talker.line().as_deref(), Some("matched"));
    for wanted in 0..50 {
        let incoming = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();
        assert_eq!(incoming.sample, twist(wanted));
    }
    let mut listener = script("listener.py", &["/cmd_vel", "50"]);
    assert_eq!(listener.line().as_deref(), Some("ready"));
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
    let mut due = tokio::time::interval(Duration::from_millis(20));
    for number in 0..50 {
        due.tick().await;
        writer.write(&twist(number)).unwrap();
    }
    for wanted in 0..50 {
        assert_eq!(listener.line().unwrap(), wanted.to_string());
    }
    assert!(listener.finish());
}

#[tokio::test]
async fn a_static_transform_passes_from_tf2_through_two_bridges_to_tf2() {
    if !is_sourced() || !network::isolated(&|| ()) {
        return;
    }
    let mut command = Command::new("ros2");
    command.args(["run", "tf2_ros", "static_transform_publisher", "--x", "1", "--y", "2", "--z", "3"]);
    command.args(["--frame-id", "map", "--child-frame-id", "base"]);
    let _publisher = Python::run(in_our_graph(command));
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let (topic, message) = names("/tf_static", "tf2_msgs/msg/TFMessage");
    let mut reader = bridge.reader(&topic, &message, &LATCHED, Limits::default()).unwrap();
    let latched = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();

    // Another domain, as at the other end of a ledger: who comes late gets it.
    let other = Participant::open(DOMAIN + 1, "ledgerd_bridge").await.unwrap();
    let writer = other.writer(&topic, &message, &LATCHED).unwrap();
    writer.write(&latched.sample).unwrap();
    let mut command = Command::new("python3");
    command.arg(source("../ros/transform.py")).args(["map", "base"]);
    let mut command = in_our_graph(command);
    command.env("ROS_DOMAIN_ID", (DOMAIN + 1).to_string());
    assert_eq!(Python::run(command).line().as_deref(), Some("1.0 2.0 3.0"));
}

#[test]
fn without_a_real_ros_2_these_tests_say_that_they_are_skipped_and_why() {
    for none in [None, Some("")] {
        let reason = missing(none).unwrap();
        assert!(reason.starts_with("skipped: ROS_DISTRO is not set"), "{reason}");
    }
    assert_eq!(missing(Some("jazzy")), None);
}

#[test]
fn the_scripts_for_a_real_ros_2_are_python() {
    for name in ["talker.py", "listener.py", "transform.py"] {
        let check = "import ast, sys; ast.parse(open(sys.argv[1]).read())";
        let script = source(&format!("../ros/{name}"));
        assert!(Command::new("python3").args(["-c", check]).arg(script).status().unwrap().success(), "{name}");
    }
}
