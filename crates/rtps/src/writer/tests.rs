#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::reader_proxy::FRAGMENT_REQUESTS_MAX;
use super::*;
use crate::guid::SampleIdentity;
use crate::limits::{HISTORY_BYTES_MAX, REPAIR_BYTES};
use crate::qos::History as Depth;
use crate::time::Ticks;
use crate::wire::submessage::{AckNack, Data, DataFrag, Gap, NackFrag, NumberSet};
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

mod requests;

/// Most bytes of a matched reader in addition to its addresses.
const READER_BYTES_MAX: usize = 1024;
const WRITER: EntityId = EntityId([0, 0, 1, 3]);
const READER: EntityId = EntityId([0, 0, 1, 4]);

fn at(micros: u64) -> Now {
    Now { steady: micros, wall: 0 }
}

fn peer(number: u8, is_reliable: bool, is_durable: bool) -> Peer {
    Peer {
        guid: Guid::new(GuidPrefix([number; 12]), READER),
        is_reliable,
        is_durable,
        unicast: vec![SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, number), 7411)],
        is_local: false,
        is_fast_dds: false,
    }
}

fn local(number: u8) -> Peer {
    Peer { is_local: true, ..peer(number, true, false) }
}

fn qos(history: Depth, durability: Durability) -> Qos {
    Qos { reliability: Reliability::Reliable, durability, history, ..Qos::default() }
}

fn volatile(depth: u32) -> Writer {
    Writer::new(WRITER, &qos(Depth::KeepLast(depth), Durability::Volatile))
}

fn durable(depth: u32) -> Writer {
    Writer::new(WRITER, &qos(Depth::KeepLast(depth), Durability::TransientLocal))
}

fn sample(bytes: usize) -> OutgoingSample {
    OutgoingSample { payload: Bytes::from(vec![7; bytes]), timestamp: Some(Ticks(5)), related: None }
}

fn poll(writer: &mut Writer, micros: u64) -> Vec<Outgoing> {
    let mut out = Vec::new();
    writer.poll(at(micros), &mut out);
    out
}

/// Polls at every deadline up to this time.
fn run(writer: &mut Writer, from: u64, until: u64) -> Vec<Outgoing> {
    let mut out = Vec::new();
    let mut now = from;
    while now <= until {
        writer.poll(at(now), &mut out);
        now = match writer.deadline() {
            Some(due) => due.max(now + 1),
            None => break,
        };
    }
    out
}

fn acknack(reader: u8, base: i64, missing: &[i64], count: i32, is_final: bool) -> (GuidPrefix, Submessage) {
    let mut set = NumberSet::new(base);
    missing.iter().for_each(|number| assert!(set.insert(*number)));
    let acknack = AckNack { reader: READER, writer: WRITER, missing: set, count, is_final };
    (GuidPrefix([reader; 12]), Submessage::AckNack(acknack))
}

fn nack_frag(reader: u8, sequence: i64, base: i64, missing: &[i64], count: i32) -> (GuidPrefix, Submessage) {
    let mut set = NumberSet::new(base);
    missing.iter().for_each(|number| assert!(set.insert(*number)));
    let sequence = SequenceNumber(sequence);
    (
        GuidPrefix([reader; 12]),
        Submessage::NackFrag(NackFrag { reader: READER, writer: WRITER, sequence, missing: set, count }),
    )
}

fn receive(writer: &mut Writer, micros: u64, (from, submessage): (GuidPrefix, Submessage)) {
    writer.receive(at(micros), from, &submessage);
}

fn submessages(out: &[Outgoing]) -> Vec<&Submessage> {
    out.iter().flat_map(|out| &out.submessages).collect()
}

fn numbers(out: &[Outgoing]) -> Vec<i64> {
    let data = |submessage: &&Submessage| match submessage {
        Submessage::Data(data) => Some(data.sequence.0),
        _ => None,
    };
    submessages(out).iter().filter_map(data).collect()
}

fn fragments(out: &[Outgoing]) -> Vec<&DataFrag> {
    let fragment = |submessage: &Submessage| -> bool { matches!(submessage, Submessage::DataFrag(_)) };
    let all = out.iter().flat_map(|out| &out.submessages).filter(|submessage| fragment(submessage));
    all.filter_map(|submessage| if let Submessage::DataFrag(fragment) = submessage { Some(fragment) } else { None })
        .collect()
}

