#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod budget;
mod fragments;
mod losses;

use super::*;
use crate::endpoint::DisposedKey;
use crate::guid::{GuidPrefix, SampleIdentity, SequenceNumber};
use crate::interface::LossReason;
use crate::limits::{ASSEMBLY_BYTES_MAX, ASSEMBLY_SAMPLES_MAX};
use crate::qos::Durability;
use crate::time::Ticks;
use crate::wire::submessage::{
    AckNack, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, InlineQos, NackFrag, NumberSet, Payload,
};
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};

const WRITER: EntityId = EntityId([0, 0, 1, 3]);
const READER: EntityId = EntityId([0, 0, 1, 4]);
const PREFIX: GuidPrefix = GuidPrefix([7; 12]);
const GUID: Guid = Guid { prefix: PREFIX, entity: WRITER };

/// A reader with one matched writer.
struct Ear {
    reader: Reader,
    now: u64,
}

fn peer(is_durable: bool) -> Peer {
    let unicast = vec![SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 7), 7411)];
    Peer { guid: GUID, is_reliable: true, is_durable, unicast, is_local: false, is_fast_dds: false }
}

impl Ear {
    fn with(reliability: Reliability, durability: Durability, without_history: bool, writer: Peer) -> Self {
        let qos = Qos { reliability, durability, ..Qos::default() };
        let mut ear = Self { reader: Reader::new(READER, &qos, without_history), now: 1_000_000 };
        ear.reader.add_writer(ear.at(), writer);
        ear
    }

    fn reliable() -> Self {
        Self::with(Reliability::Reliable, Durability::Volatile, false, peer(false))
    }

    fn best_effort() -> Self {
        Self::with(Reliability::BestEffort, Durability::Volatile, false, peer(false))
    }

    /// Reliable, and the first HEARTBEAT of an empty writer has come.
    fn synchronized() -> Self {
        let mut ear = Self::reliable();
        ear.hear(heartbeat(1, 0, true));
        ear.answers();
        ear
    }

    fn at(&self) -> Now {
        Now { steady: self.now, wall: 0 }
    }

    fn hear(&mut self, submessage: Submessage) -> Vec<Delivered> {
        self.hear_from(PREFIX, submessage)
    }

    fn hear_from(&mut self, source: GuidPrefix, submessage: Submessage) -> Vec<Delivered> {
        let mut out = Vec::new();
        let message = Addressed { source, destination: GuidPrefix::UNKNOWN, timestamp: Some(Ticks(9)), submessage };
        self.reader.receive(self.at(), &message, &mut out);
        out
    }

    /// The answers of this moment.
    fn answers(&mut self) -> Vec<Submessage> {
        let mut out = Vec::new();
        self.reader.poll(self.at(), &mut out, &mut Vec::new());
        assert!(out.iter().all(|out| out.destination == PREFIX && !out.to.is_empty()));
        out.into_iter().flat_map(|out| out.submessages).collect()
    }

    /// The next answers.
    fn next_answers(&mut self) -> Vec<Submessage> {
        loop {
            self.now = self.reader.deadline().unwrap().max(self.now);
            let answers = self.answers();
            if !answers.is_empty() {
                return answers;
            }
        }
    }

    fn bytes(&self) -> usize {
        self.reader.held()
    }
}

fn data(number: i64) -> Submessage {
    Submessage::Data(Data {
        reader: EntityId::UNKNOWN,
        writer: WRITER,
        sequence: SequenceNumber(number),
        inline_qos: InlineQos::default(),
        payload: Payload::Data(Bytes::copy_from_slice(&number.to_be_bytes())),
    })
}

fn heartbeat(first: i64, last: i64, is_final: bool) -> Submessage {
    let (first, last) = (SequenceNumber(first), SequenceNumber(last));
    Submessage::Heartbeat(Heartbeat {
        reader: READER,
        writer: WRITER,
        first,
        last,
        count: 1,
        is_final,
        is_alive: false,
    })
}

