//! Messages in both directions between our reader and writer of CDR and CycloneDDS's.

use crate::python::Python;
use ros_message::{ByteOrder, Library, Time, Written};
use serde_json::Value;

/// A type and a message of it; numbers that `float32` has exactly.
const MESSAGES: [(&str, &str); 9] = [
    ("geometry_msgs/msg/Twist", "{linear: {x: 0.5, y: -1e300}, angular: {z: 0.1}}"),
    (
        "geometry_msgs/msg/TwistStamped",
        "{header: {stamp: {sec: -7, nanosec: 8}, frame_id: base}, twist: {linear: {x: 1}}}",
    ),
    ("sensor_msgs/msg/Joy", "{header: {frame_id: ab}, axes: [0.5, -0.25, 3], buttons: [1, 0, -2147483648]}"),
    ("sensor_msgs/msg/Joy", "{header: {frame_id: abcde}}"),
    ("sensor_msgs/msg/Imu", "{orientation_covariance: [-1, 0, 0, 0, 0, 0, 0, 0, 9], linear_acceleration: {z: 9.81}}"),
    ("sensor_msgs/msg/Image", "{height: 1, width: 3, encoding: mono8, step: 3, data: [1, 0, 255]}"),
    (
        "diagnostic_msgs/msg/DiagnosticArray",
        "status: [{level: 2, name: arm, values: [{key: a, value: ''}, {key: bcd, value: 'x: 1'}]}, {message: fine}]",
    ),
    ("std_msgs/msg/String", "{data: 'größer als vier'}"),
    ("std_msgs/msg/UInt64", "{data: 18446744073709551615}"),
];

#[test]
fn cyclonedds_reads_what_we_write_and_we_read_what_it_writes() {
    let mut library = Library::builtin();
    for order in [ByteOrder::Little, ByteOrder::Big] {
        let messages = MESSAGES.map(|(name, text)| {
            let message = library.message(name).unwrap();
            let bytes = message.encode(&Written::parse(text).unwrap(), order, Time::default()).unwrap();
            (message, bytes)
        });
        let arguments: Vec<_> =
            messages.iter().map(|(message, bytes)| format!("{}={}", message.name(), hex::encode(bytes))).collect();
        let mut python = Python::start("codec.py", &arguments.iter().map(String::as_str).collect::<Vec<_>>());
        for (message, bytes) in &messages {
            let (fields, again) = (python.line().unwrap(), hex::decode(python.line().unwrap()).unwrap());
            let theirs: Value = serde_json::from_str(&fields).unwrap();
            let ours = serde_json::to_value(message.decode(bytes).unwrap()).unwrap();
            assert_eq!(theirs, ours, "{} {order:?}", message.name());
            message.check(&again).unwrap();
            assert_eq!(message.decode(&again).unwrap(), message.decode(bytes).unwrap(), "{}", message.name());
        }
        assert!(python.finish());
    }
}
