//! Tasks: points that a robot traverses in order, for one user. `T = (user, robot, points)` of the paper.
//!
//! Coordinates are whole numbers of small units: every node must read them alike.

use crate::grant::Grant;
use crate::line::Place;
use crate::word::{Told, words};
use serde::{Deserialize, Serialize};

/// Most points of a task.
pub const POINTS_MAX: usize = 1024;
/// The largest coordinate (micrometres), either way: 1000 km.
pub const COORDINATE_UM_MAX: u64 = 1_000_000_000_000;
/// The largest yaw (millionths of a radian), either way: a full turn.
pub const YAW_URAD_MAX: u64 = 6_283_186;
/// The frame of points that name none.
pub const FRAME_DEFAULT: &str = "map";

/// A point to reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Along the x axis of the frame, micrometres.
    pub x_um: i64,
    /// Along the y axis of the frame, micrometres.
    pub y_um: i64,
    /// The heading, millionths of a radian from the x axis towards the y axis.
    #[serde(default)]
    pub yaw_urad: i64,
}

impl Point {
    /// Are its numbers within their bounds?
    pub fn is_usable(&self) -> bool {
        let within = |number: i64, most: u64| number.unsigned_abs() <= most;
        within(self.x_um, COORDINATE_UM_MAX)
            && within(self.y_um, COORDINATE_UM_MAX)
            && within(self.yaw_urad, YAW_URAD_MAX)
    }
}

/// A task as its submitter describes it in `submit`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSpec {
    /// The points, in the order in which they are to be reached; 1 to [`POINTS_MAX`].
    pub points: Vec<Point>,
    /// The coordinate frame of the points.
    #[serde(default = "frame")]
    pub frame: String,
    /// The priority, if it is to be lower than the one that the submitter has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<i64>,
    /// The time before which it does not join the line (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_before: Option<u64>,
    /// The time at which it expires if it has not ended (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<u64>,
    /// The lease of its grant (milliseconds); by default that of the service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease_ms: Option<u64>,
    /// Does it wait again after it was preempted?
    #[serde(default, skip_serializing_if = "is_false")]
    pub requeue: bool,
}

fn frame() -> String {
    FRAME_DEFAULT.to_owned()
}

fn is_false(value: &bool) -> bool {
    !value
}

words! {
    /// How far a task is.
    pub enum TaskState {
        /// Its time has not come.
        Scheduled = "scheduled",
        /// It is in line, or joins it with the next block.
        Waiting = "waiting",
        /// Its submitter holds the service for it.
        Running = "running",
        /// The last point was reached.
        Done = "done",
        /// It cannot go on.
        Failed = "failed",
        /// Its submitter or an admin of the owner ended it.
        Cancelled = "cancelled",
        /// Somebody or something with more right took the service.
        Preempted = "preempted",
        /// Its deadline passed, or it waited as long as the service allows.
        Expired = "expired",
    }
}

impl TaskState {
    /// Has the task not ended yet?
    pub fn is_open(self) -> bool {
        matches!(self, Self::Scheduled | Self::Waiting | Self::Running)
    }
}

/// A task: the answer of `task`, and without its points an element of the answer of `tasks`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// Its number; no other task of the network has it.
    pub id: u64,
    /// The service, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The submitter, e.g. `Org1/Salma`.
    pub submitter: String,
    /// How far it is.
    pub state: Told<TaskState>,
    /// How many points were reached.
    pub reached: u64,
    /// How many points it has.
    pub total: u64,
    /// The coordinate frame of the points.
    pub frame: String,
    /// The points; left out in lists.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<Point>,
    /// The priority with which it waits.
    pub priority: i64,
    /// Does it wait again after it was preempted?
    #[serde(default, skip_serializing_if = "is_false")]
    pub requeue: bool,
    /// The time before which it does not join the line (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_before: Option<u64>,
    /// The time at which it expires if it has not ended (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deadline: Option<u64>,
    /// When it was submitted (block time, microseconds).
    pub submitted: u64,
    /// When it began to run, the last time (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started: Option<u64>,
    /// When it ended (block time, microseconds).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended: Option<u64>,
    /// Why it is in this state, if there is something to say.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// Answer of `submit`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Submitted {
    /// The task.
    pub task: Task,
    /// The grant that serves it, if it runs at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grant: Option<Grant>,
    /// Its place in line, if it waits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queued: Option<Place>,
}

/// Payload of the event `task`: a task was submitted, went on, or ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskTold {
    /// The task.
    pub id: u64,
    /// The service.
    pub service: String,
    /// The submitter.
    pub submitter: String,
    /// How far it is.
    pub state: Told<TaskState>,
    /// How many points were reached.
    pub reached: u64,
    /// How many points it has.
    pub total: u64,
    /// Why it is in this state, if there is something to say.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// A running task as [`crate::Declaration`] tells it to the robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunningTask {
    /// The task.
    pub id: u64,
    /// The service.
    pub service: String,
    /// The coordinate frame of the points.
    pub frame: String,
    /// How many points were reached.
    pub reached: u64,
    /// The points to reach next, at most [`NEXT_MAX`].
    pub next: Vec<Point>,
}

/// Most points of a [`RunningTask`].
pub const NEXT_MAX: usize = 16;
