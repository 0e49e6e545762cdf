//! Bytes and texts from anybody cost bounded memory and time, and never a panic.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use proptest::prelude::*;
use ros_message::{ByteOrder, Library, Message, Time, Written};

/// Types with everything that a length can be wrong in.
const TYPES: [&str; 9] = [
    "geometry_msgs/msg/TwistStamped",
    "sensor_msgs/msg/Joy",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/String",
    "std_msgs/msg/Empty",
    "nav_msgs/msg/Odometry",
    "diagnostic_msgs/msg/DiagnosticArray",
    "test_msgs/msg/Bounded",
    "test_msgs/msg/Nested",
];

fn message(name: &str) -> Message {
    let mut library = Library::builtin();
    library.add("test_msgs/msg/Bounded", "string<=3[<=2] names\nint16[<=4] list\nbool[3] flags\n").unwrap();
    library.add("test_msgs/msg/Nested", "std_msgs/Empty[] nothings\nBounded[2] two\nBounded[] many\n").unwrap();
    library.message(name).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn any_bytes_are_a_message_or_a_fault(
        kind in 0..TYPES.len(),
        order in 0..2_u8,
        mut body in prop::collection::vec(prop_oneof![3 => 0..4_u8, 1 => any::<u8>()], 0..300),
    ) {
        let message = message(TYPES[kind]);
        body.splice(0..0, [0, order, 0, 0]);
        let decoded = message.decode(&body);
        // What can be decoded passes the check of lengths, and what does not pass cannot be decoded.
        prop_assert_eq!(decoded.is_ok(), message.check(&body).is_ok());
        if let Ok(value) = decoded {
            let _text = value.to_yaml(Some(128));
        }
        let _any = message.check(body.get(4..).unwrap_or_default());
    }

    #[test]
    fn any_text_is_a_message_or_a_fault(kind in 0..TYPES.len(), text in "[a-z0-9 .:,{}\\[\\]'\"\n&*!|>~#-]{0,80}") {
        if let Ok(written) = Written::parse(&text) {
            let message = message(TYPES[kind]);
            if let Ok(bytes) = message.encode(&written, ByteOrder::Little, Time::default()) {
                prop_assert!(message.check(&bytes).is_ok());
            }
        }
    }

    #[test]
    fn what_is_decoded_and_written_again_is_the_same(
        x in any::<f64>(),
        axes in prop::collection::vec(any::<f32>(), 0..6),
        buttons in prop::collection::vec(any::<i32>(), 0..6),
        frame in "\\PC{0,12}",
        sec in any::<i32>(),
    ) {
        let (joy, twist) = (message("sensor_msgs/msg/Joy"), message("geometry_msgs/msg/Twist"));
        let json = serde_json::json!({
            "header": {"stamp": {"sec": sec, "nanosec": 7}, "frame_id": frame},
            "buttons": buttons,
        });
        let mut text = json.to_string();
        let axes: Vec<_> = axes.iter().map(|axis| format!("{axis:?}")).collect();
        text.insert_str(text.len() - 1, &format!(", \"axes\": [{}]", axes.join(", ")));
        for (message, text) in [(joy, text), (twist, format!("{{linear: {{x: {x:?}}}}}"))] {
            for order in [ByteOrder::Little, ByteOrder::Big] {
                let bytes = message.encode(&Written::parse(&text).unwrap(), order, Time::default()).unwrap();
                let value = message.decode(&bytes).unwrap();
                let (yaml, json) = (value.to_yaml(None), serde_json::to_string(&value).unwrap());
                for written in [yaml, json] {
                    let again = message.encode(&Written::parse(&written).unwrap(), order, Time::default()).unwrap();
                    prop_assert_eq!(&again, &bytes, "{}", written);
                }
            }
        }
    }
}

#[test]
fn lengths_beyond_the_bytes_cost_nothing() {
    for name in ["sensor_msgs/msg/Joy", "sensor_msgs/msg/PointCloud2", "test_msgs/msg/Nested", "std_msgs/msg/String"] {
        let message = message(name);
        for length in [u32::MAX, 0x7fff_ffff, 0x0100_0000] {
            for at in 0..40 {
                let mut bytes = vec![0, 1, 0, 0];
                bytes.resize(4 + at, 0);
                bytes.extend_from_slice(&length.to_le_bytes());
                bytes.resize(120, 0);
                assert_eq!(message.decode(&bytes).is_ok(), message.check(&bytes).is_ok());
            }
        }
    }
}

#[test]
fn a_message_of_millions_of_parts_is_checked_and_not_shown() {
    let message = message("test_msgs/msg/Nested");
    let count = 3_000_000_u32;
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend_from_slice(&count.to_le_bytes());
    bytes.resize(8 + count as usize, 0);
    // Two Bounded without names and numbers, and none more.
    let empty = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    for part in [&empty[..], &[0], &empty[..], &[0], &[0; 4]] {
        bytes.extend_from_slice(part);
    }
    message.check(&bytes).unwrap();
    assert!(message.decode(&bytes).unwrap_err().message.contains("too many parts"));
}

#[test]
fn an_array_that_is_too_large_to_write_is_refused() {
    let mut library = Library::builtin();
    library.add("big_msgs/msg/Row", "float64[65535] cells\n").unwrap();
    library.add("big_msgs/msg/Grid", "Row[4294967295] rows\n").unwrap();
    let grid = library.message("big_msgs/msg/Grid").unwrap();
    let fault = grid.encode(&Written::Nothing, ByteOrder::Little, Time::default()).unwrap_err();
    assert!(fault.message.contains("too long"), "{fault:?}");
    assert!(grid.check(&[0, 1, 0, 0, 1, 2, 3]).is_err() && grid.decode(&[0, 1, 0, 0, 1, 2, 3]).is_err());
}
