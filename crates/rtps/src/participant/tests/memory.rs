//! The memory that a process takes whose participant is flooded, against the table of the crate.

use super::by_hand::*;
use crate::Participant;
use crate::announcement::EndpointData;
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::{Channel, EndpointSettings, Input};
use crate::limits::*;
use crate::qos::{Durability, Qos};
use crate::wire::submessage::{Data, DataFrag, Gap, Heartbeat, InlineQos, NumberSet, Payload, Submessage};
use crate::wire::write::DatagramBuilder;
use std::process::Command;

/// Set in the process that is flooded: others run no test beside it.
const FLOODED: &str = "RTPS_FLOODED";
const KIB: usize = 1024;
/// Endpoints of each participant: as many as there may be of all.
const ENDPOINTS: usize = ENDPOINTS_MAX / PARTICIPANTS_MAX;
/// The topics of the own readers.
const TOPICS: usize = 3;

/// The table of `lib.rs`, for these matches.
fn stated(readers_matched: usize, writers_matched: usize) -> usize {
    PARTICIPANTS_MAX * 48 * KIB
        + ENDPOINTS_MAX * 8 * KIB
        + writers_matched * crate::reader::MATCHED_WRITER_BYTES_MAX
        + readers_matched * 2 * KIB
        + PARTICIPANT_BYTES_MAX
        + 3 * ANNOUNCEMENTS_BYTES_MAX
}

/// Resident memory of this process, bytes.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<usize>().unwrap() * KIB
}

fn prefix(number: usize) -> GuidPrefix {
    let [high, low] = u16::try_from(number).unwrap().to_be_bytes();
    GuidPrefix([0xee, high, low, 0, 0, 0, 0, 0, 0, 0, 0, 0])
}

/// Policies that match, and take as much as is kept of an endpoint.
fn qos() -> Qos {
    Qos { partitions: vec!["p".repeat(200); 14], ..reliable(Durability::Volatile) }
}

fn endpoint(prefix: GuidPrefix, number: usize) -> EndpointData {
    let key = u32::try_from(number).unwrap();
    let entity = if number.is_multiple_of(4) { EntityId::reader(key, false) } else { EntityId::writer(key, false) };
    let mut data = endpoint_data(Guid::new(prefix, entity));
    data.topic.name = format!("rt/{}", number % TOPICS);
    EndpointData { qos: qos(), user_data: vec![7; USER_DATA_BYTES_MAX].into(), ..data }
}

fn flood(participant: &mut Participant, prefix: GuidPrefix, submessages: &[Submessage]) {
    let mut builder = DatagramBuilder::new(prefix);
    submessages.iter().for_each(|submessage| builder.push(submessage));
    let input = Input::Datagram { from: FROM, channel: Channel::DataUnicast, bytes: builder.finish() };
    step(participant, 1, input);
}

fn ready(writer: EntityId, last: i64) -> Submessage {
    Submessage::Heartbeat(Heartbeat {
        reader: EntityId::UNKNOWN,
        writer,
        first: SequenceNumber(1),
        last: SequenceNumber(last),
        count: 1,
        is_final: true,
        is_alive: false,
    })
}

fn announce(participant: &mut Participant, prefix: GuidPrefix) {
    flood(participant, prefix, &[announced(&participant_data(prefix))]);
    let count = i64::try_from(ENDPOINTS).unwrap();
    for builtin in [EntityId::PUBLICATIONS_WRITER, EntityId::SUBSCRIPTIONS_WRITER] {
        flood(participant, prefix, &[ready(builtin, count)]);
    }
    for number in 0..ENDPOINTS {
        let data_ = endpoint(prefix, number);
        let is_writer = data_.guid.entity.is_writer();
        let [announcer, other] = match is_writer {
            true => [EntityId::PUBLICATIONS_WRITER, EntityId::SUBSCRIPTIONS_WRITER],
            false => [EntityId::SUBSCRIPTIONS_WRITER, EntityId::PUBLICATIONS_WRITER],
        };
        let sequence = i64::try_from(number).unwrap() + 1;
        let list = NumberSet::new(sequence + 1);
        let gap = Gap { reader: EntityId::UNKNOWN, writer: other, start: SequenceNumber(sequence), list };
        let published = data(announcer, sequence, Payload::Data(data_.to_payload()), InlineQos::default());
        flood(participant, prefix, &[published, Submessage::Gap(gap)]);
    }
}

