//! Writers share the bytes of a reader, and readers those of a participant.

use super::*;
use crate::limits::{ASSEMBLY_MICROS_MAX, READER_BYTES_MAX};
use std::collections::BTreeSet;

/// Bytes of the large samples of these tests, in fragments of 1000, and the limits of the reader.
const SAMPLE: usize = 100_000;
const WRITER_ROOM: usize = 220_000;
const ROOM: usize = 440_000;

/// A reader with many writers; the last byte of their prefixes is their number.
struct Crowd {
    reader: Reader,
    now: u64,
    delivered: Vec<(u8, i64)>,
    lost: Vec<(u8, LossReason)>,
}

fn guid(writer: u8) -> Guid {
    Guid::new(GuidPrefix([writer; 12]), WRITER)
}

impl Crowd {
    fn new(reliability: Reliability, writers: u8) -> Self {
        let qos = Qos { reliability, ..Qos::default() };
        let reader = Reader::new(READER, &qos, false).with_room(WRITER_ROOM, ROOM);
        let mut crowd = Self { reader, now: 1_000_000, delivered: Vec::new(), lost: Vec::new() };
        for writer in 1..=writers {
            crowd.reader.add_writer(crowd.at(), Peer { guid: guid(writer), ..peer(false) });
            crowd.hear(writer, heartbeat(1, 0, true));
        }
        crowd
    }

    fn at(&self) -> Now {
        Now { steady: self.now, wall: 0 }
    }

    fn hear(&mut self, writer: u8, submessage: Submessage) {
        let (mut out, source) = (Vec::new(), guid(writer).prefix);
        let message = Addressed { source, destination: GuidPrefix::UNKNOWN, timestamp: None, submessage };
        self.reader.receive(self.at(), &message, &mut out);
        assert!(self.reader.held() <= ROOM.max(READER_BYTES_MAX.min(self.reader.room)));
        let held: usize = self.reader.writers.values().map(|matched| matched.proxy.store().bytes()).sum();
        assert_eq!(self.reader.held(), held);
        for delivered in out {
            match delivered {
                Delivered::Sample(sample) => self.delivered.push((sample.writer.prefix.0[0], sample.sequence.0)),
                Delivered::Lost { writer, reason, .. } => self.lost.push((writer.prefix.0[0], reason)),
                _ => {}
            }
        }
    }

    fn fragment(&mut self, writer: u8, number: i64, first: u32) {
        self.hear(writer, Submessage::DataFrag(fragment(number, SAMPLE, first, 1)));
    }

    /// The requests of the reader: the writer, a sample, and its fragments.
    fn requests(&mut self) -> Vec<(u8, i64, Vec<i64>)> {
        let mut out = Vec::new();
        self.reader.poll(self.at(), &mut out, &mut Vec::new());
        let mut requests = Vec::new();
        for outgoing in out {
            let writer = outgoing.destination.0[0];
            for submessage in outgoing.submessages {
                match submessage {
                    Submessage::AckNack(acknack) => {
                        requests.extend(acknack.missing.iter().map(|number| (writer, number, (1..=100).collect())));
                    }
                    Submessage::NackFrag(nack) => {
                        requests.push((writer, nack.sequence.0, nack.missing.iter().collect()));
                    }
                    _ => {}
                }
            }
        }
        requests
    }
}

#[test]
fn a_writer_that_sends_much_takes_nothing_from_one_that_sends_little() {
    for reliability in [Reliability::Reliable, Reliability::BestEffort] {
        let mut crowd = Crowd::new(reliability, 4);
        // Writer 4 sends one large sample, slowly. The others send fragments of many that are never whole.
        for first in 1..=100 {
            for hog in 1..=3 {
                for number in 1..=20 {
                    crowd.fragment(hog, number + i64::from(first) * 3, first.max(2));
                }
            }
            crowd.now += 20_000;
            crowd.fragment(4, 1, first);
        }
        assert_eq!(crowd.delivered, [(4, 1)]);
        assert!(crowd.lost.iter().all(|(writer, reason)| *writer < 4 && *reason == LossReason::NoRoom));
        assert_eq!(
            crowd.lost.is_empty(),
            reliability == Reliability::Reliable,
            "what can be requested again is not lost"
        );
    }
}

