//! A bridge in the graph of a real ROS 2: `ros2`, rclpy and tf2 are the judges. rclpy is that of PyPI where no ROS 2 is sourced. A test
//! that needs more than that says there that it is skipped, and only what reads the output of `ros2` is tested.

mod said;

use std::{
    ffi::OsString,
    process::{Command, Output},
    time::Duration,
};
use testkit::own_network as network;

use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::{
    dds::{Participant, Reader, Writer},
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
};
use said::{Endpoint, endpoints, rate, under};
use testkit::python::{Python, source};
use testkit::rclpy::{self, in_domain};

const DEADLINE: Duration = Duration::from_secs(60);
const DOMAIN: u16 = 5;
const TWIST: &str = "geometry_msgs/msg/Twist";
const TWIST_HASH: &str = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";
const LATCHED: Qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 100);

/// Is a whole ROS 2 sourced? Otherwise it says why the test is skipped.
fn is_sourced() -> bool {
    let sourced = rclpy::is_sourced();
    if !sourced {
        println!("skipped: ROS_DISTRO is not set. Source the setup of a ROS 2 first: it runs this with ros2 and tf2");
    }
    sourced
}

/// The output of `ros2`. Warnings of endpoints without a hash of their type would stand on its standard error.
fn ros2(words: &[&str]) -> String {
    let mut command = Command::new("timeout");
    command.args(["60", "ros2"]).args(words);
    output(in_domain(command, DOMAIN), &format!("ros2 {words:?}"))
}

/// The output of a program that has nothing to complain about the bridge.
fn output(mut command: Command, what: &str) -> String {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let (said, complained) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "{what}: {status}\n{said}{complained}");
    assert!(!complained.contains("type hash"), "{complained}");
    said.into_owned()
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

#[tokio::test(flavor = "multi_thread")]
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
    let [Endpoint { node, role, type_hash, reliability }] = endpoints(&info).try_into().unwrap();
    assert_eq!(
        (&*node, &*role, &*type_hash, &*reliability),
        ("ledgerd_bridge", "PUBLISHER", TWIST_HASH, "RELIABLE"),
        "{info}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn rclpy_shows_the_bridge_like_any_node_and_complains_of_nothing() {
    if !rclpy::is_there() || !network::isolated(&|| ()) {
        return;
    }
    let _bridge = bridge().await;
    let graph = || output(rclpy::command("graph.py", DOMAIN, &["ledgerd_bridge", "/cmd_vel"]), "graph.py");
    let shown = tokio::task::spawn_blocking(graph).await.unwrap();
    let wanted = [
        "node ledgerd_bridge",
        "publishes /cmd_vel geometry_msgs/msg/Twist",
        "subscribes /driven geometry_msgs/msg/Twist",
        &format!("publisher ledgerd_bridge {TWIST_HASH} RELIABLE VOLATILE"),
    ];
    assert_eq!(shown.lines().collect::<Vec<_>>(), wanted);
}

