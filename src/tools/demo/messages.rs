//! The velocity commands of the demo, as little-endian CDR.

use super::user::User;
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_gate::sample::{CDR_LE, Sample};

/// Bytes of a Twist: two vectors of three doubles.
const TWIST_BYTES: usize = 48;

/// A `geometry_msgs/msg/Twist` as a differential drive reads it: it ignores all other fields.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// `linear.x` (m/s).
    pub linear: f64,
    /// `angular.z` (rad/s).
    pub angular: f64,
}

impl Command {
    /// The command to stand still.
    pub const STOP: Self = Self { linear: 0.0, angular: 0.0 };
}

/// A received Twist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Its user; none for a stop message.
    pub user: Option<User>,
    /// Its number.
    pub number: usize,
    /// Its speeds.
    pub command: Command,
}

/// A `geometry_msgs/msg/Twist`. A differential drive has no use for `linear.y` and `linear.z`: they carry number and mark, so
/// that the robot's side can tell whose message it got.
pub fn twist(command: Command, number: usize, user: User) -> Result<Sample, Rejection> {
    let mut body = Vec::with_capacity(TWIST_BYTES);
    for value in [command.linear, number as f64, f64::from(user.mark()), 0.0, 0.0, command.angular] {
        body.extend_from_slice(&value.to_le_bytes());
    }
    Sample::new(CDR_LE, &body)
}

/// Reads a Twist.
pub fn read_twist(body: &Bytes) -> Option<Twist> {
    let value = |index: usize| double(body, index * 8);
    let command = Command { linear: value(0)?, angular: value(5)? };
    Some(Twist { user: User::marked(value(2)?), number: value(1)? as usize, command })
}

fn double(body: &Bytes, at: usize) -> Option<f64> {
    Some(f64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ros_message::Library;

    fn yaml(kind: &str, sample: &Sample) -> String {
        Library::builtin().message(kind).unwrap().decode(sample.wire()).unwrap().to_yaml(None)
    }

    #[test]
    fn a_twist_is_one_of_ros_and_comes_back() {
        let command = Command { linear: 0.25, angular: -1.5 };
        let sample = twist(command, 7, User::Farhad).unwrap();
        let text = yaml("geometry_msgs/msg/Twist", &sample);
        assert!(text.contains("x: 0.25") && text.contains("z: -1.5"), "{text}");
        assert_eq!(read_twist(&sample.body()), Some(Twist { user: Some(User::Farhad), number: 7, command }));
        assert_eq!(read_twist(&Bytes::from(vec![0; TWIST_BYTES])).unwrap().user, None, "a stop message");
        assert_eq!(read_twist(&Bytes::from(vec![0; TWIST_BYTES - 1])), None);
    }
}