fn gap(start: i64, base: i64, more: &[i64]) -> Submessage {
    let mut list = NumberSet::new(base);
    more.iter().for_each(|number| assert!(list.insert(*number)));
    Submessage::Gap(Gap { reader: READER, writer: WRITER, start: SequenceNumber(start), list })
}

/// Fragments of the sample `content(bytes)`.
fn fragment(number: i64, bytes: usize, first: u32, count: u16) -> DataFrag {
    let from = usize::try_from(first - 1).unwrap() * 1000;
    DataFrag {
        reader: EntityId::UNKNOWN,
        writer: WRITER,
        sequence: SequenceNumber(number),
        first,
        count,
        fragment_bytes: 1000,
        sample_bytes: u32::try_from(bytes).unwrap(),
        inline_qos: InlineQos::default(),
        is_key: false,
        payload: content(bytes).slice(from..(from + 1000 * usize::from(count)).min(bytes)),
    }
}

fn content(bytes: usize) -> Bytes {
    (0..bytes).map(|index| u8::try_from(index * 7 % 251).unwrap()).collect()
}

fn numbers(delivered: &[Delivered]) -> Vec<i64> {
    let number = |delivered: &Delivered| match delivered {
        Delivered::Sample(sample) => Some(sample.sequence.0),
        _ => None,
    };
    delivered.iter().filter_map(number).collect()
}

fn lost(delivered: &[Delivered]) -> Vec<(u64, LossReason)> {
    let lost = |delivered: &Delivered| match delivered {
        Delivered::Lost { count, reason, .. } => Some((*count, *reason)),
        _ => None,
    };
    delivered.iter().filter_map(lost).collect()
}

fn acknack(submessages: &[Submessage]) -> Option<(i64, Vec<i64>, bool)> {
    let acknack = |submessage: &Submessage| match submessage {
        Submessage::AckNack(AckNack { missing, is_final, .. }) => {
            Some((missing.base, missing.iter().collect(), *is_final))
        }
        _ => None,
    };
    submessages.iter().find_map(acknack)
}

fn nack_frags(submessages: &[Submessage]) -> Vec<(i64, Vec<i64>)> {
    let nack = |submessage: &Submessage| match submessage {
        Submessage::NackFrag(NackFrag { sequence, missing, .. }) => Some((sequence.0, missing.iter().collect())),
        _ => None,
    };
    submessages.iter().filter_map(nack).collect()
}

#[test]
fn a_new_writer_is_asked_for_a_heartbeat_again_until_one_comes() {
    let mut ear = Ear::reliable();
    let begin = ear.now;
    assert_eq!(acknack(&ear.answers()), Some((1, vec![], false)));
    assert_eq!(acknack(&ear.next_answers()), Some((1, vec![], false)));
    assert_eq!(ear.now - begin, 5_000_000);
    ear.hear(heartbeat(1, 0, false));
    assert_eq!(acknack(&ear.next_answers()), Some((1, vec![], true)));
    assert_eq!(ear.reader.deadline(), None, "an idle reader does not wake up");
}

#[test]
fn fast_dds_is_asked_with_a_base_of_zero_and_counts_go_on_over_matches() {
    let writer = Peer { is_fast_dds: true, ..peer(false) };
    let mut ear = Ear::with(Reliability::Reliable, Durability::Volatile, false, writer.clone());
    let mut counts = Vec::new();
    for _ in 0..3 {
        let answers = ear.next_answers();
        assert_eq!(acknack(&answers).unwrap().0, 0);
        if let Submessage::AckNack(acknack) = &answers[0] {
            counts.push(acknack.count);
        }
        ear.reader.remove_writer(GUID);
        ear.reader.add_writer(ear.at(), writer.clone());
    }
    assert_eq!(counts, [1, 2, 3]);
}

