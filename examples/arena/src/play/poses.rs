//! Poses as messages: little-endian CDR.

use crate::model::geometry::{Point, Pose};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_gate::sample::{CDR_LE, Sample};
use std::time::Duration;

/// The frame of poses: a string ends with a zero.
const FRAME: &[u8] = b"world\0";
/// Where the numbers of a PoseStamped begin: after stamp and frame, at a multiple of 8.
const POSE_AT: usize = 24;

/// A `geometry_msgs/msg/PoseStamped` with this time in its stamp.
pub(crate) fn pose_stamped(stamp: Duration, pose: Pose) -> Result<Sample, Rejection> {
    let mut body = Vec::with_capacity(POSE_AT + 7 * 8);
    body.extend_from_slice(&i32::try_from(stamp.as_secs()).unwrap_or(i32::MAX).to_le_bytes());
    body.extend_from_slice(&stamp.subsec_nanos().to_le_bytes());
    body.extend_from_slice(&(FRAME.len() as u32).to_le_bytes());
    body.extend_from_slice(FRAME);
    body.resize(POSE_AT, 0);
    let half = pose.yaw / 2.0;
    for value in [pose.at.x, pose.at.y, 0.0, 0.0, 0.0, half.sin(), half.cos()] {
        body.extend_from_slice(&value.to_le_bytes());
    }
    Sample::new(CDR_LE, &body)
}

/// Reads what [`pose_stamped`] has written.
pub(crate) fn read_pose(body: &Bytes) -> Option<(Duration, Pose)> {
    let seconds = i32::from_le_bytes(body.get(..4)?.try_into().ok()?);
    let nanos = u32::from_le_bytes(body.get(4..8)?.try_into().ok()?);
    let value = |index: usize| double(body, POSE_AT + index * 8);
    let pose = Pose { at: Point { x: value(0)?, y: value(1)? }, yaw: 2.0 * value(5)?.atan2(value(6)?) };
    Some((Duration::new(u64::try_from(seconds).ok()?, nanos), pose))
}

fn double(body: &Bytes, at: usize) -> Option<f64> {
    Some(f64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ros_message::Library;

    #[test]
    fn a_pose_is_one_of_ros_and_comes_back() {
        let pose = Pose { at: Point { x: -1.25, y: 3.5 }, yaw: 2.5 };
        let stamp = Duration::new(1_800_000_000, 123_456_789);
        let sample = pose_stamped(stamp, pose).unwrap();
        let text = Library::builtin()
            .message("geometry_msgs/msg/PoseStamped")
            .unwrap()
            .decode(sample.wire())
            .unwrap()
            .to_yaml(None);
        for wanted in ["sec: 1800000000", "nanosec: 123456789", "frame_id: world", "x: -1.25", "y: 3.5"] {
            assert!(text.contains(wanted), "{wanted}: {text}");
        }
        let (read_stamp, read) = read_pose(&sample.body()).unwrap();
        assert_eq!(read_stamp, stamp);
        assert!((read.yaw - pose.yaw).abs() < 1e-12 && read.at == pose.at);
    }
}
