//! Everything that was seen in a run: by the cameras, by the robot, by the users.

use crate::model::course::{Course, User, Waypoint};
use crate::model::geometry::Pose;
use crate::model::robot::Command;
use std::collections::BTreeMap;

/// The robot at a moment, as it really is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// When.
    pub at: f64,
    /// Where it is.
    pub pose: Pose,
    /// The speed of its faster wheel (m/s).
    pub speed: f64,
}

/// A command that the robot received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Heard {
    /// When.
    pub at: f64,
    /// Its user, by its mark; none for the stop message of the robot's bridge.
    pub user: Option<User>,
    /// When its user's controller published it, if that is known.
    pub published: Option<f64>,
    /// Its speeds.
    pub command: Command,
}

/// A waypoint that a controller has reached, by what it knew then.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reached {
    /// When.
    pub at: f64,
    /// Which.
    pub waypoint: Waypoint,
    /// Where the robot really was then.
    pub pose: Pose,
}

/// The right to drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Driving {
    /// Nobody: before the first task, during an emergency stop, at the end.
    Nobody,
    /// The holder.
    One(User),
    /// Both: without access control.
    Both,
}

impl Driving {
    /// Does this user?
    pub(crate) fn includes(self, user: User) -> bool {
        self == Self::Both || self == Self::One(user)
    }
}

/// The emergency stop of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Emergency {
    /// When it was asked for.
    pub asked: f64,
    /// When the robot was asked to go on.
    pub resumed: f64,
}

/// A run.
#[derive(Clone, Debug)]
pub(crate) struct Record {
    /// The course.
    pub course: Course,
    /// The order of waypoints that the run plans.
    pub planned: Vec<Waypoint>,
    /// The order of drivers that the run plans; empty if nobody decides.
    pub drivers: Vec<User>,
    /// The robot, at the rate of the cameras.
    pub seen: Vec<Seen>,
    /// The commands that it received, in order.
    pub heard: Vec<Heard>,
    /// The waypoints that were reached, in order.
    pub reached: Vec<Reached>,
    /// The right to drive, and since when, as the clients were told.
    pub driving: Vec<(f64, Driving)>,
    /// The emergency stop, if there was one.
    pub emergency: Option<Emergency>,
    /// Commands that were published, by user.
    pub published: BTreeMap<&'static str, usize>,
    /// Commands that the ledger refused, by user and code.
    pub refused: BTreeMap<String, BTreeMap<String, u64>>,
    /// How old each pose was when a controller heard it (seconds).
    pub feedback: Vec<f64>,
}

impl Record {
    /// A run of which nothing was seen yet.
    pub(crate) fn new(course: Course, planned: Vec<Waypoint>, drivers: Vec<User>) -> Self {
        Self {
            course,
            planned,
            drivers,
            seen: Vec::new(),
            heard: Vec::new(),
            reached: Vec::new(),
            driving: Vec::new(),
            emergency: None,
            published: BTreeMap::new(),
            refused: BTreeMap::new(),
            feedback: Vec::new(),
        }
    }

    /// Its length (seconds).
    pub(crate) fn seconds(&self) -> f64 {
        self.seen.last().map_or(0.0, |seen| seen.at)
    }

    /// The yaw over time (radians), without jumps at half a turn.
    pub(crate) fn unwrapped_yaw(&self) -> Vec<(f64, f64)> {
        let mut turned = self.seen.first().map_or(0.0, |seen| seen.pose.yaw);
        let mut before = turned;
        let unwrapped = self.seen.iter().map(|seen| {
            turned += crate::model::geometry::wrapped(seen.pose.yaw - before);
            before = seen.pose.yaw;
            (seen.at, turned)
        });
        unwrapped.collect()
    }

    /// Commands a second that the robot received, in windows of `window` seconds, by the middle of each.
    pub(crate) fn received_hz(&self, window: f64) -> Vec<(f64, f64)> {
        let commands: Vec<f64> = self.heard.iter().filter(|heard| heard.user.is_some()).map(|heard| heard.at).collect();
        let windows = (self.seconds() / window).floor() as usize;
        let rate = |number: usize| {
            let from = number as f64 * window;
            let count = commands.iter().filter(|at| (from..from + window).contains(at)).count();
            (from + window / 2.0, count as f64 / window)
        };
        (0..windows).map(rate).collect()
    }

    /// Each command's time from its publication to the robot (seconds), by the time of its publication.
    pub(crate) fn latencies(&self) -> Vec<(f64, f64)> {
        self.heard.iter().filter_map(|heard| heard.published.map(|at| (at, heard.at - at))).collect()
    }
}
