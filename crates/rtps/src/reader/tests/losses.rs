//! Losses are counted with their reason, and once.

use super::*;
use crate::limits::{ASSEMBLY_MICROS_MAX, SAMPLE_BYTES_MAX};

fn too_large(number: i64) -> Submessage {
    let sample_bytes = u32::try_from(SAMPLE_BYTES_MAX).unwrap() + 1;
    Submessage::DataFrag(DataFrag { sample_bytes, ..fragment(number, 5000, 1, 1) })
}

/// All losses of these submessages.
fn all_lost(ear: &mut Ear, submessages: &[Submessage]) -> Vec<(u64, LossReason)> {
    submessages.iter().flat_map(|submessage| lost(&ear.hear(submessage.clone()))).collect()
}

#[test]
fn samples_that_a_gap_takes_from_a_reliable_reader_are_lost_and_those_from_before_the_match_are_not() {
    let mut ear = Ear::reliable();
    assert_eq!(all_lost(&mut ear, &[heartbeat(1, 10, true), gap(1, 11, &[])]), [], "from before the match");
    assert_eq!(all_lost(&mut ear, &[data(11), heartbeat(1, 15, true), data(13)]), []);
    assert_eq!(all_lost(&mut ear, &[gap(11, 13, &[15])]), [(1, LossReason::Gone)], "12; it has 11 and 13");
    assert_eq!(all_lost(&mut ear, &[data(14)]), [(1, LossReason::Gone)], "15");
    assert_eq!(all_lost(&mut ear, &[gap(11, 16, &[])]), [], "each counts once");
}

#[test]
fn what_a_gap_takes_before_a_heartbeat_announces_it_is_counted_when_it_does() {
    let mut ear = Ear::synchronized();
    assert_eq!(
        all_lost(&mut ear, &[gap(1, 4, &[]), too_large(4), too_large(6), gap(5, 8, &[])]),
        [(1, LossReason::TooLarge), (1, LossReason::TooLarge)]
    );
    assert_eq!(numbers(&ear.hear(data(8))), [8]);
    assert_eq!(all_lost(&mut ear, &[heartbeat(1, 2, true)]), [(2, LossReason::Gone)]);
    assert_eq!(all_lost(&mut ear, &[heartbeat(1, 8, true)]), [(3, LossReason::Gone)], "3, 5, 7");
    assert_eq!(all_lost(&mut ear, &[heartbeat(1, 8, true)]), []);
    // Of numbers that nobody has announced nothing is lost.
    assert_eq!(all_lost(&mut ear, &[gap(9, 1 << 60, &[])]), []);
}

#[test]
fn history_that_a_durable_reader_misses_is_lost_and_that_of_a_volatile_one_is_not() {
    for (durability, expected) in
        [(Durability::TransientLocal, vec![(2, LossReason::Gone)]), (Durability::Volatile, vec![])]
    {
        let mut ear = Ear::with(Reliability::Reliable, durability, false, peer(true));
        assert_eq!(all_lost(&mut ear, &[heartbeat(5, 10, true), heartbeat(7, 10, true)]), expected);
        assert_eq!(all_lost(&mut ear, &[heartbeat(7, 20, true), heartbeat(13, 20, true)])[0].1, LossReason::Gone);
    }
}

#[test]
fn a_sample_that_is_too_large_is_counted_once() {
    for mut ear in [Ear::synchronized(), Ear::best_effort()] {
        let come = [data(1), too_large(2), too_large(3), too_large(2), data(4), heartbeat(1, 4, true)];
        let one = (1, LossReason::TooLarge);
        assert_eq!(all_lost(&mut ear, &come), [one, one]);
    }
}

#[test]
fn a_best_effort_sample_whose_fragments_stop_coming_is_given_up_and_counted_once() {
    let mut ear = Ear::best_effort();
    ear.hear(data(1));
    ear.hear(Submessage::DataFrag(fragment(3, 5000, 1, 2)));
    ear.now += ASSEMBLY_MICROS_MAX / 2;
    ear.hear(Submessage::DataFrag(fragment(3, 5000, 3, 1)));
    let (mut delivered, end) = (Vec::new(), ear.now + ASSEMBLY_MICROS_MAX);
    while delivered.is_empty() {
        ear.now = ear.reader.deadline().unwrap();
        ear.reader.poll(ear.at(), &mut Vec::new(), &mut delivered);
    }
    assert_eq!(ear.now, end);
    assert_eq!(lost(&delivered), [(1, LossReason::Incomplete)]);
    assert_eq!((ear.bytes(), ear.reader.deadline()), (0, None));
    assert_eq!(all_lost(&mut ear, &[Submessage::DataFrag(fragment(3, 5000, 4, 2))]), []);
    assert_eq!((ear.bytes(), all_lost(&mut ear, &[data(5)])), (0, vec![(2, LossReason::BestEffort)]), "2 and 4");
}

