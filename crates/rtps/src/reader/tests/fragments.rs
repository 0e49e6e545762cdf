//! Fragments, and what they may take.

use super::*;

#[test]
fn fragments_make_a_sample_in_any_order_with_the_inline_qos_of_any_of_them() {
    let related = Some(SampleIdentity { writer: GUID, sequence: SequenceNumber(3) });
    for order in [[1, 2, 3, 4, 5], [5, 4, 3, 2, 1], [3, 5, 1, 2, 4]] {
        for mut ear in [Ear::synchronized(), Ear::best_effort()] {
            let mut delivered = Vec::new();
            for first in order {
                let mut fragment = fragment(1, 4321, first, 1);
                if first == 1 {
                    fragment.inline_qos.related = related;
                }
                delivered.extend(ear.hear(Submessage::DataFrag(fragment.clone())));
                delivered.extend(ear.hear(Submessage::DataFrag(fragment)));
            }
            let Some(Delivered::Sample(sample)) = delivered.pop() else { unreachable!() };
            assert_eq!((sample.payload, sample.related, sample.timestamp), (content(4321), related, Some(Ticks(9))));
            assert_eq!((delivered.len(), ear.bytes()), (0, 0));
        }
    }
}

#[test]
fn missing_fragments_are_requested_after_a_heartbeat_or_when_they_stop_coming() {
    let mut ear = Ear::synchronized();
    ear.hear(Submessage::DataFrag(fragment(1, 5000, 2, 2)));
    assert_eq!(ear.answers(), []);
    ear.hear(heartbeat(1, 2, true));
    let answers = ear.next_answers();
    assert_eq!((acknack(&answers), nack_frags(&answers)), (Some((1, vec![2], false)), vec![(1, vec![1, 4, 5])]));
    ear.hear(Submessage::DataFrag(fragment(1, 5000, 4, 2)));
    let heartbeat = HeartbeatFrag { reader: READER, writer: WRITER, sequence: SequenceNumber(1), last: 5, count: 1 };
    ear.hear(Submessage::HeartbeatFrag(heartbeat));
    assert_eq!(nack_frags(&ear.next_answers()), [(1, vec![1])]);
    let mut ear = Ear::synchronized();
    ear.hear(Submessage::DataFrag(fragment(1, 5000, 1, 1)));
    ear.now += 50_000;
    ear.hear(Submessage::DataFrag(fragment(1, 5000, 2, 1)));
    let begin = ear.now;
    while nack_frags(&ear.next_answers()) != [(1, vec![3, 4, 5])] {}
    assert_eq!(ear.now - begin, 100_000);
}

#[test]
fn fragments_of_other_sizes_are_ignored_unless_most_are() {
    let mut ear = Ear::synchronized();
    ear.hear(Submessage::DataFrag(fragment(1, 3000, 1, 2)));
    let other = |first| Submessage::DataFrag(DataFrag { sample_bytes: 4000, ..fragment(1, 3000, first, 1) });
    assert_eq!(numbers(&ear.hear(other(3))), [0; 0]);
    assert_eq!(numbers(&ear.hear(Submessage::DataFrag(fragment(1, 3000, 3, 1)))), [1]);
    ear.hear(Submessage::DataFrag(DataFrag { sample_bytes: 4000, ..fragment(2, 3000, 1, 1) }));
    let mut delivered = Vec::new();
    for _ in 0..3 {
        for first in 1..=3 {
            delivered.extend(ear.hear(Submessage::DataFrag(fragment(2, 3000, first, 1))));
        }
    }
    assert_eq!(numbers(&delivered), [2]);
}

#[test]
fn a_sample_that_is_too_large_is_passed_over() {
    let huge = |number| Submessage::DataFrag(DataFrag { sample_bytes: u32::MAX, ..fragment(number, 5000, 1, 1) });
    for mut ear in [Ear::synchronized(), Ear::best_effort()] {
        assert_eq!(lost(&ear.hear(huge(1))), [(1, LossReason::TooLarge)]);
        assert_eq!(lost(&ear.hear(huge(1))), []);
        assert_eq!((ear.bytes(), numbers(&ear.hear(data(2)))), (0, vec![2]));
    }
}

#[test]
fn what_waits_takes_the_bytes_that_have_come_within_the_limits() {
    // Claims cost nothing: each is of 16 MiB, and one fragment of it came, at its end.
    for mut ear in [Ear::synchronized(), Ear::best_effort()] {
        for number in 2..10_000 {
            let last = DataFrag { sample_bytes: 16 << 20, first: 16_777, ..fragment(number, 1000, 1, 1) };
            ear.hear(Submessage::DataFrag(last));
        }
        assert!(ear.bytes() <= ASSEMBLY_SAMPLES_MAX * 2200, "{}", ear.bytes());
    }
    // Bytes are bounded, and the lowest number always fits.
    let mut ear = Ear::synchronized();
    for number in 1..=6 {
        for first in 2..=10_000 {
            ear.hear(Submessage::DataFrag(DataFrag {
                sample_bytes: 10_000_000,
                payload: Bytes::from_static(&[0; 1000]),
                first,
                ..fragment(number, 1000, 1, 1)
            }));
            assert!(ear.bytes() <= ASSEMBLY_BYTES_MAX);
        }
    }
    let first = DataFrag { sample_bytes: 10_000_000, ..fragment(1, 1000, 1, 1) };
    assert_eq!(numbers(&ear.hear(Submessage::DataFrag(first))), [1]);
}

#[test]
fn what_was_dropped_for_want_of_room_is_requested_again() {
    let mut ear = Ear::synchronized();
    let many = i64::try_from(ASSEMBLY_SAMPLES_MAX).unwrap() + 500;
    (2..=many).for_each(|number| assert_eq!(ear.hear(data(number)), []));
    ear.hear(heartbeat(1, many, true));
    assert_eq!(acknack(&ear.next_answers()), Some((1, vec![1], false)));
    let delivered = numbers(&ear.hear(data(1)));
    let next = i64::try_from(delivered.len()).unwrap() + 1;
    assert_eq!((delivered.len(), ear.bytes()), (ASSEMBLY_SAMPLES_MAX + 1, 0));
    ear.hear(heartbeat(1, many, true));
    assert_eq!(acknack(&ear.next_answers()).map(|(base, missing, _)| (base, missing.len())), Some((next, 256)));
}

#[test]
fn the_lifespan_that_a_reader_requests_ends_no_sample_whatever_its_time_is() {
    for reliability in [Reliability::Reliable, Reliability::BestEffort] {
        let qos = Qos { reliability, lifespan: Ticks::from_micros(1), ..Qos::default() };
        let mut ear = Ear { reader: Reader::new(READER, &qos, false), now: 1_000_000_000 };
        ear.reader.add_writer(ear.at(), peer(false));
        ear.hear(heartbeat(1, 0, true));
        for first in 1..=5 {
            ear.now += 50_000;
            // The time of these samples is nine ticks after 1970.
            let delivered = ear.hear(Submessage::DataFrag(fragment(1, 4321, first, 1)));
            assert_eq!(numbers(&delivered).len(), usize::from(first == 5));
        }
    }
}
