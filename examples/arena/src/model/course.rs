//! The arena, the users, their waypoints, and the order that each run plans.

use crate::model::geometry::{Point, Pose};
pub(crate) use ledgerd::demo::User;
use serde::Serialize;
use std::f64::consts::FRAC_PI_2;

/// Width of the arena (paper, "Environment"). The origin is its middle.
#[cfg(test)]
const WIDTH: f64 = 8.0;
/// Depth of the arena.
#[cfg(test)]
const DEPTH: f64 = 9.0;
/// Waypoints of each user.
pub(crate) const WAYPOINTS: usize = 3;
/// The least scale of a course: at less a robot of 0.34 m touches two waypoints at once.
pub(crate) const SCALE_MIN: f64 = 0.3;

/// Start, then A1 to A3, then B1 to B3. The paper shows its waypoints in a picture without numbers; these have its form: one
/// user's points on the left, the other's on the right, both from one start.
const START: Point = Point { x: 0.0, y: -2.4 };
const POINTS: [[Point; WAYPOINTS]; 2] = [
    [Point { x: -1.4, y: -1.2 }, Point { x: -1.8, y: 0.4 }, Point { x: -0.7, y: 1.6 }],
    [Point { x: 0.9, y: 1.6 }, Point { x: 1.8, y: 0.3 }, Point { x: 1.2, y: -1.3 }],
];

/// The letter of a user's waypoints.
pub(crate) fn letter(user: User) -> char {
    match user {
        User::Salma => 'A',
        User::Farhad => 'B',
    }
}

/// A waypoint of a user, by its number from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Waypoint {
    /// Its user.
    pub user: User,
    /// Its number, from zero.
    pub index: usize,
}

impl Waypoint {
    /// `A1` to `B3`.
    pub(crate) fn name(self) -> String {
        format!("{}{}", letter(self.user), self.index + 1)
    }
}

impl Serialize for Waypoint {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name())
    }
}

/// The start and the waypoints.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Course {
    scale: f64,
}

impl Course {
    /// The course, with all distances from the middle of the arena multiplied by `scale`.
    pub(crate) fn new(scale: f64) -> Self {
        Self { scale }
    }

    /// Its scale.
    pub(crate) fn scale(self) -> f64 {
        self.scale
    }

    fn scaled(self, point: Point) -> Point {
        Point { x: point.x * self.scale, y: point.y * self.scale }
    }

    /// Where the robot starts: it looks upwards.
    pub(crate) fn start(self) -> Pose {
        Pose { at: self.scaled(START), yaw: FRAC_PI_2 }
    }

    /// The waypoints of a user, in order.
    pub(crate) fn waypoints(self, user: User) -> [Point; WAYPOINTS] {
        let [salma, farhad] = POINTS;
        match user {
            User::Salma => salma,
            User::Farhad => farhad,
        }
        .map(|point| self.scaled(point))
    }

    /// Where a waypoint is.
    pub(crate) fn place(self, waypoint: Waypoint) -> Point {
        self.waypoints(waypoint.user).get(waypoint.index).copied().unwrap_or_default()
    }
}

/// The order in which two tasks, one after the other, reach their waypoints.
pub(crate) fn one_after_the_other() -> Vec<Waypoint> {
    User::ALL.into_iter().flat_map(|user| (0..WAYPOINTS).map(move |index| Waypoint { user, index })).collect()
}

/// The order if Farhad takes the robot when Salma has reached her first waypoint, and gives it back at his end.
pub(crate) fn interrupted() -> Vec<Waypoint> {
    let of = |user, indices: std::ops::Range<usize>| indices.map(move |index| Waypoint { user, index });
    of(User::Salma, 0..1).chain(of(User::Farhad, 0..WAYPOINTS)).chain(of(User::Salma, 1..WAYPOINTS)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_waypoint_is_within_the_arena_and_none_is_on_the_way_to_another() {
        let course = Course::new(1.0);
        let mut at = course.start().at;
        for waypoint in one_after_the_other() {
            let to = course.place(waypoint);
            assert!(to.x.abs() < WIDTH / 2.0 && to.y.abs() < DEPTH / 2.0, "{}", waypoint.name());
            for other in one_after_the_other().into_iter().filter(|other| *other != waypoint) {
                let place = course.place(other);
                let clear = place.distance_to_line(at, to) > 0.3 || place == at;
                assert!(clear, "{} is on the way to {}", other.name(), waypoint.name());
            }
            at = to;
        }
    }

    #[test]
    fn an_interrupted_task_goes_on_where_it_was() {
        let names: Vec<_> = interrupted().into_iter().map(Waypoint::name).collect();
        assert_eq!(names, ["A1", "B1", "B2", "B3", "A2", "A3"]);
    }
}
