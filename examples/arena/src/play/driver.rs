//! A user's node: the controller between the poses that it hears and the commands that it publishes.

use super::poses::read_pose;
use super::turtlebot::poses;
use crate::model::controller::{Controller, HZ};
use crate::model::course::{Course, User, Waypoint};
use ledger_base::rejection::Rejection;
use ledgerd::demo::twist;
use ledgerd::demo::{DISCOVERY_TIME_MAX, cmd_vel, failed, nobody_there};
use ros_bridge::dds::{Matched, Participant, Reader, Writer};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval_at};

/// Between two commands.
pub(crate) const PERIOD: Duration = Duration::from_millis(1000 / HZ as u64);

/// The knowledge and the deeds of a controller.
struct State {
    controller: Controller,
    /// Does it publish commands?
    drives: bool,
    /// When each command was published, by its number.
    published: Vec<Instant>,
    /// When each pose came, and how old it was (seconds).
    feedback: Vec<(Instant, f64)>,
}

/// A user's node. It knows nothing of any ledger.
pub(crate) struct Driver {
    user: User,
    _participant: Participant,
    commands: Matched,
    poses: Matched,
    state: Arc<Mutex<State>>,
    task: JoinHandle<()>,
}

impl Driver {
    /// Joins a ROS 2 domain. The node commands from the first beat on, and tells of each waypoint that it has reached.
    pub(crate) async fn open(
        domain: u16,
        user: User,
        course: Course,
        first_beat: Instant,
        reached: UnboundedSender<(Waypoint, Instant)>,
    ) -> Result<Self, Rejection> {
        let name = format!("{}_controller", user.name()).to_lowercase();
        let participant = Participant::open(domain, &name).await.map_err(|error| failed(&error))?;
        let ((topic, kind), (pose_topic, pose_kind)) = (cmd_vel()?, poses()?);
        let writer = participant.writer(&topic, &kind, &Qos::default()).map_err(|error| failed(&error))?;
        let reader = participant
            .reader(&pose_topic, &pose_kind, &Qos::default(), Limits::default())
            .map_err(|error| failed(&error))?;
        let state = State {
            controller: Controller::new(course.waypoints(user)),
            drives: false,
            published: Vec::new(),
            feedback: Vec::new(),
        };
        let state = Arc::new(Mutex::new(state));
        let (commands, poses) = (writer.matched().clone(), reader.matched().clone());
        let task = tokio::spawn(control(user, Arc::clone(&state), (reader, writer), first_beat, reached));
        Ok(Self { user, _participant: participant, commands, poses, state, task })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }

    /// Waits until its bridge is there, and poses come through the ledger.
    pub(crate) async fn matched(&self) -> Result<(), Rejection> {
        let heard = async {
            self.commands.at_least(1).await;
            self.poses.at_least(1).await;
            while self.state().feedback.is_empty() {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        tokio::time::timeout(DISCOVERY_TIME_MAX, heard)
            .await
            .map_err(|_| nobody_there(&format!("the bridge of {}, with poses from the ledger,", self.user.name())))
    }

    /// Begins to publish commands, or ends it.
    pub(crate) fn drive(&self, drives: bool) {
        self.state().drives = drives;
    }

    /// Has it reached its last waypoint?
    pub(crate) fn is_done(&self) -> bool {
        self.state().controller.is_done()
    }

    /// When each command was published, by its number.
    pub(crate) fn published(&self) -> Vec<Instant> {
        self.state().published.clone()
    }

    /// When each pose came, and how old it was (seconds).
    pub(crate) fn feedback(&self) -> Vec<(Instant, f64)> {
        self.state().feedback.clone()
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn locked(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hears and commands until DDS ends.
async fn control(
    user: User,
    state: Arc<Mutex<State>>,
    (mut reader, writer): (Reader, Writer),
    first_beat: Instant,
    reached: UnboundedSender<(Waypoint, Instant)>,
) {
    let began = Instant::now();
    let seconds = |at: Instant| at.saturating_duration_since(began).as_secs_f64();
    let mut beats = interval_at(first_beat.into(), PERIOD);
    beats.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            incoming = reader.next() => {
                let Some(incoming) = incoming else { break };
                let Some((stamp, pose)) = read_pose(&incoming.sample.body()) else { continue };
                let age = SystemTime::now().duration_since(UNIX_EPOCH + stamp).unwrap_or_default().as_secs_f64();
                let mut state = locked(&state);
                state.feedback.push((incoming.received, age));
                // Somebody without a task does not follow one.
                if state.drives {
                    let now = seconds(incoming.received);
                    if let Some(index) = state.controller.hear(now, now - age, pose) {
                        let _nobody_listens = reached.send((Waypoint { user, index }, incoming.received));
                    }
                }
            }
            _ = beats.tick() => {
                let mut state = locked(&state);
                if !state.drives || state.controller.is_done() {
                    continue;
                }
                let now = Instant::now();
                let command = state.controller.command(seconds(now));
                let Ok(sample) = twist(command, state.published.len(), user) else { continue };
                state.published.push(now);
                // A command that is not taken is lost; the next one comes soon.
                let _lost = writer.write(&sample);
            }
        }
    }
}
