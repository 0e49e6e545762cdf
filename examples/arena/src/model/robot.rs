//! The simulated Turtlebot4: a differential drive with limits of speed and acceleration, and a command timeout.
//!
//! The Turtlebot4 stands on an iRobot Create 3. Its limits are those that iRobot's own simulator gives its drive controller
//! (`create3_sim`, `irobot_create_control/config/control.yaml`), which are those of the data sheet.

use crate::model::geometry::{Point, Pose, wrapped};
pub(crate) use ledgerd::demo::Command;

/// Distance of the wheels (metres): `wheel_separation`.
pub(crate) const WHEELS_APART: f64 = 0.233;
/// Highest speed forwards, and of a wheel (m/s): `linear.x.max_velocity`, which `safety_override full` allows. With the safety
/// features on, the base goes 0.306 m/s.
pub(crate) const SPEED_MAX: f64 = 0.46;
/// Highest speed of a turn (rad/s): `angular.z.max_velocity`.
pub(crate) const TURN_MAX: f64 = 1.9;
/// Highest acceleration of a wheel (m/s²): `linear.x.max_acceleration`.
pub(crate) const ACCELERATION_MAX: f64 = 0.9;
/// Silence after which the base stops by itself (seconds): `cmd_vel_timeout`.
pub(crate) const COMMAND_TIMEOUT: f64 = 0.5;
/// Radius of the base (metres), for pictures: 341.9 mm across.
pub(crate) const RADIUS: f64 = 0.171;
/// Step of the simulation (seconds).
const STEP: f64 = 1.0 / 480.0;

/// The speeds of both wheels (m/s).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Wheels {
    left: f64,
    right: f64,
}

impl Wheels {
    /// As the drive controller takes a command: limited, and with the radius of the turn kept.
    fn of(command: Command) -> Self {
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        let linear = finite(command.linear).clamp(-SPEED_MAX, SPEED_MAX);
        let angular = finite(command.angular).clamp(-TURN_MAX, TURN_MAX);
        let half = angular * WHEELS_APART / 2.0;
        let (left, right) = (linear - half, linear + half);
        let by = (left.abs().max(right.abs()) / SPEED_MAX).max(1.0);
        Self { left: left / by, right: right / by }
    }
}

/// The robot.
#[derive(Clone, Debug)]
pub(crate) struct Turtlebot {
    pose: Pose,
    /// The wheels as they turn now.
    wheels: Wheels,
    /// The wheels as the last command wants them.
    wanted: Wheels,
    /// When the last command came.
    commanded: Option<f64>,
    /// How far it was simulated, in steps.
    steps: u64,
    /// The share of its order that each wheel really does: no two tyres are equal.
    tyres: Wheels,
}

impl Turtlebot {
    /// A robot that stands, at time zero.
    pub(crate) fn new(pose: Pose) -> Self {
        let (wheels, wanted) = Default::default();
        Self { pose, wheels, wanted, commanded: None, steps: 0, tyres: Wheels { left: 1.0, right: 1.0 } }
    }

    /// The same with tyres of other sizes, as shares of what they should be.
    pub(crate) fn with_tyres(self, left: f64, right: f64) -> Self {
        Self { tyres: Wheels { left, right }, ..self }
    }

    /// Takes a command at a time. Time never goes back: a command of the past counts now.
    pub(crate) fn command(&mut self, now: f64, command: Command) {
        self.advance(now);
        self.wanted = Wheels::of(command);
        self.commanded = Some(now);
    }

    /// Moves on to a time.
    pub(crate) fn advance(&mut self, now: f64) {
        while self.time() + STEP <= now {
            self.steps += 1;
            self.step();
        }
    }

    fn time(&self) -> f64 {
        self.steps as f64 * STEP
    }

