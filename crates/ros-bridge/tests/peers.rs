//! A bridge's DDS beside software that we did not write: CycloneDDS and Fast DDS, both ways, in every quality of service.

mod streamed;

use std::{process::Command, time::Duration};
use testkit::own_network as network;

use ros_bridge::{
    dds::{Participant, Reader, Writer},
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
};

use streamed::{number_of, streamed};
use testkit::peer::{PEERS, Peer, number};
use testkit::python::Python;

const DEADLINE: Duration = Duration::from_secs(60);
const DOMAIN: u16 = 5;
/// An image of 640 x 480 in three colours.
const VGA: usize = 900_000;
const BEST_EFFORT: Qos = Qos::new(Reliability::BestEffort, Durability::Volatile, 100);
const LATCHED: Qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 10);

/// Samples, how many of them a second, and bytes of each; 0 is a Twist.
type Stream = (u32, u32, usize);

fn names(size: usize) -> (TopicName, TypeName) {
    let (topic, message) =
        if size == 0 { ("/cmd_vel", "geometry_msgs/msg/Twist") } else { ("/image", "sensor_msgs/msg/Image") };
    (TopicName::parse(topic).unwrap(), TypeName::parse(message).unwrap())
}

/// A reader, and the participant that it needs.
async fn reader(qos: &Qos, size: usize) -> (Participant, Reader) {
    let (topic, message) = names(size);
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let limits = Limits { sample_bytes_max: 8 << 20, ..Limits::default() };
    let reader = bridge.reader(&topic, &message, qos, limits).unwrap();
    (bridge, reader)
}

async fn writer(qos: &Qos, size: usize) -> (Participant, Writer) {
    let (topic, message) = names(size);
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let writer = bridge.writer(&topic, &message, qos).unwrap();
    (bridge, writer)
}

async fn next(reader: &mut Reader, size: usize) -> u32 {
    let incoming = tokio::time::timeout(DEADLINE, reader.next()).await.expect("a sample comes").unwrap();
    number_of(&incoming.sample, size)
}

/// Publishes at the rate of the stream.
async fn publish(writer: &Writer, (count, rate, size): Stream) {
    let mut due = tokio::time::interval(Duration::from_secs(1) / rate);
    for number in 0..count {
        due.tick().await;
        writer.write(&streamed(number, size)).unwrap();
    }
}

/// A subscriber that has found the writer. It ends by itself when it has what it wants.
fn late_subscriber(peer: Peer, wanted: (u32, usize), words: &[&str]) -> Python {
    let (topic, _) = names(wanted.1);
    let mut subscriber = peer.subscribes(DOMAIN, &topic.dds(), wanted, words);
    assert_eq!(subscriber.line().as_deref(), Some("ready"), "{peer:?}");
    assert_eq!(subscriber.line().as_deref(), Some("matched"), "{peer:?}");
    subscriber
}

/// A subscriber and the writer that have found each other, before anything is published.
async fn subscriber(peer: Peer, writer: &Writer, wanted: (u32, usize), words: &[&str]) -> Python {
    let subscriber = late_subscriber(peer, wanted, words);
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
    subscriber
}

/// All of a reliable stream arrive, in order, whole.
async fn all_come(peer: Peer, stream: Stream) {
    let (count, _, size) = stream;
    let (_bridge, mut reader) = reader(&Qos::default(), size).await;
    let mut publisher = peer.publishes(DOMAIN, &names(size).0.dds(), stream, &["keep_all"]);
    for wanted in 0..count {
        let incoming = tokio::time::timeout(DEADLINE, reader.next()).await;
        assert!(incoming.is_ok(), "{peer:?} {stream:?}: no sample {wanted}; dropped: {}", reader.dropped());
        assert_eq!(number_of(&incoming.unwrap().unwrap().sample, size), wanted, "{peer:?} {stream:?}");
    }
    assert_eq!(publisher.line().as_deref(), Some("matched"));
    assert!(publisher.finish(), "everything was acknowledged to {peer:?}");
    assert_eq!(reader.dropped(), 0);
}