#[test]
fn best_effort_samples_for_which_there_is_no_room_are_counted_once() {
    let mut ear = Ear::best_effort();
    ear.hear(data(1));
    let many = i64::try_from(ASSEMBLY_SAMPLES_MAX).unwrap();
    let begun = |number| Submessage::DataFrag(fragment(number, 2000, 1, 1));
    let all: Vec<Submessage> = (2..many + 5).map(begun).collect();
    assert_eq!(all_lost(&mut ear, &all), [(1, LossReason::NoRoom); 3]);
    let last = many + 5;
    let rest = u64::try_from(last).unwrap() - 2 - 3;
    assert_eq!(all_lost(&mut ear, &[begun(2), data(last)]), [(rest, LossReason::Incomplete)]);
}

#[test]
fn a_deadline_without_a_sample_is_reported_as_long_as_there_is_a_writer() {
    let qos = Qos { deadline: Ticks::from_micros(100_000), ..Qos::default() };
    let mut ear = Ear { reader: Reader::new(READER, &qos, false), now: 1_000_000 };
    ear.reader.add_writer(ear.at(), peer(false));
    let missed = |ear: &mut Ear| {
        let mut delivered = Vec::new();
        ear.reader.poll(ear.at(), &mut Vec::new(), &mut delivered);
        delivered
    };
    ear.hear(data(1));
    for number in 2..5 {
        ear.now += 99_000;
        assert_eq!(missed(&mut ear), []);
        ear.hear(data(number));
    }
    assert_eq!(ear.reader.deadline(), Some(ear.now + 100_000));
    ear.now += 250_000;
    assert_eq!(missed(&mut ear), [Delivered::DeadlineMissed { count: 2 }]);
    ear.reader.remove_writer(GUID);
    ear.now += 250_000;
    assert_eq!((missed(&mut ear), ear.reader.deadline()), (vec![], None));
}

#[test]
fn ranges_that_will_not_come_do_not_keep_the_lowest_from_being_passed_over() {
    let mut ear = Ear::synchronized();
    ear.hear(heartbeat(1, 10_000, true));
    for number in (100..10_000).step_by(2) {
        ear.hear(gap(number, number + 1, &[]));
    }
    assert_eq!(numbers(&ear.hear(data(3))), [0; 0]);
    assert_eq!(numbers(&ear.hear(gap(1, 3, &[]))), [3]);
}

#[test]
fn a_writer_whose_samples_or_fragments_keep_coming_below_the_watermark_is_heard_again_also_without_heartbeats() {
    for is_fragmented in [false, true] {
        for forged in [gap(1, 1 << 50, &[]), heartbeat(1 << 40, 1 << 41, true)] {
            for mut ear in [Ear::synchronized(), Ear::best_effort()] {
                let come = |number| {
                    if is_fragmented { Submessage::DataFrag(fragment(number, 900, 1, 1)) } else { data(number) }
                };
                (1..=10).for_each(|number| assert_eq!(numbers(&ear.hear(come(number))), [number]));
                ear.hear(forged.clone());
                if !ear.reader.is_reliable {
                    ear.hear(come(1 << 50));
                }
                let mut delivered = Vec::new();
                for number in 11..=20 {
                    ear.now += 50_000;
                    delivered.extend(ear.hear(come(number)));
                }
                // A reliable reader asks for a HEARTBEAT, and has kept what came.
                if ear.reader.is_reliable {
                    assert_eq!(acknack(&ear.answers()).map(|(base, ..)| base), Some(1));
                    delivered.extend(ear.hear(heartbeat(13, 20, true)));
                }
                let warned = |delivered: &&Delivered| matches!(delivered, Delivered::Resynchronized { .. });
                assert_eq!(delivered.iter().filter(warned).count(), 1);
                assert_eq!(numbers(&delivered), (13..=20).collect::<Vec<_>>());
            }
        }
    }
}
