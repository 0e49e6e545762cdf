use super::*;
use ledger_base::hash::Hash;

const SALMA: Source = [1; 16];
const RELAY: Source = [2; 16];
const BRIDGE: Source = [3; 16];
const NETWORK: Hash = Hash([9; 32]);

fn mark(service: &str) -> Mark {
    Mark::new(&NETWORK, service)
}

fn filter() -> (LoopFilter, Arc<Delivered>, Instant) {
    let delivered = Arc::new(Delivered::default());
    let filter = LoopFilter::new(mark("T/cmd_vel"), "T/cmd_vel", Duration::from_millis(300), Arc::clone(&delivered));
    (filter, delivered, Instant::now())
}

fn millis(count: u64) -> Duration {
    Duration::from_millis(count)
}

#[test]
fn what_a_bridge_of_the_network_published_is_never_taken_in() {
    let (filter, _, now) = filter();
    for service in ["T/cmd_vel", "Other/image"] {
        assert_eq!(filter.judge(BRIDGE, Some(mark(service)), b"x", now), Entry::FromBridge);
    }
    assert_eq!(filter.returned(), 2);
    let stranger = Mark::new(&Hash([8; 32]), "T/cmd_vel");
    assert_eq!(
        filter.judge([4; 16], Some(stranger), b"y", now),
        Entry::Admit,
        "another network's is a message like others"
    );
}

#[test]
fn constant_commands_pass_while_a_bridge_delivers_them_to_the_same_graph() {
    let (filter, delivered, start) = filter();
    delivered.begins(mark("T/cmd_vel"));
    for number in 0..500 {
        let now = start + millis(20 * number);
        assert_eq!(filter.judge(SALMA, None, b"ahead", now), Entry::Admit, "sample {number}");
        delivered.note(mark("T/cmd_vel"), b"ahead", now + millis(5));
    }
    // A source may also do what others did just before.
    let now = start + millis(10_000);
    delivered.note(mark("T/cmd_vel"), b"stop", now);
    assert_eq!(filter.judge(SALMA, None, b"stop", now + millis(1)), Entry::Admit);
}

#[test]
fn a_relay_of_what_was_delivered_is_not_taken_in() {
    let (filter, delivered, start) = filter();
    delivered.begins(mark("T/cmd_vel"));
    for number in 0..500u64 {
        let (now, payload) = (start + millis(20 * number), (number / 100).to_le_bytes());
        assert_eq!(filter.judge(SALMA, None, &payload, now), Entry::Admit);
        delivered.note(mark("T/cmd_vel"), &payload, now + millis(5));
        assert_eq!(filter.judge(RELAY, None, &payload, now + millis(6)), Entry::PassedOn, "sample {number}");
    }
    assert_eq!(filter.returned(), 500);
}

#[test]
fn a_relay_that_lags_behind_is_not_taken_in_either() {
    let (filter, delivered, start) = filter();
    delivered.begins(mark("T/cmd_vel"));
    for number in 0..500u64 {
        let now = start + millis(20 * number);
        assert_eq!(filter.judge(SALMA, None, b"ahead", now), Entry::Admit);
        delivered.note(mark("T/cmd_vel"), b"ahead", now + millis(5));
        if number >= 20 {
            assert_eq!(filter.judge(RELAY, None, b"ahead", now + millis(6)), Entry::PassedOn, "sample {number}");
        }
    }
}

#[test]
fn a_relay_is_known_by_what_another_sent_even_if_the_delivery_was_not_heard() {
    let (filter, delivered, now) = filter();
    delivered.begins(mark("T/cmd_vel"));
    assert_eq!(filter.judge(SALMA, None, b"ahead", now), Entry::Admit);
    assert_eq!(filter.judge(RELAY, None, b"ahead", now + millis(9)), Entry::PassedOn);
    assert_eq!(filter.judge(RELAY, None, b"ahead", now + millis(1100)), Entry::Admit, "this is no echo any more");
}