async fn all_go(peer: Peer, stream: Stream) {
    let (count, _, size) = stream;
    let (_bridge, writer) = writer(&Qos::default(), size).await;
    let mut subscriber = subscriber(peer, &writer, (count, size), &["keep_all"]).await;
    publish(&writer, stream).await;
    for wanted in 0..count {
        assert_eq!(number(&mut subscriber), Some(wanted), "{peer:?} {stream:?}");
    }
    assert!(subscriber.finish(), "{peer:?} has exactly {count}");
    assert!(writer.flush(DEADLINE).await, "{peer:?} has acknowledged everything");
}

/// Nothing of a best-effort stream is sent again. The images that come are whole and in order, and the stream goes on to its end.
async fn some_come_and_go(peer: Peer, stream: Stream) {
    let (count, _, size) = stream;
    let last = count - 1;
    {
        let (_bridge, mut reader) = reader(&BEST_EFFORT, size).await;
        // A publisher that does not wait for acknowledgements ends with its last sample: this many follow that one.
        let _publisher = peer.publishes(DOMAIN, &names(size).0.dds(), (count * 2, stream.1, size), &["best_effort"]);
        let mut before = None;
        while before < Some(last) {
            let came = next(&mut reader, size).await;
            assert!(before < Some(came), "{peer:?}: {came} came after {before:?}");
            before = Some(came);
        }
    }
    let (_bridge, writer) = writer(&BEST_EFFORT, size).await;
    let mut subscriber = subscriber(peer, &writer, (0, size), &["best_effort"]).await;
    publish(&writer, (count * 2, stream.1, size)).await;
    let mut before = None;
    while before < Some(last) {
        let came = number(&mut subscriber);
        assert!(before < came, "{peer:?}: {came:?} came after {before:?}");
        before = came;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn twists_at_50_hz_come_from_others_and_go_to_them() {
    if network::isolated(&|| ()) {
        for peer in PEERS {
            all_come(peer, (100, 50, 0)).await;
            all_go(peer, (100, 50, 0)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_stream_of_twists_comes_from_others_and_goes_to_them_whole() {
    if network::isolated(&|| ()) {
        for peer in PEERS {
            all_come(peer, (500, 100, 0)).await;
            all_go(peer, (500, 100, 0)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn best_effort_streams_are_whole_and_in_order() {
    if network::isolated(&|| ()) {
        for peer in PEERS {
            some_come_and_go(peer, (50, 50, 0)).await;
            some_come_and_go(peer, (500, 1000, 0)).await;
            some_come_and_go(peer, (20, 10, 60_000)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn images_of_1_mb_come_from_others_and_go_to_them() {
    if network::isolated(&|| ()) {
        for peer in PEERS {
            all_come(peer, (30, 10, 1_000_000)).await;
            all_go(peer, (30, 10, 1_000_000)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn images_of_4_mb_come_from_others_and_go_to_them() {
    if network::isolated(&|| ()) {
        for peer in [Peer::Cyclone, Peer::FastWithLargeBuffers] {
            all_come(peer, (10, 4, 4_000_000)).await;
            all_go(peer, (10, 4, 4_000_000)).await;
        }
    }
}

/// A writer of images of 640 x 480 in three colours, and two subscribers of it. The first one expects `count`.
async fn two_subscribers(peer: Peer, count: u32) -> (Participant, Writer, [Python; 2]) {
    let (bridge, writer) = writer(&Qos::default(), VGA).await;
    let first = subscriber(peer, &writer, (count, VGA), &["keep_all"]).await;
    let second = subscriber(peer, &writer, (0, VGA), &[]).await;
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(2)).await.unwrap());
    (bridge, writer, [first, second])
}

/// Publishes images, each when that subscriber has the one before.
fn film(writer: &Writer, numbers: std::ops::Range<u32>, subscriber: &mut Python) {
    for wanted in numbers {
        writer.write(&streamed(wanted, VGA)).unwrap();
        assert_eq!(number(subscriber), Some(wanted));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_subscriber_that_is_killed_takes_nothing_from_another_one() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (_bridge, writer, [mut lives, mut dies]) = two_subscribers(Peer::Cyclone, 90).await;
    film(&writer, 0..10, &mut lives);
    assert!(number(&mut dies).is_some());
    drop(dies);
    film(&writer, 10..90, &mut lives);
    assert!(lives.finish());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_subscriber_that_stands_still_takes_nothing_from_another_one_and_gets_the_newest_when_it_goes_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (_bridge, writer, [mut lives, mut stands]) = two_subscribers(Peer::Cyclone, 90).await;
    film(&writer, 0..10, &mut lives);
    assert!(number(&mut stands).is_some());
    signal("-STOP", &stands);
    stands_still(&stands);
    film(&writer, 10..90, &mut lives);
    signal("-CONT", &stands);
    assert!(std::iter::from_fn(|| number(&mut stands)).any(|number| number == 89), "it gets the newest");
    assert!(writer.flush(DEADLINE).await);
}

/// Waits until no thread of it can acknowledge anything any more.
fn stands_still(python: &Python) {
    let tasks = format!("/proc/{}/task", python.child.id());
    let stopped = |stat: String| stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('T'));
    let still = || {
        let stats = std::fs::read_dir(&tasks).unwrap().map(|task| task.unwrap().path().join("stat"));
        stats.filter_map(|path| std::fs::read_to_string(path).ok()).all(stopped)
    };
    while !still() {
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn signal(signal: &str, python: &Python) {
    let id = python.child.id().to_string();
    assert!(Command::new("sh").args(["-c", &format!("kill {signal} {id}")]).status().unwrap().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_late_gets_what_was_latched() {
    if !network::isolated(&|| ()) {
        return;
    }
    for peer in PEERS {
        let (bridge, writer) = writer(&LATCHED, 0).await;
        publish(&writer, (12, 1000, 0)).await;
        let mut late = late_subscriber(peer, (10, 0), &["transient_local"]);
        for wanted in 2..12 {
            assert_eq!(number(&mut late), Some(wanted), "{peer:?}: the last ten");
        }
        assert!(late.finish());
        drop((writer, bridge));

        let mut publisher = peer.publishes(DOMAIN, &names(0).0.dds(), (12, 1000, 0), &["transient_local"]);
        assert_eq!(publisher.line().as_deref(), Some("matched"));
        let (_bridge, mut reader) = reader(&LATCHED, 0).await;
        while next(&mut reader, 0).await != 11 {}
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_peer_that_was_killed_and_started_again_is_served_and_heard() {
    if !network::isolated(&|| ()) {
        return;
    }
    for peer in PEERS {
        let (_bridge, writer) = writer(&Qos::default(), 0).await;
        let mut first = subscriber(peer, &writer, (0, 0), &[]).await;
        publish(&writer, (10, 100, 0)).await;
        assert!(number(&mut first).is_some());
        drop(first);
        let mut second = subscriber(peer, &writer, (10, 0), &["keep_all"]).await;
        assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(2)).await.unwrap(), "both are known");
        publish(&writer, (10, 100, 0)).await;
        for wanted in 0..10 {
            assert_eq!(number(&mut second), Some(wanted), "{peer:?}");
        }
        assert!(second.finish());
        drop(writer);

        let (_bridge, mut reader) = reader(&Qos::default(), 0).await;
        let stream = (1000, 50, 0);
        let first = peer.publishes(DOMAIN, &names(0).0.dds(), stream, &[]);
        assert_eq!(next(&mut reader, 0).await, 0);
        drop(first);
        let _second = peer.publishes(DOMAIN, &names(0).0.dds(), stream, &[]);
        while next(&mut reader, 0).await != 0 {}
        assert_eq!(next(&mut reader, 0).await, 1, "{peer:?} is heard again from its beginning");
    }
}