#[test]
fn samples_are_delivered_in_order_and_once_and_missing_ones_are_requested() {
    let mut ear = Ear::synchronized();
    assert_eq!(numbers(&ear.hear(data(1))), [1]);
    assert_eq!(numbers(&ear.hear(data(3))), [0; 0]);
    assert_eq!(numbers(&ear.hear(data(5))), [0; 0]);
    ear.hear(heartbeat(1, 6, true));
    assert_eq!(acknack(&ear.answers()), None, "what is on its way is not asked for");
    assert_eq!(acknack(&ear.next_answers()), Some((2, vec![2, 4, 6], false)));
    assert_eq!(numbers(&ear.hear(data(2))), [2, 3]);
    assert_eq!(numbers(&ear.hear(data(2))), [0; 0]);
    assert_eq!(numbers(&ear.hear(data(3))), [0; 0]);
    assert_eq!(numbers(&ear.hear(data(4))), [4, 5]);
    assert_eq!(numbers(&ear.hear(data(6))), [6]);
    ear.hear(heartbeat(1, 6, false));
    assert_eq!(acknack(&ear.next_answers()), Some((7, vec![], true)));
    ear.hear(heartbeat(1, 6, true));
    assert_eq!(ear.answers(), [], "a final HEARTBEAT wants no answer if nothing is missing");
}

#[test]
fn a_writer_that_stays_silent_is_asked_again_ever_more_rarely() {
    let mut ear = Ear::synchronized();
    ear.hear(heartbeat(1, 2, true));
    let begin = ear.now;
    let mut asked = Vec::new();
    for _ in 0..10 {
        assert_eq!(acknack(&ear.next_answers()).map(|(_, missing, _)| missing), Some(vec![1, 2]));
        asked.push((ear.now - begin) / 1000);
    }
    assert_eq!(asked, [1, 21, 61, 141, 301, 621, 1261, 2261, 3261, 4261]);
    // HEARTBEATs without effect do not make it ask more often than this.
    let begin = ear.now;
    ear.hear(heartbeat(1, 2, false));
    ear.next_answers();
    assert_eq!(ear.now - begin, 10_000);
}

#[test]
fn what_the_writer_no_longer_has_is_lost() {
    let mut ear = Ear::synchronized();
    ear.hear(data(3));
    let delivered = ear.hear(heartbeat(5, 6, true));
    assert_eq!((numbers(&delivered), lost(&delivered)), (vec![3], vec![(3, LossReason::Gone)]));
    assert_eq!(acknack(&ear.next_answers()), Some((5, vec![5, 6], false)));
}

#[test]
fn gaps_of_any_length_are_passed_over_at_once() {
    let mut ear = Ear::synchronized();
    ear.hear(data(1_000_000_000_002));
    assert_eq!(numbers(&ear.hear(data(5))), [0; 0]);
    assert_eq!(lost(&ear.hear(gap(1, 5, &[7]))), []);
    assert_eq!(numbers(&ear.hear(data(6))), [6]);
    assert_eq!(
        numbers(&ear.hear(gap(8, 1_000_000_000_000, &[1_000_000_000_000, 1_000_000_000_001]))),
        [1_000_000_000_002]
    );
    ear.hear(heartbeat(1, 1_000_000_000_003, false));
    assert_eq!(acknack(&ear.next_answers()), Some((1_000_000_000_003, vec![1_000_000_000_003], false)));
}

#[test]
fn numbers_at_the_ends_of_their_range_are_harmless() {
    let ends = [i64::MIN, -1, 0, 1, (1 << 62) - 1, 1 << 62, (1 << 62) + 1, i64::MAX - 1, i64::MAX];
    for (mut ear, first) in [Ear::synchronized(), Ear::reliable(), Ear::best_effort()].into_iter().zip([1, 2, 3]) {
        for a in ends {
            for b in ends {
                ear.hear(data(a));
                ear.hear(heartbeat(a, b, false));
                ear.hear(Submessage::Gap(Gap {
                    reader: READER,
                    writer: WRITER,
                    start: SequenceNumber(a),
                    list: NumberSet { base: b, bits: u32::MAX, bitmap: [u32::MAX; 8] },
                }));
                ear.hear(Submessage::DataFrag(DataFrag { sequence: SequenceNumber(b), ..fragment(first, 5000, 1, 1) }));
                ear.now += 10_000;
                ear.answers();
            }
        }
    }
}