#[test]
fn one_message_of_a_quiet_publisher_passes_and_makes_no_loop() {
    let (filter, delivered, start) = filter();
    let service = mark("T/cmd_vel");
    delivered.begins(service);
    // Salma stood still for a moment and drives now; somebody else stops the robot with one message.
    for (payload, at) in [(b"stop", 0), (b"fast", 400)] {
        assert_eq!(filter.judge(SALMA, None, payload, start + millis(at)), Entry::Admit);
        delivered.note(service, payload, start + millis(at + 5));
    }
    assert_eq!(filter.judge([6; 16], None, b"stop", start + millis(500)), Entry::Admit);
    delivered.note(service, b"stop", start + millis(505));
    // Had it been a relay, that were the end of the loop.
    assert_eq!(filter.judge([6; 16], None, b"stop", start + millis(506)), Entry::PassedOn);
}

#[test]
fn who_repeats_more_often_than_deliveries_explain_is_a_source() {
    let (filter, delivered, now) = filter();
    delivered.begins(mark("T/cmd_vel"));
    delivered.note(mark("T/cmd_vel"), b"stop", now);
    assert_eq!(filter.judge([6; 16], None, b"stop", now + millis(1)), Entry::PassedOn);
    assert_eq!(filter.judge([6; 16], None, b"stop", now + millis(2)), Entry::Admit);
    delivered.note(mark("T/cmd_vel"), b"stop", now + millis(3));
    assert_eq!(filter.judge([6; 16], None, b"stop", now + millis(4)), Entry::Admit);
}

#[test]
fn what_another_bridge_delivered_on_the_same_topic_is_not_taken_from_a_relay() {
    let (filter, _, now) = filter();
    assert_eq!(filter.judge(BRIDGE, Some(mark("T/cmd_vel")), b"ahead", now), Entry::FromBridge);
    assert_eq!(filter.judge(RELAY, None, b"ahead", now + millis(1)), Entry::PassedOn);
    assert_eq!(filter.judge(RELAY, None, b"other", now + millis(2)), Entry::Admit, "this is its own");
}

#[test]
fn two_nodes_may_send_the_same_where_nothing_is_delivered() {
    let (filter, delivered, now) = filter();
    assert_eq!(filter.judge(SALMA, None, b"on", now), Entry::Admit);
    assert_eq!(filter.judge(RELAY, None, b"on", now + millis(1)), Entry::Admit);
    delivered.note(mark("T/image"), b"on", now);
    assert_eq!(filter.judge([5; 16], None, b"on", now + millis(2)), Entry::Admit, "another service was delivered");
}

#[test]
fn a_long_life_costs_bounded_memory() {
    let (filter, delivered, start) = filter();
    delivered.begins(mark("T/cmd_vel"));
    for number in 0..2 * PAYLOADS_MAX as u64 {
        let (now, payload) = (start + Duration::from_nanos(number), number.to_le_bytes());
        delivered.note(mark("T/cmd_vel"), &payload, now);
        filter.judge(u128::from(number % 2000).to_le_bytes(), None, &payload, now);
        filter.judge(RELAY, None, &payload, now);
    }
    let window = delivered.lock();
    assert!(window.order.len() <= PAYLOADS_MAX && window.payloads.len() <= PAYLOADS_MAX);
    let publishers = filter.publishers.lock().unwrap_or_else(PoisonError::into_inner);
    assert!(publishers.len() <= PUBLISHERS_MAX);
    for publisher in publishers.values() {
        assert!(!matches!(publisher, Publisher::Repeats { used, .. } if used.len() > REPETITIONS_MAX));
    }
}

#[test]
fn old_deliveries_are_forgotten() {
    let (_, delivered, start) = filter();
    for number in 0..100u64 {
        delivered.note(mark("T/cmd_vel"), &number.to_le_bytes(), start + Duration::from_secs(2 * number));
    }
    assert_eq!(delivered.lock().payloads.len(), 1);
}
