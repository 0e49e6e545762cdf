//! Long requests are answered in runs.

use super::*;

#[test]
fn requested_fragments_go_out_in_runs_as_far_as_they_exist_and_a_heartbeat_follows() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    writer.write(at(0), sample(200 * 1344));
    run(&mut writer, 0, 5000);
    let all: Vec<i64> = (50..300).collect();
    receive(&mut writer, 5000, nack_frag(1, 1, 50, &all, 1));
    let first = poll(&mut writer, 6000);
    let first_run = REPAIR_BYTES / (1344 + 64) + 1;
    assert_eq!((fragments(&first).len(), heartbeats(&first)), (first_run, vec![]));
    let out = [first, run(&mut writer, 6000, 8000)].concat();
    let sent: Vec<u32> = fragments(&out).iter().map(|fragment| fragment.first).collect();
    assert_eq!((sent, heartbeats(&out)), ((50..=200).collect(), vec![(1, 1)]));
}

#[test]
fn requested_samples_go_out_in_runs_and_a_heartbeat_follows() {
    let mut writer = volatile(10);
    writer.add_reader(at(0), peer(1, true, false));
    for _ in 0..3 {
        writer.write(at(0), sample(70 * 1344));
    }
    run(&mut writer, 0, 5000);
    receive(&mut writer, 5000, acknack(1, 1, &[1, 3], 1, true));
    let out = run(&mut writer, 5000, 9000);
    let sent: Vec<_> = fragments(&out).iter().map(|fragment| (fragment.sequence.0, fragment.first)).collect();
    let wanted: Vec<_> =
        [1, 3].into_iter().flat_map(|sample| (1..=70).map(move |fragment| (sample, fragment))).collect();
    assert_eq!((sent, heartbeats(&out)), (wanted, vec![(1, 3)]));
}

#[test]
fn repairs_of_many_readers_are_paced_together() {
    let mut writer = durable(1);
    writer.write(at(0), sample(1 << 20));
    run(&mut writer, 0, 10_000);
    for reader in 1..=10 {
        writer.add_reader(at(20_000), peer(reader, true, true));
        receive(&mut writer, 20_000, acknack(reader, 1, &[1], 1, true));
    }
    for step in 0..10 {
        let out = poll(&mut writer, 30_000 + step * BURST_PAUSE_MICROS);
        assert!(
            out.iter().flat_map(|out| &out.submessages).map(message::bytes_of).sum::<usize>() < REPAIR_BYTES + 10_000
        );
        assert!(!fragments(&out).is_empty());
    }
}

#[test]
fn a_reader_that_requests_what_it_acknowledged_gets_it_again() {
    let mut writer = durable(10);
    writer.add_reader(at(0), peer(1, true, true));
    for _ in 0..3 {
        writer.write(at(0), sample(10));
    }
    poll(&mut writer, 0);
    receive(&mut writer, 0, acknack(1, 4, &[], 1, true));
    assert!(writer.is_acknowledged());
    receive(&mut writer, 20_000, acknack(1, 1, &[1, 2, 3], 2, true));
    assert!(!writer.is_acknowledged());
    assert_eq!(numbers(&poll(&mut writer, 30_000)), [1, 2, 3]);
}

#[test]
fn a_late_reader_of_a_writer_that_has_written_a_million_samples_costs_one_heartbeat_and_few_bytes() {
    for is_durable in [false, true] {
        let mut writer = durable(3);
        for _ in 0..1_000_000 {
            writer.write(at(0), sample(0));
        }
        run(&mut writer, 0, 1000);
        writer.add_reader(at(1000), peer(1, true, is_durable));
        let out = poll(&mut writer, 1000);
        assert_eq!((numbers(&out), heartbeats(&out)), (vec![], vec![(999_998, 1_000_000)]));
        assert!(submessages(&out).len() <= 2);
        receive(&mut writer, 2000, acknack(1, 1, &(1..257).collect::<Vec<_>>(), 1, false));
        let out = run(&mut writer, 2000, 9000);
        assert_eq!((numbers(&out), gaps(&out).len(), heartbeats(&out).len()), (vec![], 0, 1));
    }
}

#[test]
fn an_answer_while_a_sample_is_being_pushed_does_not_announce_it() {
    let mut writer = durable(10);
    writer.add_reader(at(0), peer(1, true, true));
    writer.write(at(0), sample(10));
    poll(&mut writer, 0);
    writer.write(at(20_000), sample(1 << 20));
    poll(&mut writer, 20_000);
    receive(&mut writer, 20_000, acknack(1, 1, &[1], 1, false));
    let mut out = Vec::new();
    for micros in (20_050..21_200).step_by(50) {
        out.extend(poll(&mut writer, micros));
    }
    assert!(fragments(&out).len() > 50 && !writer.is_acknowledged());
    assert_eq!((numbers(&out), heartbeats(&out)), (vec![1], vec![(1, 1)]));
}

#[test]
fn samples_that_all_reliable_readers_have_are_not_lost_when_newer_ones_replace_them() {
    let mut writer = durable(3);
    writer.add_reader(at(0), peer(1, true, true));
    for number in 1..=10 {
        writer.write(at(0), sample(10));
        poll(&mut writer, 0);
        receive(&mut writer, 0, acknack(1, number + 1, &[], i32::try_from(number).unwrap(), true));
    }
    assert_eq!(writer.losses(), WriterLosses::default());
    for _ in 0..5 {
        writer.write(at(0), sample(10));
        poll(&mut writer, 0);
    }
    assert_eq!(writer.losses(), WriterLosses { replaced: 2, pushed_out: 0 });
}
