//! Messages as other software writes them: bytes whose meaning stands in the specification of CDR.
#![expect(clippy::unwrap_used, reason = "tests")]

use ros_message::{ByteOrder, Library, Time, Written};

fn encode(name: &str, text: &str, order: ByteOrder) -> Result<Vec<u8>, ros_message::Fault> {
    let message = Library::builtin().message(name)?;
    message.encode(&Written::parse(text)?, order, Time { sec: 5, nanosec: 6 })
}

#[test]
fn numbers_are_aligned_to_their_size_from_behind_the_header() {
    let stamped = encode("geometry_msgs/msg/TwistStamped", "{twist: {linear: {x: 1}}}", ByteOrder::Little).unwrap();
    let mut wanted = vec![0, 1, 0, 0];
    wanted.extend([0; 8]);
    // The empty frame is one byte, and three more are left out before the first float64.
    wanted.extend([1, 0, 0, 0, 0, 0, 0, 0]);
    wanted.extend(1.0_f64.to_le_bytes());
    wanted.extend([0; 40]);
    assert_eq!(stamped, wanted);
    let big = encode("std_msgs/msg/UInt16", "{data: 258}", ByteOrder::Big).unwrap();
    assert_eq!(big, [0, 0, 0, 0, 1, 2]);
}

#[test]
fn defaults_of_a_definition_hold_where_nothing_is_written() {
    let pose = encode("geometry_msgs/msg/Pose", "{}", ByteOrder::Little).unwrap();
    assert_eq!(pose.get(4 + 48..), Some(&1.0_f64.to_le_bytes()[..]), "the orientation is a rotation");
    let empty = encode("std_msgs/msg/Empty", "", ByteOrder::Little).unwrap();
    assert_eq!(empty, [0, 1, 0, 0, 0], "a message without fields is one byte");
}

#[test]
fn now_and_auto_are_the_time_as_in_ros2_topic_pub() {
    let by_hand = "{header: {stamp: {sec: 5, nanosec: 6}}, point: {x: 1}}";
    let wanted = encode("geometry_msgs/msg/PointStamped", by_hand, ByteOrder::Little).unwrap();
    for text in ["{header: auto, point: {x: 1}}", "{header: {stamp: now}, point: {x: 1}}"] {
        assert_eq!(encode("geometry_msgs/msg/PointStamped", text, ByteOrder::Little).unwrap(), wanted, "{text}");
    }
    assert!(encode("geometry_msgs/msg/PointStamped", "{header: now}", ByteOrder::Little).is_err());
}

#[test]
fn a_word_is_what_its_field_says() {
    let text = encode("std_msgs/msg/String", "data: yes", ByteOrder::Little).unwrap();
    assert_eq!(text, *b"\0\x01\0\0\x04\0\0\0yes\0");
    assert_eq!(encode("std_msgs/msg/Bool", "data: yes", ByteOrder::Little).unwrap(), [0, 1, 0, 0, 1]);
    assert!(encode("std_msgs/msg/String", "{data: \"a\\0b\"}", ByteOrder::Little).unwrap_err().message.contains("NUL"));
}

#[test]
fn a_text_with_a_nul_or_without_its_end_is_shown_whole() {
    let mut library = Library::builtin();
    let text = library.message("std_msgs/msg/String").unwrap();
    assert_eq!(text.decode(b"\0\x01\0\0\x04\0\0\0a\0b\0").unwrap().to_yaml(None), "data: \"a\\0b\"\n");
    assert_eq!(text.decode(b"\0\x01\0\0\x03\0\0\0abc").unwrap().to_yaml(None), "data: abc\n");
    assert_eq!(text.decode(b"\0\x01\0\0\0\0\0\0").unwrap().to_yaml(None), "data: ''\n");
    assert_eq!(text.decode(b"\0\x01\0\0\x03\0\0\0\xff\xfe\0").unwrap().to_yaml(None), "data: '\u{fffd}\u{fffd}'\n");
}