fn heartbeats(out: &[Outgoing]) -> Vec<(i64, i64)> {
    let heartbeat = |submessage: &&Submessage| match submessage {
        Submessage::Heartbeat(heartbeat) => Some((heartbeat.first.0, heartbeat.last.0)),
        _ => None,
    };
    submessages(out).iter().filter_map(heartbeat).collect()
}

fn gaps(out: &[Outgoing]) -> Vec<&Gap> {
    let all = out.iter().flat_map(|out| &out.submessages);
    all.filter_map(|submessage| if let Submessage::Gap(gap) = submessage { Some(gap) } else { None }).collect()
}

#[test]
fn a_new_sample_goes_once_to_all_readers_together_with_a_heartbeat_behind_it() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.add_reader(at(0), peer(2, false, false));
    assert_eq!(heartbeats(&poll(&mut writer, 0)), [(1, 0)], "an empty writer lets a reliable reader finish its match");
    writer.write(at(20_000), sample(10));
    let out = poll(&mut writer, 20_000);
    assert_eq!((out.len(), numbers(&out), heartbeats(&out)), (1, vec![1], vec![(1, 1)]));
    assert_eq!((out[0].to.len(), out[0].destination, out[0].timestamp), (2, GuidPrefix::UNKNOWN, Some(Ticks(5))));
    assert!(matches!(&out[0].submessages[0], Submessage::Data(Data { reader: EntityId::UNKNOWN, .. })));
    writer.remove_reader(peer(2, false, false).guid);
    writer.write(at(40_000), sample(10));
    let out = poll(&mut writer, 40_000);
    assert_eq!(out[0].destination, GuidPrefix([1; 12]));
    assert!(matches!(&out[0].submessages[0], Submessage::Data(Data { reader: READER, .. })));
}

#[test]
fn heartbeats_are_repeated_ever_more_rarely_until_all_is_acknowledged() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    poll(&mut writer, 0);
    writer.write(at(100_000), sample(10));
    poll(&mut writer, 100_000);
    let mut due = Vec::new();
    for _ in 0..9 {
        let now = writer.deadline().unwrap();
        due.push((now - 100_000) / 1000);
        assert_eq!(heartbeats(&poll(&mut writer, now)), [(1, 1)]);
    }
    assert_eq!(due, [10, 30, 70, 150, 310, 630, 1270, 2270, 3270]);
    assert!(!writer.is_acknowledged());
    assert_eq!(writer.unacknowledged_bytes(), 10 + history::SAMPLE_OVERHEAD);
    receive(&mut writer, 4_000_000, acknack(1, 2, &[], 1, true));
    assert!(writer.is_acknowledged());
    assert_eq!((writer.deadline(), writer.unacknowledged_bytes()), (None, 0), "an idle writer does not wake up");
}

#[test]
fn a_fast_writer_asks_for_an_acknack_once_in_a_while_only() {
    let mut writer = volatile(1000);
    writer.add_reader(at(0), peer(1, true, false));
    poll(&mut writer, 0);
    let mut out = Vec::new();
    for millis in 0..100 {
        writer.write(at(millis * 1000), sample(10));
        writer.poll(at(millis * 1000), &mut out);
    }
    let count = heartbeats(&out).len();
    assert!((8..=11).contains(&count), "{count}");
}

#[test]
fn a_write_waits_for_no_reader_and_the_newest_samples_replace_the_oldest() {
    let mut writer = volatile(3);
    writer.add_reader(at(0), peer(1, true, false));
    for _ in 0..10 {
        writer.write(at(0), sample(10));
        poll(&mut writer, 0);
    }
    assert_eq!(writer.history.numbers(), [8, 9, 10]);
    let mut writer = Writer::new(WRITER, &qos(Depth::KeepAll, Durability::TransientLocal));
    for _ in 0..40 {
        writer.write(at(0), sample(1 << 20));
        assert!(writer.history.bytes_kept() <= HISTORY_BYTES_MAX);
    }
    assert_eq!(writer.history.numbers().len(), 31);
    // A HEARTBEAT announces the samples that are gone.
    poll(&mut writer, 0);
    writer.add_reader(at(0), peer(1, true, true));
    assert_eq!(heartbeats(&poll(&mut writer, 0)), [(10, 40)]);
}

