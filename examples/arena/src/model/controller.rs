//! A user's controller: it hears where the robot is, and commands it towards its next waypoint. It knows nothing of a
//! ledger, of other users, or of whether anybody obeys.

use crate::model::course::WAYPOINTS;
use crate::model::geometry::{Point, Pose, wrapped};
use crate::model::robot::{Command, SPEED_MAX, TURN_MAX};

/// Commands a second (paper).
pub(crate) const HZ: u32 = 50;
/// A waypoint is reached within this distance of it (metres), by what the controller knows.
pub(crate) const REACHED_WITHIN: f64 = 0.12;
/// Turn for each radian of wrong heading (1/s), if the feedback is fresh.
const TURN_GAIN_MAX: f64 = 3.0;
/// How much a turn may go on by old feedback: gain times the delay around the loop. A loop of pure delay begins to swing at π/2.
const TURN_BY_OLD_FEEDBACK: f64 = 0.5;
/// Weight of the newest pose in the mean age of the feedback: the last quarter of a second counts.
const AGE_WEIGHT: f64 = 0.03;
/// Speed for each metre of distance (1/s): it slows down on the last quarter of a metre.
const SPEED_GAIN: f64 = 2.0;
/// Heading (radians) off by more than this is mended on the spot.
const ON_THE_SPOT: f64 = 0.8;
/// Where the robot was longer ago than this (seconds) is not known any more.
const FEEDBACK_AGE_MAX: f64 = 1.0;

/// The controller of one task.
#[derive(Clone, Debug)]
pub(crate) struct Controller {
    waypoints: [Point; WAYPOINTS],
    /// How many it has reached.
    reached: usize,
    /// The last pose that it heard, and when.
    heard: Option<(f64, Pose)>,
    /// The mean age of what it hears (seconds).
    age: f64,
}

impl Controller {
    /// For these waypoints, in order.
    pub(crate) fn new(waypoints: [Point; WAYPOINTS]) -> Self {
        Self { waypoints, reached: 0, heard: None, age: 0.0 }
    }

    /// How many waypoints it has reached.
    #[cfg(test)]
    pub(crate) fn reached(&self) -> usize {
        self.reached
    }

    /// Has it reached the last one?
    pub(crate) fn is_done(&self) -> bool {
        self.reached >= self.waypoints.len()
    }

    /// Hears where the robot was at a time, as the stamp of the message says. Answers with the number of the waypoint that
    /// it has reached by that.
    pub(crate) fn hear(&mut self, now: f64, stamp: f64, pose: Pose) -> Option<usize> {
        let age = (now - stamp).max(0.0);
        self.age = if self.heard.is_none() { age } else { self.age + AGE_WEIGHT * (age - self.age) };
        self.heard = Some((now, pose));
        let next = self.waypoints.get(self.reached)?;
        if pose.at.distance(*next) > REACHED_WITHIN {
            return None;
        }
        self.reached += 1;
        Some(self.reached - 1)
    }

    /// Commands take as long as the feedback does: so long nothing is known of what a turn has done.
    fn turn_gain(&self) -> f64 {
        (TURN_BY_OLD_FEEDBACK / (2.0 * self.age).max(f64::EPSILON)).min(TURN_GAIN_MAX)
    }

    /// The command for now: to stand still at the end, or while it is not known where the robot is.
    pub(crate) fn command(&self, now: f64) -> Command {
        let fresh = self.heard.filter(|(at, _)| now - at <= FEEDBACK_AGE_MAX);
        let (Some((_, pose)), Some(next)) = (fresh, self.waypoints.get(self.reached)) else { return Command::STOP };
        let off = wrapped(pose.at.heading(*next) - pose.yaw);
        let share = (1.0 - off.abs() / ON_THE_SPOT).max(0.0);
        Command {
            linear: (SPEED_GAIN * pose.at.distance(*next)).min(SPEED_MAX) * share,
            angular: (self.turn_gain() * off).clamp(-TURN_MAX, TURN_MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::course::{Course, User};
    use crate::model::noise::Noise;

    fn controller() -> Controller {
        Controller::new(Course::new(1.0).waypoints(User::Salma))
    }

    #[test]
    fn it_stands_still_while_it_does_not_know_where_the_robot_is() {
        let mut controller = controller();
        assert_eq!(controller.command(0.0), Command::STOP, "nothing was heard yet");
        controller.hear(0.0, 0.0, Course::new(1.0).start());
        assert_ne!(controller.command(0.5), Command::STOP);
        assert_eq!(controller.command(FEEDBACK_AGE_MAX + 0.1), Command::STOP, "that was long ago");
    }

    #[test]
    fn a_waypoint_is_reached_once_and_only_in_its_order() {
        let mut controller = controller();
        let points = Course::new(1.0).waypoints(User::Salma);
        let at = |index: usize| Pose { at: points[index], yaw: 0.0 };
        assert_eq!(controller.hear(0.0, 0.0, at(1)), None, "the second is not the next one");
        assert_eq!(controller.hear(0.1, 0.1, at(0)), Some(0));
        assert_eq!(controller.hear(0.2, 0.2, at(0)), None);
        assert_eq!(controller.hear(0.3, 0.3, at(1)), Some(1));
        assert_eq!(controller.hear(0.4, 0.4, at(2)), Some(2));
        assert!(controller.is_done());
        assert_eq!(controller.command(0.4), Command::STOP);
    }

    #[test]
    fn the_older_its_feedback_the_gentler_it_turns() {
        let turn = |age: f64| {
            let mut controller = controller();
            controller.hear(age, 0.0, Pose { yaw: 2.6, ..Course::new(1.0).start() });
            controller.command(age).angular.abs()
        };
        assert!(turn(0.3) < 0.5 * turn(0.01), "{} and {}", turn(0.3), turn(0.01));
    }

    #[test]
    fn every_command_is_within_what_the_robot_can_do() {
        let mut noise = Noise::new(7);
        let mut controller = controller();
        for _ in 0..1000 {
            let at = Point { x: noise.uniform() * 8.0 - 4.0, y: noise.uniform() * 9.0 - 4.5 };
            controller.hear(0.0, 0.0, Pose { at, yaw: noise.uniform() * 6.0 - 3.0 });
            let Command { linear, angular } = controller.command(0.0);
            assert!((0.0..=SPEED_MAX).contains(&linear) && angular.abs() <= TURN_MAX);
        }
    }
}
