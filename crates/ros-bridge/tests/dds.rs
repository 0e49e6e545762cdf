//! Two participants of ours on a network of their own.

use rustdds::{DomainParticipantBuilder, Timestamp, TopicKind};
use std::{
    process::Command,
    sync::Arc,
    time::{Duration, Instant},
};
use testkit::own_network as network;
use tokio::sync::watch;

use crate::commands::{DEADLINE, next, numbered, rust_dds, topic, twist};
use ledger_base::hash::Hash;
use ledger_gate::sample::{CDR_BE, CDR_LE, PL_CDR_BE, PL_CDR_LE, Sample, XCDR2};
use ros_bridge::{
    dds::{Change, Participant, Reader, Role, Writer},
    error::Error,
    loop_filter::LoopFilter,
    mark::Mark,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
    reach::Reach,
};

const LATCHED: Qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 100);

/// Where processes with other clocks may be heard.
fn not_alone() -> Reach {
    Reach { static_peers: vec!["127.0.0.1".to_owned()], ..Reach::default() }
}

async fn nobody_reads(writer: &Writer) {
    let gone = async {
        while writer.matched().now().matched > 0 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(DEADLINE, gone).await.unwrap();
}

async fn matched(reader: &Reader, writer: &Writer) {
    let both = async {
        assert!(reader.matched().at_least(1).await);
        assert!(writer.matched().at_least(1).await);
    };
    tokio::time::timeout(DEADLINE, both).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_volatile_reader_is_not_given_what_another_reader_heard_before_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = there.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut first = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    matched(&first, &writer).await;
    writer.write(&numbered(1)).unwrap();
    assert_eq!(next(&mut first).await.sample, numbered(1));
    let mut others = Vec::new();
    for (before, reliability) in [(1, Reliability::Reliable), (2, Reliability::BestEffort)] {
        let qos = Qos { reliability, ..Qos::default() };
        let mut later = here.reader(&topic(), &twist(), &qos, Limits::default()).unwrap();
        let heard = async {
            assert!(writer.matched().at_least(before + 1).await && later.matched().at_least(1).await);
            loop {
                // A reader that is best effort may miss one.
                writer.write(&numbered(2)).unwrap();
                if let Ok(heard) = tokio::time::timeout(Duration::from_millis(200), later.next()).await {
                    return heard.unwrap().sample;
                }
            }
        };
        assert_eq!(tokio::time::timeout(DEADLINE, heard).await.unwrap(), numbered(2), "{reliability:?}");
        others.push(later);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_volatile_reader_is_not_given_the_history_of_a_latched_writer() {
    if !network::isolated(&|| ()) {
        return;
    }
    let there = Participant::open(3, "there").await.unwrap();
    let writer = there.writer(&topic(), &twist(), &LATCHED).unwrap();
    writer.write(&numbered(1)).unwrap();
    for (number, reach) in (2..).zip([not_alone(), Reach::default()]) {
        let here = Participant::join(3, "here", &reach).await.unwrap();
        let mut reader = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
        matched(&reader, &writer).await;
        writer.write(&numbered(number)).unwrap();
        assert_eq!(next(&mut reader).await.sample, numbered(number), "{reach}");
        drop((reader, here));
        nobody_reads(&writer).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_latched_reader_that_comes_again_is_not_given_samples_of_a_writer_that_has_gone() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let reader = |topic: &TopicName| here.reader(topic, &twist(), &LATCHED, Limits::default()).unwrap();
    let writer = there.writer(&topic(), &twist(), &LATCHED).unwrap();
    writer.write(&numbered(1)).unwrap();
    let mut before = reader(&topic());
    assert_eq!(next(&mut before).await.sample, numbered(1));
    drop(before);
    nobody_reads(&writer).await;
    drop(writer);
    // DDS finishes with one reader before it announces another one.
    let elsewhere = TopicName::parse("/elsewhere").unwrap();
    let (other, witness) = (there.writer(&elsewhere, &twist(), &LATCHED).unwrap(), reader(&elsewhere));
    matched(&witness, &other).await;
    let mut again = reader(&topic());
    let newcomer = there.writer(&topic(), &twist(), &LATCHED).unwrap();
    newcomer.write(&numbered(2)).unwrap();
    assert_eq!(next(&mut again).await.sample, numbered(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_latched_sample_arrives_from_a_publisher_whose_clock_stands_at_1970() {
    if !network::isolated(&|| ()) {
        return;
    }
    let here = Participant::open(3, "here").await.unwrap();
    let mut reader = here.reader_behind(&topic(), &twist(), &LATCHED, Limits::default(), door(7)).unwrap();
    let there = DomainParticipantBuilder::new(3).build().unwrap();
    let policies = rust_dds(&LATCHED);
    let dds_topic = there.create_topic(topic().dds(), twist().dds(), &policies, TopicKind::NoKey).unwrap();
    let publisher = there.create_publisher(&policies).unwrap();
    let writer = publisher.create_datawriter_no_key_cdr::<Vec<u8>>(&dds_topic, Some(policies)).unwrap();
    assert!(writer.write(vec![1; 100_000], Some(Timestamp::from_ticks(1 << 32))).is_ok());
    assert_eq!(next(&mut reader).await.sample.body().len(), 100_004);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_matches_every_one_of_many_writers_that_came_at_once() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let reader = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    let writers: Vec<_> = (0..200).map(|_| there.writer(&topic(), &twist(), &Qos::default()).unwrap()).collect();
    assert!(tokio::time::timeout(DEADLINE, reader.matched().at_least(writers.len())).await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_newcomer_finds_a_reader_after_very_many_others_came_and_went() {
    if !network::isolated(&|| ()) {
        return;
    }
    let here = Participant::open(3, "here").await.unwrap();
    let open = |topic: &TopicName| here.reader(topic, &twist(), &Qos::default(), Limits::default());
    let (reader, elsewhere) = (open(&topic()).unwrap(), TopicName::parse("/elsewhere").unwrap());
    // DDS forgets the oldest announcements now and then, a few seconds apart.
    let (begun, mut others) = (Instant::now(), 0);
    while others < 4200 || begun.elapsed() < Duration::from_secs(9) {
        match open(&elsewhere) {
            Ok(_) => others += 1,
            // The thread of DDS has to close files of those before.
            Err(_) => tokio::time::sleep(Duration::from_millis(1)).await,
        }
        tokio::task::yield_now().await;
    }
    let there = Participant::open(3, "there").await.unwrap();
    matched(&reader, &there.writer(&topic(), &twist(), &Qos::default()).unwrap()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn samples_arrive_byte_for_byte_and_in_order() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    assert_ne!(here.guid(), there.guid());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut reader = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    matched(&reader, &writer).await;
    for number in 0..500 {
        writer.write(&numbered(number)).unwrap();
        if number % 50 == 49 {
            assert!(writer.flush(DEADLINE).await);
        }
    }
    for number in 0..500 {
        let incoming = next(&mut reader).await;
        assert_eq!(incoming.sample, numbered(number));
        assert_eq!(incoming.source[..12], here.guid()[..12]);
        assert_eq!(incoming.sequence, u64::from(number) + 1);
    }
    assert_eq!(reader.dropped(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_tells_how_long_it_waited_if_nobody_but_this_host_can_have_sent_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    let there = Participant::open(3, "there").await.unwrap();
    let writer = there.writer(&topic(), &twist(), &LATCHED).unwrap();
    writer.write(&numbered(1)).unwrap();
    let written = Instant::now();
    while written.elapsed() < Duration::from_millis(200) {
        tokio::task::yield_now().await;
    }
    for (reach, has_clock) in [(Reach::default(), true), (not_alone(), false)] {
        let here = Participant::join(3, "here", &reach).await.unwrap();
        let mut reader = here.reader(&topic(), &twist(), &LATCHED, Limits::default()).unwrap();
        let waited = next(&mut reader).await.waited;
        // The wall clock may be put right meanwhile.
        assert_eq!(waited > Duration::from_millis(100), has_clock, "{waited:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_encoding_arrives_with_its_options() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut reader = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    matched(&reader, &writer).await;
    for id in [CDR_LE, CDR_BE, PL_CDR_LE, PL_CDR_BE].into_iter().chain(XCDR2) {
        let sample = Sample::with_options(id, [0, 3], &[1, 2, 3, 4, 5, 0, 0, 0]).unwrap();
        let arrived = async {
            loop {
                // The first one of an encoding may be lost, as its writer is opened with it.
                writer.write(&sample).unwrap();
                let next = tokio::time::timeout(Duration::from_millis(100), reader.next()).await;
                if next.is_ok_and(|incoming| incoming.unwrap().sample == sample) {
                    return;
                }
            }
        };
        assert!(tokio::time::timeout(DEADLINE, arrived).await.is_ok(), "{id:?} does not arrive as it is");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_sample_arrives_whole() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut reader = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    matched(&reader, &writer).await;
    let body: Vec<u8> = (0..1_000_000_u32).map(|byte| byte.to_le_bytes()[0]).collect();
    let large = Sample::new(CDR_LE, &body).unwrap();
    writer.write(&large).unwrap();
    assert_eq!(next(&mut reader).await.sample, large);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_above_the_limit_is_dropped_and_the_next_one_comes() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let limits = Limits { sample_bytes_max: 1000, ..Limits::default() };
    let mut reader = there.reader(&topic(), &twist(), &Qos::default(), limits).unwrap();
    matched(&reader, &writer).await;
    writer.write(&Sample::new(CDR_LE, &[1; 2000]).unwrap()).unwrap();
    writer.write(&numbered(2)).unwrap();
    assert_eq!(next(&mut reader).await.sample, numbered(2));
    assert_eq!(reader.dropped(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_participant_never_hears_itself() {
    if !network::isolated(&|| ()) {
        return;
    }
    // With multicast, its own announcements come back to it.
    for setup in ["link set lo multicast on", "route add 224.0.0.0/4 dev lo"] {
        assert!(Command::new("ip").args(setup.split(' ')).status().unwrap().success());
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut own = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    let other = there.writer(&topic(), &twist(), &Qos::default()).unwrap();
    matched(&own, &other).await;
    assert_eq!(own.matched().now().matched, 1, "our own writer does not match");
    writer.write(&numbered(1)).unwrap();
    assert!(writer.flush(DEADLINE).await, "no reader lacks it");
    // What it gives out first is what came from the other, although its own was written before.
    other.write(&numbered(2)).unwrap();
    assert_eq!(next(&mut own).await.sample, numbered(2));
    assert!(own.try_next().is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn both_byte_orders_pass_as_they_are() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    // Latched, so that what is written before the second DDS writer is matched is not lost.
    let writer = here.writer(&topic(), &twist(), &LATCHED).unwrap();
    let mut reader = there.reader(&topic(), &twist(), &LATCHED, Limits::default()).unwrap();
    matched(&reader, &writer).await;
    let big = Sample::new(CDR_BE, &[0, 0, 0, 9]).unwrap();
    writer.write(&big).unwrap();
    assert_eq!(next(&mut reader).await.sample, big);
    writer.write(&numbered(3)).unwrap();
    assert_eq!(next(&mut reader).await.sample, numbered(3));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_reader_gets_what_was_latched() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &LATCHED).unwrap();
    writer.write(&numbered(7)).unwrap();
    let mut reader = there.reader(&topic(), &twist(), &LATCHED, Limits::default()).unwrap();
    assert_eq!(next(&mut reader).await.sample, numbered(7));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_that_requests_too_much_is_counted_as_incompatible() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let best_effort = Qos { reliability: Reliability::BestEffort, ..Qos::default() };
    let _writer = here.writer(&topic(), &twist(), &best_effort).unwrap();
    let reader = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    let refused = async {
        while reader.matched().now().incompatible == 0 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(DEADLINE, refused).await.unwrap();
    assert_eq!(reader.matched().now().matched, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_writer_that_leaves_is_no_longer_matched() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let writer = here.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let reader = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    matched(&reader, &writer).await;
    drop(writer);
    let gone = async {
        while reader.matched().now().matched > 0 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(DEADLINE, gone).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn domains_and_node_names_out_of_range_are_refused() {
    assert!(matches!(Participant::open(233, "bridge").await, Err(Error::Setting(_))));
    assert!(matches!(Participant::open(1, "not a name").await, Err(Error::Name(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_and_who_leaves_is_told_with_type_qos_and_mark() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let text = TypeName::parse("std_msgs/msg/String").unwrap();
    let elsewhere = TopicName::parse("/elsewhere").unwrap();
    let right = there.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    let _uninteresting = there.writer(&elsewhere, &text, &Qos::default()).unwrap();
    let _bridge = there.marked_writer(&elsewhere, &twist(), &Qos::default(), mark()).unwrap();
    let other = there.writer(&topic(), &text, &Qos::default()).unwrap();
    let (tell, mut told) = tokio::sync::mpsc::unbounded_channel();
    let topics = watch::Sender::new([topic().dds()].into());
    let follow = here.follow(topics.subscribe(), |change| tell.send(change).unwrap());
    let story = async {
        let mut came = Vec::new();
        while came.len() < 3 {
            let Some(Change::Came(neighbour)) = told.recv().await else { unreachable!("nobody leaves yet") };
            came.push((neighbour.role, neighbour.topic, neighbour.type_name, neighbour.mark));
        }
        came.sort();
        let (topic, elsewhere) = (topic().dds(), elsewhere.dds());
        let expected = [
            (Role::Publisher, topic.clone(), text.dds(), None),
            (Role::Publisher, elsewhere.clone(), twist().dds(), Some(mark())),
            (Role::Subscriber, topic, twist().dds(), None),
        ];
        assert_eq!(came.len(), expected.len());
        assert!(expected.iter().all(|expected| came.contains(expected)), "{came:?}");
        drop(right);
        let Some(Change::Left(left)) = told.recv().await else { unreachable!("only the reader left") };
        assert_eq!(left.role, Role::Subscriber);
        drop(other);
        let Some(Change::Left(left)) = told.recv().await else { unreachable!("only the writer left") };
        assert_eq!(left.type_name, text.dds());
        // A topic that becomes interesting: those that are there already are told of.
        topics.send_replace([elsewhere.clone()].into());
        let Some(Change::Came(known)) = told.recv().await else { unreachable!("the writer on /elsewhere is there") };
        assert_eq!((known.topic, known.type_name), (elsewhere, text.dds()));
    };
    tokio::time::timeout(DEADLINE, async {
        tokio::select! {
            () = follow => unreachable!("it goes on"),
            () = story => {}
        }
    })
    .await
    .unwrap();
}

fn mark() -> Mark {
    Mark::new(&Hash([7; 32]), "T/cmd_vel")
}

fn door(network: u8) -> Arc<LoopFilter> {
    let mark = Mark::new(&Hash([network; 32]), "T/cmd_vel");
    Arc::new(LoopFilter::new(mark, "T/cmd_vel", Duration::from_secs(1), Arc::default()))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_bridge_publishes_is_not_taken_in_by_another_one_of_its_network() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(3, "here").await.unwrap(), Participant::open(3, "there").await.unwrap());
    let door_here = door(7);
    let open = |door| here.reader_behind(&topic(), &twist(), &Qos::default(), Limits::default(), door).unwrap();
    let mut reader = open(Arc::clone(&door_here));
    let mut elsewhere = open(door(8));
    let bridge = there.marked_writer(&topic(), &twist(), &Qos::default(), mark()).unwrap();
    let node = there.writer(&topic(), &twist(), &Qos::default()).unwrap();
    matched(&reader, &bridge).await;
    assert!(tokio::time::timeout(DEADLINE, reader.matched().at_least(2)).await.unwrap());
    assert!(tokio::time::timeout(DEADLINE, elsewhere.matched().at_least(2)).await.unwrap());
    bridge.write(&numbered(1)).unwrap();
    assert!(bridge.flush(DEADLINE).await);
    assert_eq!(next(&mut elsewhere).await.sample, numbered(1), "a bridge of another network takes it");
    while door_here.returned() == 0 {
        tokio::task::yield_now().await;
    }
    node.write(&numbered(2)).unwrap();
    assert_eq!(next(&mut reader).await.sample, numbered(2));
    assert_eq!(door_here.returned(), 1);
    // A bridge that was killed and comes back is known at once: nothing of it is taken in before.
    drop(bridge);
    let again = there.marked_writer(&topic(), &twist(), &Qos::default(), mark()).unwrap();
    matched(&reader, &again).await;
    again.write(&numbered(3)).unwrap();
    while door_here.returned() == 1 {
        tokio::task::yield_now().await;
    }
    assert!(reader.try_next().is_none());
}