#[test]
fn a_list_of_the_wrong_length_is_refused() {
    let fault = encode("sensor_msgs/msg/Imu", "{orientation_covariance: [1, 2]}", ByteOrder::Little).unwrap_err();
    assert_eq!((fault.found.as_str(), fault.wanted.as_str()), ("2 elements", "9"));
    assert!(fault.message.starts_with("orientation_covariance: "), "{fault:?}");
}

#[test]
fn bytes_behind_a_message_change_nothing_and_are_a_slip_where_a_person_gives_them() {
    let message = Library::builtin().message("std_msgs/msg/String").unwrap();
    let bytes = b"\0\x01\0\0\x02\0\0\0a\0";
    let value = message.decode(bytes).unwrap();
    for behind in [1, 2, 3, 9, 1000] {
        let more: Vec<u8> = bytes.iter().copied().chain((1..=255).cycle().take(behind)).collect();
        message.check(&more).unwrap();
        assert_eq!(message.decode(&more).unwrap(), value, "{behind}");
        // Two bytes fill up the message to a multiple of four.
        assert_eq!(message.check_whole(&more).is_ok(), behind == 2, "{behind}");
    }
    assert!(message.check(bytes.split_last().unwrap().1).is_err());
}

#[test]
fn a_wstring_is_units_of_utf_16_of_four_bytes_each() {
    let mut library = Library::default();
    library.add("a_msgs/msg/Wide", "uint8 x\nwstring<=4 text \"a\u{1f600}\"\nwstring[] more\n").unwrap();
    let message = library.message("a_msgs/msg/Wide").unwrap();
    let bytes = message.encode(&Written::Nothing, ByteOrder::Little, Time::default()).unwrap();
    assert_eq!(bytes, *b"\0\x01\0\0\0\0\0\0\x03\0\0\0a\0\0\0\x3d\xd8\0\0\0\xde\0\0\0\0\0\0");
    assert_eq!(message.decode(&bytes).unwrap().to_yaml(None), "x: 0\ntext: 'a\u{1f600}'\nmore: []\n");
    message.check(&bytes).unwrap();
    let long = message.encode(&Written::parse("text: abcde").unwrap(), ByteOrder::Big, Time::default()).unwrap_err();
    assert!(long.message.contains("too long"), "{long:?}");
    // A whole character in one unit, half a character, and no character at all.
    let odd = b"\0\x01\0\0\0\0\0\0\x03\0\0\0\0\xf6\x01\0\x3d\xd8\0\0\xff\xff\xff\xff\0\0\0\0";
    assert_eq!(message.decode(odd).unwrap().to_yaml(None), "x: 0\ntext: '\u{1f600}\u{fffd}\u{fffd}'\nmore: []\n");
    assert!(
        message.check(b"\0\x01\0\0\0\0\0\0\x05\0\0\0aaaabbbbccccddddeeee\0\0\0\0").is_err(),
        "longer than its bound"
    );
    assert!(message.decode(b"\0\x01\0\0\0\0\0\0\x04\0\0\0a\0\0\0").is_err());
}

#[test]
fn an_encoding_that_is_passed_on_and_not_decoded_is_named() {
    let message = Library::builtin().message("std_msgs/msg/UInt16").unwrap();
    for (id, name) in
        [(3, "parameter list CDR"), (7, "XCDR2,"), (9, "XCDR2 of an appendable"), (11, "XCDR2 of a mutable")]
    {
        let refused = message.decode(&[0, id, 0, 2, 1, 2, 0, 0]).unwrap_err();
        assert!(refused.message.contains(name), "{}", refused.message);
        assert!(refused.found.contains(&format!("00 {id:02x}")), "{}", refused.found);
    }
    let unknown = message.decode(&[0, 5, 0, 0, 1, 2]).unwrap_err();
    assert!(!unknown.message.contains("XCDR2"), "{}", unknown.message);
}
