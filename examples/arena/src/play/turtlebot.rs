//! The robot's node, and the cameras that watch the robot. Between them is no message: cameras see.

use super::POSES;
use super::poses::pose_stamped;
use crate::model::course::Course;
use crate::model::geometry::{Point, Pose};
use crate::model::noise::Noise;
use crate::model::robot::Turtlebot;
use ledger_base::rejection::Rejection;
use ledgerd::demo::{DISCOVERY_TIME_MAX, cmd_vel, failed, nobody_there};
use ledgerd::demo::{Twist, read_twist};
use ros_bridge::dds::{Matched, Participant};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};

/// Poses a second (paper: a constant rate; OptiTrack's usual one).
pub(crate) const CAMERA_HZ: u32 = 120;
/// Deviation of what the cameras see (metres, radians): OptiTrack names 0.2 mm for such a room.
const CAMERA_NOISE: (f64, f64) = (0.0002, 0.001);
/// Deviation of a tyre from its size.
const TYRE_NOISE: f64 = 0.004;

/// The robot, and all that was seen of it.
pub(crate) struct Body {
    robot: Turtlebot,
    began: Instant,
    /// The robot as it really was, at the rate of the cameras.
    pub seen: Vec<(Instant, Pose, f64)>,
    /// The commands that came.
    pub heard: Vec<(Instant, Twist)>,
}

impl Body {
    fn seconds(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.began).as_secs_f64()
    }

    /// Where it really is.
    pub(crate) fn pose(&self) -> Pose {
        self.robot.pose()
    }
}

/// Access to the robot, from its node and for its watchers.
pub(crate) type Shared = Arc<Mutex<Body>>;

/// The robot, whatever another thread has left.
pub(crate) fn look(body: &Shared) -> MutexGuard<'_, Body> {
    body.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A robot at the start of the course.
pub(crate) fn placed(course: Course, seed: u64) -> Shared {
    let mut noise = Noise::named(seed, "tyres");
    let robot =
        Turtlebot::new(course.start()).with_tyres(1.0 + noise.normal(TYRE_NOISE), 1.0 + noise.normal(TYRE_NOISE));
    Arc::new(Mutex::new(Body { robot, began: Instant::now(), seen: Vec::new(), heard: Vec::new() }))
}

/// A ROS 2 node with one topic.
pub(crate) struct Node {
    _participant: Participant,
    matched: Matched,
    task: JoinHandle<()>,
}

impl Node {
    /// The base of the robot: listens to `/cmd_vel`, and to nothing else.
    pub(crate) async fn base(domain: u16, body: Shared) -> Result<Self, Rejection> {
        let (topic, kind) = cmd_vel()?;
        let participant = Participant::open(domain, "turtlebot4_base").await.map_err(|error| failed(&error))?;
        let mut reader =
            participant.reader(&topic, &kind, &Qos::default(), Limits::default()).map_err(|error| failed(&error))?;
        let matched = reader.matched().clone();
        let task = tokio::spawn(async move {
            while let Some(incoming) = reader.next().await {
                if let Some(twist) = read_twist(&incoming.sample.body()) {
                    let mut body = look(&body);
                    let now = body.seconds(incoming.received);
                    body.robot.command(now, twist.command);
                    body.heard.push((incoming.received, twist));
                }
            }
        });
        Ok(Self { _participant: participant, matched, task })
    }

    /// The cameras: publish where the robot is.
    pub(crate) async fn cameras(domain: u16, body: Shared, seed: u64) -> Result<Self, Rejection> {
        let (topic, kind) = poses()?;
        let participant = Participant::open(domain, "optitrack").await.map_err(|error| failed(&error))?;
        let writer = participant.writer(&topic, &kind, &Qos::default()).map_err(|error| failed(&error))?;
        let matched = writer.matched().clone();
        let mut noise = Noise::named(seed, "cameras");
        let task = tokio::spawn(async move {
            let mut frames = interval(Duration::from_secs(1) / CAMERA_HZ);
            frames.set_missed_tick_behavior(MissedTickBehavior::Skip);
            loop {
                frames.tick().await;
                let pose = {
                    let (mut body, at) = (look(&body), Instant::now());
                    let now = body.seconds(at);
                    body.robot.advance(now);
                    let (pose, speed) = (body.robot.pose(), body.robot.speed());
                    body.seen.push((at, pose, speed));
                    pose
                };
                let stamp = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                let Ok(sample) = pose_stamped(stamp, blurred(pose, &mut noise)) else { continue };
                // A reader that is too slow misses a frame, as with every camera.
                let _missed = writer.write(&sample);
            }
        });
        Ok(Self { _participant: participant, matched, task })
    }

    /// Waits until its bridge is there.
    pub(crate) async fn matched(&self) -> Result<(), Rejection> {
        let matched = self.matched.at_least(1);
        tokio::time::timeout(DISCOVERY_TIME_MAX, matched)
            .await
            .map(drop)
            .map_err(|_| nobody_there("the bridge of the robot or of the cameras"))
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// As cameras see it.
fn blurred(pose: Pose, noise: &mut Noise) -> Pose {
    let (place, angle) = CAMERA_NOISE;
    let at = Point { x: pose.at.x + noise.normal(place), y: pose.at.y + noise.normal(place) };
    Pose { at, yaw: pose.yaw + noise.normal(angle) }
}

/// The topic of the cameras.
pub(crate) fn poses() -> Result<(TopicName, TypeName), Rejection> {
    let topic = TopicName::parse(POSES.topic).map_err(|error| failed(&error))?;
    let kind = TypeName::parse(POSES.kind).map_err(|error| failed(&error))?;
    Ok((topic, kind))
}
