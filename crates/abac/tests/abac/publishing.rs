//! `set` under a grant.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, TWIST, bytes, farhad, owner, salma};
use bytes::Bytes;
use ledger_abac::{Grant, Latest, MESSAGES_PER_CALL_MAX, MessageEvent, Published};
use ledger_base::rejection::Code;

#[test]
fn an_old_epoch_is_refused_after_a_newer_grant() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 1, 2);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let refusal = fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 2);
    assert_eq!((refusal.found.as_str(), refusal.wanted.as_str()), ("epoch 1", "epoch 2, held by its holder"));
    // Knowing the epoch does not help.
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 2, 2);
    // Nor does the holder get on with another than the epoch of the grant.
    fleet.set_refused(&farhad(), Code::StaleEpoch, TURTLEBOT, 1, 1);
    fleet.set_refused(&farhad(), Code::StaleEpoch, TURTLEBOT, 3, 1);
    fleet.set_refused(&farhad(), Code::StaleEpoch, TURTLEBOT, 0, 1);
    fleet.set(&farhad(), TURTLEBOT, 2, 1, 1).unwrap();
}

#[test]
fn a_sequence_number_is_accepted_once_and_only_upwards_within_an_epoch() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 10, 5).unwrap();
    for seq in [0, 9, 10, 14] {
        let refusal = fleet.set_refused(&salma(), Code::StaleSequence, TURTLEBOT, 1, seq);
        assert_eq!(refusal.wanted, "at least 15");
    }
    fleet.set(&salma(), TURTLEBOT, 1, 15, 1).unwrap();
    fleet.set(&salma(), TURTLEBOT, 1, 100, 1).unwrap();
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    assert_eq!((grant.epoch, grant.next_seq), (2, 0));
    fleet.set(&salma(), TURTLEBOT, 2, 0, 1).unwrap();
}

#[test]
fn the_largest_sequence_numbers_do_not_wrap() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set_refused(&salma(), Code::BadArgument, TURTLEBOT, 1, u64::MAX);
    assert_eq!(fleet.set(&salma(), TURTLEBOT, 1, u64::MAX - 1, 2).unwrap_err().code, Code::BadArgument);
    fleet.set(&salma(), TURTLEBOT, 1, u64::MAX - 1, 1).unwrap();
    fleet.set_refused(&salma(), Code::StaleSequence, TURTLEBOT, 1, u64::MAX - 1);
}

#[test]
fn several_messages_of_one_call_are_told_by_one_event_and_kept_out_of_the_state() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let published: Published = serde_json::from_slice(&fleet.set(&salma(), TURTLEBOT, 1, 3, 4).unwrap()).unwrap();
    assert_eq!(published, Published { epoch: 1, next_seq: 7 });
    assert_eq!(fleet.newest::<MessageEvent>("message"), MessageEvent { epoch: 1, first_seq: 3, count: 4 });
    assert_eq!(fleet.events.last().unwrap().payload, r#"{"epoch":1,"first_seq":3,"count":4}"#);
    let (key, value) = fleet.writes.last().unwrap().first_key_value().unwrap();
    assert_eq!(key, format!("abac\0last/{TURTLEBOT}").as_bytes());
    let height = fleet.height;
    let expected = format!(r#"{{"epoch":1,"seq":6,"height":{height},"publisher":"Org1/Salma","count":4}}"#);
    assert_eq!(value.as_ref().unwrap(), &expected);
}

#[test]
fn a_payload_without_a_cdr_header_is_refused() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    for payload in [&b""[..], b"\0\x01\0", b"\x01\0\0\0data", b"\0\x04\0\0data", b"\0\x0c\0\0data", b"hello"] {
        let mut args = bytes(&[TURTLEBOT, "1", "1"]);
        args.push(Bytes::from_static(&TWIST));
        args.push(Bytes::copy_from_slice(payload));
        let refusal = fleet.call(&salma(), "set", &args).unwrap_err();
        assert_eq!(refusal.code, Code::BadArgument, "{refusal}");
        assert!(refusal.message.contains("argument 5 (PAYLOAD)"), "{refusal}");
    }
}

#[test]
fn a_call_carries_a_bounded_number_of_messages() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 1, MESSAGES_PER_CALL_MAX).unwrap();
    let refusal = fleet.set(&salma(), TURTLEBOT, 1, 5000, MESSAGES_PER_CALL_MAX + 1).unwrap_err();
    assert_eq!(refusal.code, Code::BadArgument);
    assert_eq!(fleet.set(&salma(), TURTLEBOT, 1, 5000, 0).unwrap_err().code, Code::BadArgument);
}

#[test]
fn an_intruder_without_the_attribute_hears_that_it_is_missing() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.set_refused(&farhad(), Code::MissingAttribute, HUSKY, 0, 1);
    fleet.set_refused(&farhad(), Code::MissingAttribute, HUSKY, 1, 1);
}

#[test]
fn who_comes_late_learns_where_the_last_message_of_each_publisher_is() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open"}"#]);
    assert_eq!(fleet.get::<Vec<Latest>>(&salma(), "latest", &[TURTLEBOT]), []);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.set(&salma(), HUSKY, 1, 10, 5).unwrap();
    fleet.set(&salma(), TURTLEBOT, 0, 7, 1).unwrap();
    fleet.set(&farhad(), TURTLEBOT, 0, 3, 2).unwrap();
    let told = |fleet: &mut Fleet, service| {
        let all: Vec<Latest> = fleet.get(&salma(), "latest", &[service]);
        all.into_iter().map(|last| (last.publisher, last.epoch, last.seq, last.count)).collect::<Vec<_>>()
    };
    assert_eq!(told(&mut fleet, HUSKY), [("Org1/Salma".to_owned(), 1, 14, 5)]);
    let mut both = told(&mut fleet, TURTLEBOT);
    both.sort();
    assert_eq!(both, [("Org1/Farhad".to_owned(), 0, 4, 2), ("Org1/Salma".to_owned(), 0, 7, 1)]);
    fleet.refused(&farhad(), Code::UnknownService, "latest", &["Husky/nothing"]);
}
