//! Points, poses and angles in the plane.

use serde::Serialize;
use std::f64::consts::{PI, TAU};

/// A point of the arena (metres).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Point {
    /// To the right.
    pub x: f64,
    /// Upwards.
    pub y: f64,
}

impl Point {
    /// The distance to another point.
    pub(crate) fn distance(self, other: Self) -> f64 {
        (other.x - self.x).hypot(other.y - self.y)
    }

    /// The direction in which another point lies, from the x axis.
    pub(crate) fn heading(self, other: Self) -> f64 {
        (other.y - self.y).atan2(other.x - self.x)
    }

    /// The distance to the straight line between two points.
    pub(crate) fn distance_to_line(self, from: Self, to: Self) -> f64 {
        let (along_x, along_y) = (to.x - from.x, to.y - from.y);
        let length = along_x * along_x + along_y * along_y;
        let share = match length > 0.0 {
            true => ((self.x - from.x) * along_x + (self.y - from.y) * along_y) / length,
            false => 0.0,
        };
        let share = share.clamp(0.0, 1.0);
        self.distance(Self { x: from.x + share * along_x, y: from.y + share * along_y })
    }
}

/// Where something is, and where it looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Pose {
    /// Its place.
    pub at: Point,
    /// Its direction, from the x axis towards the y axis (radians).
    pub yaw: f64,
}

/// The same direction within half a turn either way.
pub(crate) fn wrapped(angle: f64) -> f64 {
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned < -PI { PI } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_brought_within_half_a_turn() {
        for (angle, wanted) in [(0.0, 0.0), (3.0 * PI / 2.0, -PI / 2.0), (-7.0, TAU - 7.0), (TAU, 0.0)] {
            assert!((wrapped(angle) - wanted).abs() < 1e-12, "{angle}");
        }
    }

    #[test]
    fn the_distance_to_a_line_ends_at_its_ends() {
        let point = |x, y| Point { x, y };
        let to_line = |from: Point| from.distance_to_line(point(0.0, 0.0), point(2.0, 0.0));
        assert_eq!(to_line(point(1.0, 0.5)), 0.5);
        assert_eq!(to_line(point(5.0, 4.0)), 5.0, "beyond its end");
        assert_eq!(point(3.0, 4.0).distance_to_line(point(0.0, 0.0), point(0.0, 0.0)), 5.0, "a line without length");
    }
}