#[tokio::test(flavor = "multi_thread")]
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
        let said = in_domain(command, DOMAIN).output().unwrap().stdout;
        let said = String::from_utf8_lossy(&said);
        assert!(rate(&said).is_some_and(|hertz| hertz > 0.0), "{said}");
    });
    heard.await.unwrap();
    publishing.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn rclpy_publishes_to_the_bridge_and_hears_it() {
    if !rclpy::is_there() || !network::isolated(&|| ()) {
        return;
    }
    let (_bridge, writer, mut reader) = bridge().await;
    let mut talker = rclpy::script("talker.py", DOMAIN, &["/driven", "50", "50"]);
    assert_eq!(talker.line().as_deref(), Some("matched"));
    for wanted in 0..50 {
        let incoming = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();
        assert_eq!(incoming.sample, twist(wanted));
    }
    let mut listener = rclpy::script("listener.py", DOMAIN, &["/cmd_vel", "50"]);
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

#[tokio::test(flavor = "multi_thread")]
async fn a_static_transform_passes_from_tf2_through_two_bridges_to_tf2() {
    if !is_sourced() || !network::isolated(&|| ()) {
        return;
    }
    let mut command = Command::new("ros2");
    command.args(["run", "tf2_ros", "static_transform_publisher", "--x", "1", "--y", "2", "--z", "3"]);
    command.args(["--frame-id", "map", "--child-frame-id", "base"]);
    let _publisher = Python::run(in_domain(command, DOMAIN));
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let (topic, message) = names("/tf_static", "tf2_msgs/msg/TFMessage");
    let mut reader = bridge.reader(&topic, &message, &LATCHED, Limits::default()).unwrap();
    let latched = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();

    // Another domain, as at the other end of a ledger: who comes late gets it.
    let other = Participant::open(DOMAIN + 1, "ledgerd_bridge").await.unwrap();
    let writer = other.writer(&topic, &message, &LATCHED).unwrap();
    writer.write(&latched.sample).unwrap();
    assert_eq!(rclpy::script("transform.py", DOMAIN + 1, &["map", "base"]).line().as_deref(), Some("1.0 2.0 3.0"));
}

/// Waits until the robot has heard the stop message three times since the last other message.
async fn stands(heard: &mut Reader) {
    let stopped = async {
        let mut stops = 0;
        while stops < 3 {
            let sample = heard.next().await.unwrap().sample;
            stops = if sample == twist(0) { stops + 1 } else { 0 };
        }
    };
    assert!(tokio::time::timeout(DEADLINE, stopped).await.is_ok(), "the robot is not stopped");
}

/// Publishes until the robot hears exactly this message.
async fn arrives(writer: &Writer, heard: &mut Reader, number: u32) {
    let mut due = tokio::time::interval(Duration::from_millis(20));
    let arrived = async {
        loop {
            due.tick().await;
            writer.write(&twist(number)).unwrap();
            while let Some(incoming) = heard.try_next() {
                if incoming.sample == twist(number) {
                    return;
                }
            }
        }
    };
    assert!(tokio::time::timeout(DEADLINE, arrived).await.is_ok(), "nothing is carried over");
}

/// The relay for a domain that SROS2 secures, as people run it; without security here.
#[tokio::test(flavor = "multi_thread")]
async fn the_relay_carries_a_topic_into_another_domain_and_stops_the_robot_while_not_exactly_one_publishes_it() {
    if !rclpy::is_there() || !network::isolated(&|| ()) {
        return;
    }
    let (bridge, writer, reader) = bridge().await;
    let topic = format!("/cmd_vel={TWIST}");
    let domains = [DOMAIN, DOMAIN + 1].map(|domain| domain.to_string());
    let args = [&domains[0], &domains[1], &topic].map(String::as_str);
    let mut relay = rclpy::script("../../examples/sros2/relay.py", DOMAIN, &args);
    assert_eq!(relay.line().as_deref(), Some("ready"));
    let robot = Participant::open(DOMAIN + 1, "robot").await.unwrap();
    let (topic, message) = names("/cmd_vel", TWIST);
    let mut heard = robot.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
    arrives(&writer, &mut heard, 7).await;

    // Somebody who only comes, and sends nothing.
    let stranger = Participant::open(DOMAIN, "stranger").await.unwrap();
    let other = stranger.writer(&topic, &message, &Qos::default()).unwrap();
    stands(&mut heard).await;
    // The bridge's reader does not count here: the relay and the stranger have to find each other.
    assert!(tokio::time::timeout(DEADLINE, other.matched().at_least(1)).await.unwrap());
    let mut due = tokio::time::interval(Duration::from_millis(20));
    for _ in 0..100 {
        due.tick().await;
        [&writer, &other].into_iter().for_each(|writer| writer.write(&twist(9)).unwrap());
        while let Some(incoming) = heard.try_next() {
            assert_eq!(incoming.sample, twist(0), "nothing is carried over but the stop");
        }
    }
    let more = stranger.writer(&topic, &message, &Qos::default()).unwrap();
    stands(&mut heard).await;

    drop((more, other, stranger));
    arrives(&writer, &mut heard, 8).await;
    drop((writer, reader, bridge));
    stands(&mut heard).await;
}

#[test]
fn a_ros_2_that_is_sourced_counts_before_the_one_that_the_tests_installed() {
    let installed = || Some(OsString::from("/installed/python"));
    assert_eq!(rclpy::interpreter(true, installed()), Some("python3".into()));
    assert_eq!(rclpy::interpreter(false, installed()), installed());
    assert_eq!((rclpy::interpreter(false, None), rclpy::interpreter(false, Some("".into()))), (None, None));
}

#[test]
fn the_scripts_for_a_real_ros_2_are_python() {
    for name in [
        "../../examples/sros2/relay.py",
        "action.py",
        "graph.py",
        "large.py",
        "listener.py",
        "service.py",
        "talker.py",
        "transform.py",
        "watchdog.py",
    ] {
        let check = "import ast, sys; ast.parse(open(sys.argv[1]).read())";
        let script = source(&format!("../ros/{name}"));
        assert!(Command::new("python3").args(["-c", check]).arg(script).status().unwrap().success(), "{name}");
    }
}