/// Ranges of numbers that will not come, samples that wait, and fragments of samples that are never whole.
fn send_parts(participant: &mut Participant, prefix: GuidPrefix, writer: EntityId, round: u32) {
    let mut list = NumberSet::new(1000);
    (1000..1256).step_by(2).for_each(|number| assert!(list.insert(number)));
    let (reader, start) = (EntityId::UNKNOWN, SequenceNumber(1000));
    let part = DataFrag {
        reader,
        writer,
        sequence: SequenceNumber(2),
        first: 2 + round,
        count: 1,
        fragment_bytes: 16_000,
        sample_bytes: 16 << 20,
        inline_qos: InlineQos::default(),
        is_key: false,
        payload: vec![7; 16_000].into(),
    };
    let waits = Data {
        reader,
        writer,
        sequence: SequenceNumber(i64::from(round) + 10),
        inline_qos: InlineQos::default(),
        payload: Payload::Data(vec![7; 100].into()),
    };
    let gap = Submessage::Gap(Gap { reader, writer, start, list });
    flood(participant, prefix, &[ready(writer, 2000), gap, Submessage::Data(waits), Submessage::DataFrag(part)]);
}

#[test]
fn a_flooded_participant_takes_no_more_memory_than_the_table_of_the_crate_says() {
    if std::env::var_os(FLOODED).is_none() {
        let name =
            "participant::tests::memory::a_flooded_participant_takes_no_more_memory_than_the_table_of_the_crate_says";
        let mut alone = Command::new(std::env::current_exe().unwrap());
        let output = alone.args(["--exact", name, "--nocapture"]).env(FLOODED, "1").output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.contains("1 passed"), "{text}");
        return;
    }
    let mut participant = alone();
    for topic in 0..TOPICS {
        let settings = || EndpointSettings { qos: qos(), ..settings(&format!("rt/{topic}"), Qos::default()) };
        step(&mut participant, 1, Input::OpenReader(settings()));
        step(&mut participant, 1, Input::OpenWriter(settings()));
    }
    let before = resident();
    (0..PARTICIPANTS_MAX).for_each(|number| announce(&mut participant, prefix(number)));
    let (writers, readers) = (participant.publishers().count(), participant.subscribers().count());
    assert_eq!(writers + readers, ENDPOINTS_MAX);
    let endpoints = resident() - before;
    for round in 0..3 {
        for number in 0..PARTICIPANTS_MAX {
            for writer in (0..ENDPOINTS).filter(|writer| !writer.is_multiple_of(4)) {
                let writer = EntityId::writer(u32::try_from(writer).unwrap(), false);
                send_parts(&mut participant, prefix(number), writer, round);
            }
            // Announcements that wait for one that never comes.
            for announcer in
                [EntityId::PUBLICATIONS_WRITER, EntityId::SUBSCRIPTIONS_WRITER, EntityId::LIVELINESS_WRITER]
            {
                let sequence = i64::try_from(ENDPOINTS).unwrap() + 3 + i64::from(round);
                let waits = Payload::Data(vec![7; 30_000].into());
                flood(&mut participant, prefix(number), &[data(announcer, sequence, waits, InlineQos::default())]);
            }
        }
    }
    let grown = resident() - before;
    let stated = stated(readers, writers);
    assert!(grown <= stated, "{grown} bytes, {stated} are stated; {endpoints} without samples");
    // The flood does reach the limits.
    let waiting = PARTICIPANT_BYTES_MAX + 2 * ANNOUNCEMENTS_BYTES_MAX;
    assert!(participant.held_bytes() > waiting / 10 * 8, "{} bytes wait", participant.held_bytes());
    assert!(grown > participant.held_bytes() && endpoints > ENDPOINTS_MAX * 4 * KIB, "{grown}, {endpoints}");
    assert!(grown > stated / 2, "{grown} bytes, {stated} are stated");
}