    fn step(&mut self) {
        if self.commanded.is_some_and(|at| self.time() - at > COMMAND_TIMEOUT) {
            self.wanted = Wheels::default();
        }
        let most = ACCELERATION_MAX * STEP;
        let towards = |now: f64, wanted: f64| now + (wanted - now).clamp(-most, most);
        self.wheels = Wheels {
            left: towards(self.wheels.left, self.wanted.left),
            right: towards(self.wheels.right, self.wanted.right),
        };
        let (left, right) = (self.wheels.left * self.tyres.left, self.wheels.right * self.tyres.right);
        let turn = (right - left) / WHEELS_APART * STEP;
        let way = (left + right) / 2.0 * STEP;
        // On the arc of the step, its chord has the mean direction.
        let along = self.pose.yaw + turn / 2.0;
        let Point { x, y } = self.pose.at;
        self.pose = Pose {
            at: Point { x: x + way * along.cos(), y: y + way * along.sin() },
            yaw: wrapped(self.pose.yaw + turn),
        };
    }

    /// Where it is.
    pub(crate) fn pose(&self) -> Pose {
        self.pose
    }

    /// The speed of its faster wheel (m/s): zero only if it stands.
    pub(crate) fn speed(&self) -> f64 {
        self.wheels.left.abs().max(self.wheels.right.abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn driven(command: Command, seconds: f64) -> Turtlebot {
        let mut robot = Turtlebot::new(Pose::default());
        let mut now = 0.0;
        while now < seconds {
            robot.command(now, command);
            now += 0.02;
        }
        robot.advance(seconds);
        robot
    }

    #[test]
    fn it_gains_speed_no_faster_than_its_wheels_can() {
        let robot = driven(Command { linear: 0.4, angular: 0.0 }, 0.2);
        assert!((robot.speed() - 0.18).abs() < 0.01, "{}", robot.speed());
        assert!((driven(Command { linear: 9.0, angular: 0.0 }, 3.0).speed() - SPEED_MAX).abs() < 1e-9);
    }

    #[test]
    fn a_turn_on_the_spot_stays_on_the_spot() {
        let robot = driven(Command { linear: 0.0, angular: 1.0 }, 2.0);
        assert!(robot.pose().at.distance(Point::default()) < 1e-9);
        assert!(
            (robot.pose().yaw - 1.935).abs() < 0.01,
            "two radians less the way to that speed: {}",
            robot.pose().yaw
        );
    }

    #[test]
    fn a_command_beyond_its_wheels_keeps_the_radius_of_the_turn() {
        let wheels = Wheels::of(Command { linear: 0.46, angular: 1.9 });
        assert!((wheels.right - SPEED_MAX).abs() < 1e-12);
        let radius = (wheels.left + wheels.right) / 2.0 / ((wheels.right - wheels.left) / WHEELS_APART);
        assert!((radius - 0.46 / 1.9).abs() < 1e-9, "{radius}");
    }

    #[test]
    fn without_commands_it_stops_by_itself() {
        let mut robot = driven(Command { linear: 0.4, angular: 0.0 }, 1.0);
        robot.advance(1.0 + COMMAND_TIMEOUT - 0.05);
        assert!(robot.speed() > 0.39, "not before the timeout");
        robot.advance(1.0 + COMMAND_TIMEOUT + 0.5);
        assert_eq!(robot.speed(), 0.0);
    }

    #[test]
    fn numbers_that_are_none_move_nothing() {
        let robot = driven(Command { linear: f64::NAN, angular: f64::INFINITY }, 1.0);
        assert_eq!(robot.pose(), Pose::default());
    }

    #[test]
    fn unequal_tyres_pull_it_to_a_side() {
        let mut robot = Turtlebot::new(Pose::default()).with_tyres(1.0, 1.01);
        for tick in 0..200 {
            robot.command(f64::from(tick) * 0.02, Command { linear: 0.4, angular: 0.0 });
        }
        assert!(robot.pose().yaw > 0.03 && robot.pose().yaw < PI / 4.0, "{}", robot.pose().yaw);
    }
}