#[test]
fn a_reader_without_history_gets_nothing_from_before_the_match_but_what_came_of_it() {
    let durable = || Ear::with(Reliability::Reliable, Durability::Volatile, true, peer(true));
    let without = || Ear::with(Reliability::Reliable, Durability::Volatile, true, peer(false));
    for mut ear in [durable(), without()] {
        assert_eq!(numbers(&ear.hear(data(8))), [0; 0], "the first HEARTBEAT decides");
        ear.hear(Submessage::DataFrag(fragment(9, 2500, 1, 1)));
        let delivered = ear.hear(heartbeat(1, 10, true));
        assert_eq!((numbers(&delivered), lost(&delivered)), (vec![8], vec![]));
        let answers = ear.next_answers();
        assert_eq!((acknack(&answers), nack_frags(&answers)), (Some((9, vec![], false)), vec![(9, vec![2, 3])]));
        assert_eq!(numbers(&ear.hear(data(10))), [0; 0]);
        ear.hear(data(11));
        assert_eq!(
            numbers(&ear.hear(Submessage::DataFrag(fragment(9, 2500, 2, 2)))),
            [9, 10, 11],
            "it had come by then"
        );
        assert_eq!(numbers(&ear.hear(data(7))), [0; 0]);
    }
    let mut ear = durable();
    ear.hear(heartbeat(1, 10, true));
    assert_eq!(numbers(&ear.hear(data(10))), [0; 0]);
    assert_eq!(numbers(&ear.hear(data(11))), [11]);
}

#[test]
fn others_ask_for_everything_that_the_writer_has() {
    let service = Ear::with(Reliability::Reliable, Durability::Volatile, false, peer(false));
    let durable = Ear::with(Reliability::Reliable, Durability::TransientLocal, false, peer(true));
    for mut ear in [service, durable] {
        ear.answers();
        assert_eq!(lost(&ear.hear(heartbeat(4, 6, true))), [], "what was gone before the match is not lost");
        assert_eq!(acknack(&ear.next_answers()), Some((4, vec![4, 5, 6], false)));
    }
}

#[test]
fn a_best_effort_reader_delivers_what_is_newer_and_counts_what_did_not_come() {
    let mut ear = Ear::best_effort();
    assert_eq!((ear.reader.deadline(), ear.answers()), (None, vec![]));
    assert_eq!(ear.hear(data(5)).len(), 1);
    assert_eq!(numbers(&ear.hear(data(5))), [0; 0]);
    ear.hear(Submessage::DataFrag(fragment(7, 2000, 1, 1)));
    let delivered = ear.hear(data(9));
    assert_eq!(
        (numbers(&delivered), lost(&delivered)),
        (vec![9], vec![(1, LossReason::Incomplete), (2, LossReason::BestEffort)])
    );
    assert_eq!(ear.bytes(), 0, "older samples in assembly are given up");
    assert_eq!(numbers(&ear.hear(Submessage::DataFrag(fragment(7, 2000, 2, 1)))), [0; 0]);
    assert_eq!(ear.hear(data(8)), []);
    assert_eq!((ear.hear(heartbeat(1, 20, false)), ear.answers()), (vec![], vec![]));
}

#[test]
fn a_writer_that_keeps_coming_below_the_watermark_is_heard_again() {
    for (forged, without_history) in [
        (heartbeat(1 << 40, 1 << 41, true), true),
        (heartbeat(1 << 40, 1 << 41, true), false),
        (gap(1, 1 << 50, &[]), true),
        (gap(1, 1 << 50, &[]), false),
    ] {
        let mut ear = Ear::with(Reliability::Reliable, Durability::Volatile, without_history, peer(false));
        ear.hear(heartbeat(1, 0, true));
        (1..=10).for_each(|number| assert_eq!(numbers(&ear.hear(data(number))), [number]));
        ear.hear(forged);
        // A forged sample as well.
        ear.hear(data(1 << 41));
        ear.hear(data(1 << 50));
        let mut delivered = Vec::new();
        for number in 11..=30 {
            ear.now += 40_000;
            delivered.extend(ear.hear(data(number)));
            delivered.extend(ear.hear(heartbeat(1, number, true)));
            for answer in ear.answers() {
                let Submessage::AckNack(acknack) = answer else { continue };
                acknack.missing.iter().for_each(|missing| delivered.extend(ear.hear(data(missing))));
            }
        }
        let warned = |delivered: &&Delivered| matches!(delivered, Delivered::Resynchronized { .. });
        assert_eq!(delivered.iter().filter(warned).count(), 1);
        let heard = numbers(&delivered);
        let expected: Vec<i64> = if without_history { (14..=30).collect() } else { (11..=30).collect() };
        assert_eq!(heard, expected, "each once, and what was skipped as far as it is asked for");
    }
}

