//! The experiment without its network: the parts that drive, figures, and claims about them.
//!
//! Pure: no process, socket, clock or file. Time is in seconds since the begin of a run, lengths in metres, angles in
//! radians. `crate::play` puts real nodes, bridges and DDS between these parts; docs/arena.md describes it.

pub(crate) mod baseline;
pub(crate) mod claims;
pub(crate) mod controller;
pub(crate) mod course;
#[cfg(test)]
pub(crate) mod drill;
pub(crate) mod figures;
pub(crate) mod geometry;
pub(crate) mod link;
pub(crate) mod noise;
pub(crate) mod record;
pub(crate) mod robot;

#[cfg(test)]
mod tests {
    use super::controller::Controller;
    use super::course::{Course, User};
    use super::robot::Turtlebot;

    #[test]
    fn a_controller_drives_the_robot_to_its_first_waypoint() {
        let course = Course::new(1.0);
        let mut robot = Turtlebot::new(course.start());
        let mut salma = Controller::new(course.waypoints(User::Salma));
        for tick in 0..500 {
            let now = f64::from(tick) * 0.02;
            robot.advance(now);
            salma.hear(now, now, robot.pose());
            robot.command(now, salma.command(now));
        }
        assert!(salma.reached() >= 1, "A1 is two metres away");
    }
}
