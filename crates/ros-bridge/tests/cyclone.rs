//! The other side is CycloneDDS, the DDS of `rmw_cyclonedds`, in Python.

use std::{
    process::Command,
    time::{Duration, Instant},
};
use testkit::own_network as network;

use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::{
    dds::Participant,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::Limits,
    reach::{Range, Reach},
};
use testkit::python::Python;

const DEADLINE: Duration = Duration::from_secs(30);

fn names(topic: &str, message: &str) -> (TopicName, TypeName) {
    (TopicName::parse(topic).unwrap(), TypeName::parse(message).unwrap())
}

/// The same values as `message()` in messages.py.
fn twist(index: u32) -> Sample {
    let value = f64::from(index);
    let numbers = [value, value + 0.25, -value, value * 0.5, 0.0, value / 3.0];
    let body: Vec<u8> = numbers.into_iter().flat_map(f64::to_le_bytes).collect();
    Sample::new(CDR_LE, &body).unwrap()
}

/// sensor_msgs/msg/Image with `size` bytes of data, the same as in messages.py.
fn image(index: u32, size: u32) -> Sample {
    let mut body = Vec::new();
    let number = |body: &mut Vec<u8>, number: u32| {
        body.resize(body.len().next_multiple_of(4), 0);
        body.extend(number.to_le_bytes());
    };
    let text = |body: &mut Vec<u8>, text: &str| {
        number(body, u32::try_from(text.len()).unwrap() + 1);
        body.extend(text.bytes().chain([0]));
    };
    number(&mut body, index);
    number(&mut body, index + 1);
    text(&mut body, "camera");
    number(&mut body, 1);
    number(&mut body, size);
    text(&mut body, "mono8");
    body.push(0);
    number(&mut body, size);
    number(&mut body, size);
    body.extend((0..size).map(|at| u8::try_from((index + at) % 251).unwrap()));
    body.resize(body.len().next_multiple_of(4), 0);
    Sample::new(CDR_LE, &body).unwrap()
}

/// Publishes from Python and compares what arrives here with what the script says that it sent.
async fn from_python(topic: &str, message: &str, count: usize, rate: usize, size: usize) {
    let (topic, message) = names(topic, message);
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let mut reader = bridge.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
    let args = ["5".to_owned(), topic.dds(), count.to_string(), rate.to_string(), size.to_string()];
    let mut python = Python::start("twist_publisher.py", &args.each_ref().map(String::as_str));
    let mut received = Vec::new();
    while received.len() < count {
        received.push(tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap());
    }
    assert_eq!(python.line().unwrap(), "matched");
    for (index, incoming) in received.iter().enumerate() {
        assert_eq!(hex_of(&incoming.sample), python.line().unwrap(), "message {index}");
        assert_eq!(incoming.sequence, index as u64 + 1);
    }
    assert!(python.finish());
    assert_eq!(reader.dropped(), 0);
}

/// Publishes from here; Python prints what it received, with the header as it came.
async fn to_python(topic: &str, message: &str, samples: &[Sample], period: Duration, size: usize) {
    let (topic, message) = names(topic, message);
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let writer = bridge.writer(&topic, &message, &Qos::default()).unwrap();
    let args = ["5".to_owned(), topic.dds(), samples.len().to_string(), "0".to_owned(), size.to_string()];
    let mut python = Python::start("twist_subscriber.py", &args.each_ref().map(String::as_str));
    assert_eq!(python.line().unwrap(), "ready");
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
    assert_eq!(python.line().unwrap(), "matched");
    let start = Instant::now();
    for (index, sample) in samples.iter().enumerate() {
        tokio::time::sleep_until((start + period * u32::try_from(index).unwrap()).into()).await;
        writer.write(sample).unwrap();
    }
    assert!(writer.flush(DEADLINE).await);
    for (index, sample) in samples.iter().enumerate() {
        assert_eq!(python.line().unwrap(), hex_of(sample), "message {index}");
    }
    assert!(python.finish());
}