#[test]
fn large_samples_of_more_writers_than_have_room_all_arrive_one_after_the_other() {
    let mut crowd = Crowd::new(Reliability::Reliable, 30);
    for first in 1..=100 {
        crowd.now += 100;
        (1..=30).for_each(|writer| crowd.fragment(writer, 1, first));
    }
    for writer in 1..=30 {
        crowd.hear(writer, heartbeat(1, 1, false));
    }
    let begin = crowd.now;
    while crowd.delivered.len() < 30 {
        crowd.now = crowd.reader.deadline().unwrap().max(crowd.now);
        for (writer, number, fragments) in crowd.requests() {
            fragments.into_iter().for_each(|first| crowd.fragment(writer, number, u32::try_from(first).unwrap()));
        }
        assert!(crowd.now - begin < 30_000_000, "only {:?} have arrived", crowd.delivered);
    }
    let writers: BTreeSet<u8> = crowd.delivered.iter().map(|(writer, _)| *writer).collect();
    assert_eq!((writers.len(), crowd.reader.held(), crowd.lost.len()), (30, 0, 0));
}

#[test]
fn the_sample_that_was_begun_first_is_completed_without_repair() {
    for reliability in [Reliability::Reliable, Reliability::BestEffort] {
        let mut crowd = Crowd::new(reliability, 6);
        for first in 1..=100 {
            for writer in 1..=6 {
                crowd.now += 10;
                crowd.fragment(writer, 1, first);
            }
        }
        assert_eq!(crowd.delivered.first(), Some(&(1, 1)));
    }
}

#[test]
fn samples_that_never_become_whole_give_way_after_a_while() {
    let mut crowd = Crowd::new(Reliability::Reliable, 10);
    // Three writers take all the room, and keep their samples alive.
    for first in 2..=100 {
        (1..=3).for_each(|hog| crowd.fragment(hog, 1, first));
    }
    for first in 2..=40 {
        (1..=3).for_each(|hog| crowd.fragment(hog, 2, first));
    }
    crowd.now += ASSEMBLY_MICROS_MAX + 1;
    for hog in 1..=3 {
        crowd.fragment(hog, 2, 41);
    }
    for first in 1..=100 {
        crowd.fragment(9, 1, first);
    }
    assert_eq!(crowd.delivered, [(9, 1)]);
}

#[test]
fn a_writer_that_goes_leaves_its_bytes_to_the_others() {
    let mut crowd = Crowd::new(Reliability::Reliable, 3);
    for first in 2..=100 {
        (1..=3).for_each(|writer| crowd.fragment(writer, 1, first));
    }
    let before = crowd.reader.held();
    (1..=2).for_each(|writer| crowd.reader.remove_writer(guid(writer)));
    assert!((1..before / 2).contains(&crowd.reader.held()));
    crowd.reader.remove_writer(guid(3));
    assert_eq!(crowd.reader.held(), 0);
}

#[test]
fn readers_share_a_limit_and_one_within_its_share_loses_nothing() {
    let mut crowds: Vec<Crowd> = (0..4).map(|_| Crowd::new(Reliability::BestEffort, 2)).collect();
    for crowd in crowds.iter_mut().take(3) {
        for first in 2..=90 {
            (1..=2).for_each(|writer| crowd.fragment(writer, 1, first));
        }
    }
    for first in 2..=30 {
        crowds[3].fragment(1, 1, first);
    }
    let held: Vec<usize> = crowds.iter().map(|crowd| crowd.reader.held()).collect();
    let limit = held.iter().sum::<usize>() / 2;
    let now = crowds[0].now;
    let mut delivered: [Vec<Delivered>; 4] = Default::default();
    let mut readers: Vec<_> = crowds.iter_mut().map(|crowd| &mut crowd.reader).zip(&mut delivered).collect();
    share(now, limit, &mut readers);
    let after: Vec<usize> = crowds.iter().map(|crowd| crowd.reader.held()).collect();
    assert!(after.iter().sum::<usize>() <= limit, "{held:?} {after:?}");
    assert_eq!((after[3], delivered[3].len()), (held[3], 0));
    assert!(delivered.iter().flatten().all(|lost| matches!(lost, Delivered::Lost { reason: LossReason::NoRoom, .. })));
    let mut readers: Vec<_> = crowds.iter_mut().map(|crowd| &mut crowd.reader).zip(&mut delivered).collect();
    share(now, limit, &mut readers);
    assert_eq!(after, crowds.iter().map(|crowd| crowd.reader.held()).collect::<Vec<_>>());
}