#[test]
fn a_best_effort_writer_that_keeps_coming_below_the_watermark_is_heard_again() {
    let mut ear = Ear::best_effort();
    (1..=10).for_each(|number| assert_eq!(numbers(&ear.hear(data(number))), [number]));
    assert_eq!(numbers(&ear.hear(data(1 << 40))), [1 << 40]);
    let mut heard = Vec::new();
    for number in 9..=20 {
        ear.now += 40_000;
        heard.extend(numbers(&ear.hear(data(number))));
    }
    assert_eq!(heard, (14..=20).collect::<Vec<i64>>());
}

#[test]
fn late_samples_do_not_look_like_a_writer_below_the_watermark() {
    let mut ear = Ear::best_effort();
    ear.hear(data(100));
    for number in 90..99 {
        assert_eq!(ear.hear(data(number)), []);
    }
    let mut ear = Ear::synchronized();
    (1..=100).for_each(|number| assert_eq!(numbers(&ear.hear(data(number))), [number]));
    for last in 50..90 {
        assert_eq!(ear.hear(heartbeat(1, last, false)), []);
    }
    assert_eq!(acknack(&ear.next_answers()), Some((101, vec![], true)));
}

#[test]
fn the_end_of_an_instance_is_told_with_its_key_or_its_hash() {
    let mut ear = Ear::synchronized();
    let mut end = |number, payload, key_hash| {
        let inline_qos = InlineQos { related: None, status: 3, key_hash };
        let (reader, sequence) = (READER, SequenceNumber(number));
        ear.hear(Submessage::Data(Data { reader, writer: WRITER, sequence, inline_qos, payload }))
    };
    let key = Bytes::from_static(b"key");
    assert_eq!(
        end(1, Payload::Key(key.clone()), Some([1; 16])),
        [Delivered::Disposed { writer: GUID, key: DisposedKey::Serialized(key) }]
    );
    assert_eq!(
        end(2, Payload::None, Some([1; 16])),
        [Delivered::Disposed { writer: GUID, key: DisposedKey::Hash([1; 16]) }]
    );
    assert_eq!(end(3, Payload::None, None), [Delivered::Disposed { writer: GUID, key: DisposedKey::Unknown }]);
}

#[test]
fn only_matched_writers_and_messages_for_this_reader_count() {
    let mut ear = Ear::synchronized();
    assert_eq!(ear.hear_from(GuidPrefix([8; 12]), data(1)), []);
    let Submessage::Data(other) = data(1) else { unreachable!() };
    assert_eq!(ear.hear(Submessage::Data(Data { reader: EntityId([0, 0, 2, 4]), ..other.clone() })), []);
    assert_eq!(ear.hear(Submessage::Data(Data { reader: READER, ..other })).len(), 1);
    ear.reader.remove_writer(GUID);
    assert_eq!(ear.hear(data(2)), []);
    ear.now += 100_000_000;
    assert_eq!(ear.answers(), []);
}

#[test]
fn an_absurd_heartbeat_asks_for_a_bounded_number_of_samples_until_a_true_one_comes() {
    let mut ear = Ear::synchronized();
    ear.hear(heartbeat(1, 1 << 60, true));
    assert_eq!(acknack(&ear.next_answers()).map(|(base, missing, _)| (base, missing.len())), Some((1, 256)));
    ear.hear(heartbeat(1, 2, true));
    assert_eq!(acknack(&ear.next_answers()), Some((1, vec![1, 2], false)));
}