fn hex_of(sample: &Sample) -> String {
    sample.wire().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn twists_come_from_cyclone_at_50_hz_and_none_is_lost() {
    if network::isolated(&|| ()) {
        from_python("/cmd_vel", "geometry_msgs/msg/Twist", 150, 50, 0).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn twists_go_to_cyclone_at_50_hz_and_none_is_lost() {
    if network::isolated(&|| ()) {
        let samples: Vec<Sample> = (0..150).map(twist).collect();
        to_python("/cmd_vel", "geometry_msgs/msg/Twist", &samples, Duration::from_millis(20), 0).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn large_images_come_from_cyclone() {
    if network::isolated(&|| ()) {
        from_python("/image", "sensor_msgs/msg/Image", 5, 10, 300_000).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn large_images_go_to_cyclone() {
    if network::isolated(&|| ()) {
        let samples: Vec<Sample> = (0..5).map(|index| image(index, 300_000)).collect();
        to_python("/image", "sensor_msgs/msg/Image", &samples, Duration::from_millis(100), 300_000).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_in_xcdr2_pass_from_cyclone_to_cyclone() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    for (kind, id) in [("Final", 7), ("Appendable", 9), ("Mutable", 11)] {
        let (from, message) = names(&format!("/from/{kind}"), &format!("test_msgs/msg/{kind}"));
        let (to, _) = names(&format!("/to/{kind}"), "test_msgs/msg/Any");
        let mut reader = bridge.reader(&from, &message, &Qos::default(), Limits::default()).unwrap();
        let writer = bridge.writer(&to, &message, &Qos::default()).unwrap();
        // The first sample of an encoding opens its writer, and is lost until somebody reads that.
        let mut python = Python::start("xcdr2.py", &["5", kind]);
        // The script ends when it has all its texts back, and sends until then.
        while python.child.try_wait().unwrap().is_none() {
            let next = tokio::time::timeout(Duration::from_millis(100), reader.next()).await;
            let Ok(incoming) = next.map(Option::unwrap) else { continue };
            assert_eq!(incoming.sample.representation_id(), [0, id], "{kind}");
            writer.write(&incoming.sample).unwrap();
        }
        assert!(python.finish(), "{kind}: what came back was not what was sent");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ros_tools_see_one_node_with_its_endpoints() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names("/cmd_vel", "geometry_msgs/msg/Twist");
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let mut python = Python::start("graph_watcher.py", &["5"]);
    assert!(until(&mut python, "/ ledgerd_bridge 0 0"), "a node without endpoints, to who comes late as well");
    let reader = bridge.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
    let writer = bridge.writer(&topic, &message, &Qos::default()).unwrap();
    assert!(until(&mut python, "/ ledgerd_bridge 1 1"));
    drop(reader);
    assert!(until(&mut python, "/ ledgerd_bridge 0 1"));
    drop(writer);
    assert!(until(&mut python, "/ ledgerd_bridge 0 0"));
}

#[tokio::test(flavor = "multi_thread")]
async fn endpoints_announce_the_hash_of_their_type() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names("/cmd_vel", "geometry_msgs/msg/Twist");
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let _reader = bridge.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
    let writer = bridge.writer(&topic, &message, &Qos::default()).unwrap();
    writer.write(&twist(1)).unwrap();
    let mut python = Python::start("hash_watcher.py", &["5"]);
    // As `ros2 topic info -v /cmd_vel` shows it in Jazzy.
    let hash = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";
    for role in ["publisher", "subscriber"] {
        assert!(until(&mut python, &format!("{role} rt/cmd_vel typehash={hash};")), "{role}");
    }
}

/// Whether a line comes before the script ends.
fn until(python: &mut Python, wanted: &str) -> bool {
    std::iter::from_fn(|| python.line()).any(|line| line == wanted)
}

/// Another host: a network namespace with a link to this one. It ends with the test.
struct Host(std::process::Child);

impl Host {
    const HERE: &str = "10.99.0.1";
    const THERE: &str = "10.99.0.2";

    fn start() -> Self {
        let mut child = Command::new("unshare").args(["-n", "sleep", "600"]).spawn().expect("unshare starts");
        let id = child.id().to_string();
        let own = std::fs::read_link("/proc/self/ns/net").unwrap();
        while std::fs::read_link(format!("/proc/{id}/ns/net")).is_ok_and(|other| other == own) {
            assert!(child.try_wait().unwrap().is_none(), "the namespace is there");
            std::thread::sleep(Duration::from_millis(5));
        }
        let host = Self(child);
        ip(&["link", "add", "lan", "type", "veth", "peer", "name", "uplink", "netns", &id]);
        ip(&["address", "add", &format!("{}/24", Self::HERE), "dev", "lan"]);
        ip(&["link", "set", "lan", "up"]);
        for words in [
            ["link", "set", "lo", "up"].as_slice(),
            &["address", "add", &format!("{}/24", Self::THERE), "dev", "uplink"],
            &["link", "set", "uplink", "up"],
        ] {
            let done = Command::new("nsenter").args(["-t", &id, "-n", "ip"]).args(words).status().unwrap();
            assert!(done.success(), "{words:?}");
        }
        host
    }

    /// CycloneDDS as it is there by default: everybody on the link is a neighbour.
    fn python(&self, script: &str, args: &[&str]) -> Python {
        let cyclone = format!(
            "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='{}'/></Interfaces></General>\
             <Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery></Domain></CycloneDDS>",
            Self::THERE
        );
        Python::start_within(&["nsenter", "-t", &self.0.id().to_string(), "-n"], &cyclone, script, args)
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn ip(words: &[&str]) {
    assert!(Command::new("ip").args(words).status().unwrap().success(), "ip {words:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_on_another_host_is_heard_only_by_those_who_reach_there() {
    if !network::isolated(&|| ()) {
        return;
    }
    let host = Host::start();
    let (topic, message) = names("/cmd_vel", "geometry_msgs/msg/Twist");
    let open = async |reach| {
        let bridge = Participant::join(5, "ledgerd_bridge", &reach).await.unwrap();
        bridge.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap()
    };
    let mut subnet = open(Reach { range: Range::Subnet, ..Reach::default() }).await;
    let mut peer = open(Reach { static_peers: vec![Host::THERE.to_owned()], ..Reach::default() }).await;
    let mut local_only = open(Reach::default()).await;
    let args = ["5", &topic.dds(), "100", "50", "0"];
    let mut stranger = host.python("twist_publisher.py", &args);
    for reader in [&mut subnet, &mut peer] {
        tokio::time::timeout(DEADLINE, reader.next()).await.expect("it reaches the other host").unwrap();
    }
    assert_eq!(stranger.line().unwrap(), "matched");
    for _ in 0..100 {
        assert!(stranger.line().is_some());
    }
    assert!(stranger.finish(), "those who reach there have acknowledged everything");

    // The same program on this host is heard. What the stranger sent would come first.
    let args = ["5", &topic.dds(), "100", "50", "0", "1000"];
    let mut local = Python::start("twist_publisher.py", &args);
    let first = tokio::time::timeout(DEADLINE, local_only.next()).await.expect("local processes are heard").unwrap();
    let number = f64::from_le_bytes(*first.sample.wire().get(4..).unwrap().first_chunk().unwrap());
    assert!(number >= 1000.0, "message {number} of another host came in");
    assert_eq!(local.line().unwrap(), "matched");
}