#[test]
fn a_volatile_writer_forgets_what_all_reliable_readers_have() {
    let mut writer = volatile(10);
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    assert_eq!(writer.history.numbers(), [0; 0], "without readers at once");
    writer.add_reader(at(0), peer(1, true, false));
    writer.add_reader(at(0), peer(2, true, false));
    writer.add_reader(at(0), peer(3, false, false));
    writer.write(at(0), sample(10));
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    receive(&mut writer, 0, acknack(1, 4, &[], 1, true));
    assert_eq!(writer.history.numbers(), [2, 3]);
    receive(&mut writer, 0, acknack(2, 3, &[], 1, true));
    assert_eq!(writer.history.numbers(), [3]);
    writer.remove_reader(peer(2, true, false).guid);
    assert_eq!(writer.history.numbers(), [0; 0]);
    let mut writer = durable(10);
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    assert_eq!(writer.history.numbers(), [1], "a durable one keeps its depth");
}

#[test]
fn a_late_volatile_reader_gets_nothing_older_also_when_it_asks() {
    let mut writer = durable(10);
    for _ in 0..3 {
        writer.write(at(0), sample(10));
    }
    poll(&mut writer, 0);
    writer.add_reader(at(0), peer(1, true, false));
    let out = poll(&mut writer, 0);
    assert_eq!((numbers(&out), heartbeats(&out)), (vec![], vec![(1, 3)]));
    assert_eq!((gaps(&out)[0].start.0, gaps(&out)[0].list.base), (1, 4));
    receive(&mut writer, 10_000, acknack(1, 1, &[1, 2, 3], 1, false));
    let out = poll(&mut writer, 11_000);
    assert_eq!((numbers(&out), gaps(&out).len()), (vec![], 1));
    writer.write(at(20_000), sample(10));
    assert_eq!(numbers(&poll(&mut writer, 20_000)), [4]);
}

#[test]
fn a_late_durable_reader_gets_the_kept_history() {
    let mut writer = durable(2);
    for _ in 0..3 {
        writer.write(at(0), sample(10));
    }
    poll(&mut writer, 0);
    writer.add_reader(at(0), peer(1, false, true));
    assert_eq!(numbers(&poll(&mut writer, 0)), [2, 3], "best effort: unasked");
    writer.add_reader(at(0), peer(2, true, true));
    assert_eq!(heartbeats(&poll(&mut writer, 0)), [(2, 3)]);
    receive(&mut writer, 5000, acknack(2, 2, &[2, 3], 1, false));
    let out = poll(&mut writer, 6000);
    assert_eq!((numbers(&out), out[0].to.clone()), (vec![2, 3], peer(2, true, true).unicast));
}

#[test]
fn a_best_effort_reader_gets_a_large_kept_sample_in_bursts() {
    let mut writer = durable(1);
    writer.write(at(0), sample(1 << 20));
    run(&mut writer, 0, 10_000);
    writer.add_reader(at(20_000), peer(1, false, true));
    assert!(fragments(&poll(&mut writer, 20_000)).len() <= REPAIR_BYTES / usize::from(FRAGMENT_BYTES));
    let rest = run(&mut writer, 20_001, 30_000);
    assert_eq!(fragments(&rest).last().map(|fragment| fragment.first), Some((1 << 20) / u32::from(FRAGMENT_BYTES) + 1));
}

#[test]
fn requests_are_merged_for_a_moment_and_answered_to_the_reader_that_asked() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.add_reader(at(0), peer(2, true, false));
    for _ in 0..3 {
        writer.write(at(0), sample(10));
    }
    poll(&mut writer, 0);
    receive(&mut writer, 1000, acknack(1, 1, &[1, 2], 1, true));
    receive(&mut writer, 1500, acknack(1, 1, &[1, 2], 2, true));
    assert_eq!(numbers(&poll(&mut writer, 1999)), [0; 0]);
    let out = poll(&mut writer, 2000);
    assert_eq!(numbers(&out), [1, 2]);
    assert!(out.iter().all(|out| out.to == peer(1, true, false).unicast && out.destination == GuidPrefix([1; 12])));
    assert_eq!(heartbeats(&out).len(), 1, "the answer ends with a HEARTBEAT");
    receive(&mut writer, 3000, acknack(1, 4, &[], 3, true));
    receive(&mut writer, 4000, acknack(1, 2, &[2], 4, true));
    assert_eq!(numbers(&poll(&mut writer, 5000)), [2], "what was acknowledged is sent again");
}

