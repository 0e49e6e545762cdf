//! The message that makes a robot stand still.
//!
//! When a right ends, silence is not a stop: a robot may keep its last velocity. So the bridge
//! publishes the stop message of the service's type. Types without one need it in the configuration.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::sample::{CDR_LE, Sample};

use crate::graph::names::TypeName;

/// The parts of a stop message, in CDR order.
enum Part {
    /// `std_msgs/msg/Header` with time zero ("now" to controllers that look) and no frame.
    Header,
    /// So many `float64` of zero.
    Doubles(usize),
    /// So many `float32` of zero.
    Floats(usize),
}

/// The stop message of a type, or nothing if zero would not mean "stand still" in it.
pub fn stop_message(message: &TypeName) -> Option<Sample> {
    let parts: &[Part] = match message.to_string().as_str() {
        "geometry_msgs/msg/Twist" => &[Part::Doubles(6)],
        "geometry_msgs/msg/TwistStamped" => &[Part::Header, Part::Doubles(6)],
        "ackermann_msgs/msg/AckermannDrive" => &[Part::Floats(5)],
        "ackermann_msgs/msg/AckermannDriveStamped" => &[Part::Header, Part::Floats(5)],
        _ => return None,
    };
    let mut body = Vec::new();
    for part in parts {
        match part {
            Part::Header => {
                body.extend([0; 8]); // stamp: int32 sec, uint32 nanosec
                body.extend(1_u32.to_le_bytes()); // frame_id: one byte long,
                body.push(0); // its terminator
            }
            Part::Doubles(count) => zeros(&mut body, 8, *count),
            Part::Floats(count) => zeros(&mut body, 4, *count),
        }
    }
    Sample::new(CDR_LE, &body).ok()
}

/// CDR aligns each number to its own size, counted from the start of the body.
fn zeros(body: &mut Vec<u8>, size: usize, count: usize) {
    let aligned = body.len().next_multiple_of(size);
    body.resize(aligned + size * count, 0);
}

/// The stop message that hexadecimal digits stand for.
///
/// # Errors
/// [`Code::BadArgument`] if they are none, or no CDR.
pub(crate) fn stop_sample(text: &str, bytes_max: usize) -> Result<Sample, Rejection> {
    let bytes = hex::decode(text.trim()).map_err(|error| {
        Rejection::new(Code::BadArgument, "stop_hex is not usable")
            .found(error.to_string())
            .wanted("hexadecimal digits: CDR with its 4-byte encapsulation header")
    })?;
    Sample::from_wire(Bytes::from(bytes), bytes_max)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn stop(name: &str) -> Option<Vec<u8>> {
        stop_message(&TypeName::parse(name).unwrap()).map(|sample| sample.wire().to_vec())
    }

    #[test]
    fn a_twist_stops_with_six_zero_doubles() {
        let mut expected = vec![0, 1, 0, 0];
        expected.extend([0; 48]);
        assert_eq!(stop("geometry_msgs/msg/Twist").unwrap(), expected);
    }

    #[test]
    fn a_stamped_twist_has_an_empty_header_and_aligned_doubles() {
        let mut expected = vec![0, 1, 0, 0];
        expected.extend([0; 8]); // stamp
        expected.extend([1, 0, 0, 0, 0]); // frame_id ""
        expected.extend([0; 3]); // to the next multiple of 8
        expected.extend([0; 48]);
        assert_eq!(stop("geometry_msgs/msg/TwistStamped").unwrap(), expected);
    }

    #[test]
    fn an_ackermann_drive_stops_with_five_zero_floats() {
        assert_eq!(stop("ackermann_msgs/msg/AckermannDrive").unwrap().len(), 4 + 20);
        assert_eq!(stop("ackermann_msgs/msg/AckermannDriveStamped").unwrap().len(), 4 + 16 + 20);
    }

    #[test]
    fn types_in_which_zero_is_no_stop_have_none() {
        assert_eq!(stop("std_msgs/msg/String"), None);
        assert_eq!(stop("geometry_msgs/msg/Pose"), None);
    }
}