#[test]
fn an_acknack_whose_count_does_not_grow_is_ignored_for_a_while() {
    let mut writer = durable(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    receive(&mut writer, 0, acknack(1, 2, &[], i32::MAX, true));
    receive(&mut writer, 1000, acknack(1, 1, &[1], i32::MAX, true));
    receive(&mut writer, 1000, acknack(1, 1, &[1], 7, true));
    assert_eq!(numbers(&poll(&mut writer, 10_000)), [0; 0]);
    receive(&mut writer, 10_000, acknack(1, 1, &[1], i32::MIN, true));
    assert_eq!(numbers(&poll(&mut writer, 20_000)), [1], "counts wrap around");
    receive(&mut writer, 2_000_000, acknack(1, 1, &[1], 1, true));
    assert_eq!(numbers(&poll(&mut writer, 2_010_000)), [1], "a reader that has started again counts from 1");
}

#[test]
fn requests_for_what_never_existed_cost_nothing() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    receive(&mut writer, 0, acknack(1, i64::MAX - 3, &[i64::MAX - 3], 1, true));
    receive(&mut writer, 0, acknack(1, 1 << 40, &[1 << 40, (1 << 40) + 255], 2, true));
    receive(&mut writer, 0, acknack(9, 1, &[1], 1, false));
    receive(&mut writer, 0, nack_frag(1, 77, 1, &[1, 2], 1));
    receive(&mut writer, 0, nack_frag(1, i64::MIN, i64::MAX - 1, &[], 2));
    let out = run(&mut writer, 0, 5000);
    assert_eq!((numbers(&out).len(), fragments(&out).len()), (0, 0));
    assert!(writer.is_acknowledged());
}

#[test]
fn what_was_forgotten_is_told_by_a_gap_over_the_whole_hole() {
    let mut writer = Writer::new(WRITER, &qos(Depth::KeepAll, Durability::TransientLocal));
    for _ in 0..2000 {
        writer.write(at(0), sample(10));
    }
    (2..=1990).chain([1995]).for_each(|number| writer.forget(SequenceNumber(number)));
    poll(&mut writer, 0);
    writer.add_reader(at(0), peer(1, true, true));
    receive(&mut writer, 1000, acknack(1, 1, &[1, 2, 3, 200], 1, true));
    let out = poll(&mut writer, 10_000);
    assert_eq!((numbers(&out), heartbeats(&out)), (vec![1], vec![(1, 2000)]));
    assert_eq!((gaps(&out).len(), gaps(&out)[0].start.0, gaps(&out)[0].list.base), (1, 2, 1991));
    receive(&mut writer, 20_000, acknack(1, 1991, &[1991, 1995, 1996], 2, true));
    let out = poll(&mut writer, 30_000);
    assert_eq!((numbers(&out), gaps(&out)[0].start.0, gaps(&out)[0].list.base), (vec![1991, 1996], 1995, 1996));
}

#[test]
fn the_end_of_an_instance_is_kept_until_its_readers_have_it() {
    let mut writer = Writer::new(WRITER, &qos(Depth::KeepAll, Durability::TransientLocal));
    writer.add_reader(at(0), peer(1, true, true));
    writer.write(at(0), sample(10));
    let end = writer.dispose(at(0), Payload::Key(Bytes::from_static(b"key")), [1; 16], 3);
    writer.write(at(0), sample(10));
    let out = poll(&mut writer, 0);
    let ends = |submessage: &&Submessage| {
        matches!(submessage, Submessage::Data(Data { inline_qos: InlineQos { status: 3, key_hash: Some(_), .. }, .. }))
    };
    assert_eq!(submessages(&out).iter().filter(|submessage| ends(submessage)).count(), 1);
    assert_eq!(writer.history.numbers(), [1, end.0, 3]);
    receive(&mut writer, 0, acknack(1, 3, &[], 1, true));
    assert_eq!(writer.history.numbers(), [1, 3]);
}

#[test]
fn expired_samples_are_not_sent_and_the_mark_of_a_bridge_expires_nothing() {
    let lifespan =
        |micros| Qos { lifespan: Ticks::from_micros(micros), ..qos(Depth::KeepLast(10), Durability::TransientLocal) };
    for (micros, expected) in [(1_000_000, vec![2]), (1_000_000_068_719_477, vec![1, 2])] {
        let mut writer = Writer::new(WRITER, &lifespan(micros));
        writer.write(Now { steady: 5_000_000, wall: 9_000_000 }, sample(10));
        writer.write(Now { steady: 6_500_000, wall: 0 }, sample(10));
        writer.add_reader(at(6_600_000), peer(1, true, true));
        poll(&mut writer, 6_600_000);
        receive(&mut writer, 6_600_000, acknack(1, 1, &[1, 2], 1, true));
        assert_eq!(numbers(&poll(&mut writer, 6_700_000)), expected);
    }
}

#[test]
fn a_large_sample_goes_in_bursts_and_no_heartbeat_tells_of_it_before_its_end() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    poll(&mut writer, 0);
    let related = Some(SampleIdentity { writer: peer(9, true, true).guid, sequence: SequenceNumber(4) });
    writer.write(at(20_000), OutgoingSample { related, ..sample(1_000_000) });
    let (mut now, mut bursts) = (20_000, 0);
    let mut next = 1;
    while next <= 1_000_000 / 1344 + 1 {
        let out = poll(&mut writer, now);
        assert!(!out.is_empty());
        assert!(out.iter().flat_map(|out| &out.submessages).map(message::bytes_of).sum::<usize>() < BURST_BYTES + 2000);
        for fragment in fragments(&out) {
            assert_eq!(
                (fragment.first, fragment.inline_qos.related, fragment.sample_bytes),
                (next, related, 1_000_000)
            );
            next += 1;
        }
        let told = heartbeats(&out);
        assert!(told.iter().all(|(_, last)| next > 1_000_000 / 1344 + 1 || *last == 0), "{told:?}");
        assert_eq!(numbers(&poll(&mut writer, now + BURST_PAUSE_MICROS - 1)), [0; 0]);
        (now, bursts) = (now + BURST_PAUSE_MICROS, bursts + 1);
    }
    assert_eq!(bursts, 1_000_000 / BURST_BYTES + 1);
}

#[test]
fn a_sample_that_is_replaced_while_it_is_pushed_is_sent_to_its_end() {
    let mut writer = volatile(1);
    writer.add_reader(at(0), local(1));
    writer.write(at(0), sample(1 << 20));
    poll(&mut writer, 0);
    writer.write(at(0), sample(10));
    let out = run(&mut writer, 100, 9000);
    assert_eq!(
        (fragments(&out).last().map(|fragment| fragment.first), numbers(&out)),
        (Some((1 << 20) / 16_000 + 1), vec![2])
    );
    assert_eq!(heartbeats(&out), [(2, 2)]);
}

#[test]
fn fragments_are_large_only_where_all_readers_are_on_this_host() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), local(1));
    writer.write(at(0), sample(20_000));
    writer.write(at(0), sample(15_000));
    let out = poll(&mut writer, 0);
    assert_eq!((fragments(&out).len(), fragments(&out)[0].fragment_bytes, numbers(&out)), (2, 16_000, vec![2]));
    writer.add_reader(at(0), peer(2, false, false));
    writer.write(at(1000), sample(20_000));
    assert!(fragments(&poll(&mut writer, 1000)).iter().all(|fragment| fragment.fragment_bytes == 1344));
    // A repair has the fragments that the reader knows.
    receive(&mut writer, 1000, acknack(1, 1, &[1, 3], 1, true));
    let out = poll(&mut writer, 3000);
    assert_eq!((fragments(&out)[0].fragment_bytes, fragments(&out).last().unwrap().fragment_bytes), (16_000, 1344));
}

#[test]
fn a_matched_reader_costs_a_bounded_number_of_bytes() {
    assert!(size_of::<ReaderProxy>() + FRAGMENT_REQUESTS_MAX * size_of::<(i64, NumberSet)>() <= READER_BYTES_MAX);
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    for count in 1..10_000 {
        writer.write(at(0), sample(10));
        receive(&mut writer, 0, nack_frag(1, i64::from(count), 1, &[1], count));
        receive(&mut writer, 0, acknack(1, 1, &[1], count, false));
    }
    let proxy = writer.readers.first_entry().unwrap();
    assert!(proxy.get().fragments.len() <= FRAGMENT_REQUESTS_MAX && writer.queue.len() == 1);
    assert!(writer.history.numbers().len() <= 10);
}

#[test]
fn an_address_that_has_changed_is_used() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.add_reader(at(0), Peer { unicast: peer(2, true, false).unicast, ..peer(1, true, false) });
    writer.write(at(0), sample(10));
    assert!(poll(&mut writer, 0).iter().all(|out| out.to == peer(2, true, false).unicast));
    assert_eq!(writer.readers.len(), 1);
}

#[test]
fn a_lifespan_that_is_infinite_ends_nothing() {
    let mut writer = durable(10);
    writer.write(at(0), sample(10));
    poll(&mut writer, u64::try_from(Duration::from_secs(3_000_000_000).as_micros()).unwrap());
    assert_eq!(writer.history.numbers(), [1]);
}
