//! A robot whose subscriber requests a deadline and a liveliness: it receives its commands and stops, and its own watchdog sees that the
//! driver is silent. CycloneDDS and rclpy are the robots.

use crate::python::Python;
use crate::sharing::drives;
use crate::world::{self, World};
use crate::{call, network, rclpy};

const TYPE: &str = "geometry_msgs/msg/Twist";
/// The deadline and the lease that the robot requests, milliseconds.
const REQUESTED: &str = "500";

/// Reads lines of the robot until each of these has come `count` times.
fn until(robot: &mut Python, wanted: &[&str], count: usize, world: &World) {
    let mut lines: Vec<String> = Vec::new();
    while wanted.iter().any(|wanted| lines.iter().filter(|line| line == wanted).count() < count) {
        let line = robot.line();
        lines.push(line.unwrap_or_else(|| panic!("not {count} times {wanted:?}: {lines:?}\n{}", world.logs())));
    }
}

async fn a_driver_drives_and_is_silent(robot: impl FnOnce() -> Python) {
    let world = World::start("/cmd_vel", TYPE).await;
    let _salma = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TYPE);
    let _rover = world.start_default_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
    let mut robot = robot();
    until(&mut robot, &["ready"], 1, &world);
    world.line("Rover", &["deadline 500ms, liveliness 500ms: as the others on /cmd_vel"]).await;
    call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
    for _ in 0..2 {
        let teleop = drives("1", "1");
        until(&mut robot, &["drive"], 20, &world);
        drop(teleop);
        until(&mut robot, &["stop"], 1, &world);
        // No timer of the bridge keeps the promise: the robot's watchdog takes effect.
        until(&mut robot, &["lost", "late"], 1, &world);
    }
    let logs = world.logs();
    assert!(!logs.contains("requests more than this route offers"), "{logs}");
}

#[test]
fn a_robot_on_cyclonedds_with_a_watchdog_receives_commands_and_stops_and_sees_a_silent_driver() {
    if network::isolated(&|| ()) {
        world::run(a_driver_drives_and_is_silent(|| Python::start("watchdog.py", &["3", "rt/cmd_vel", REQUESTED])));
    }
}

#[test]
fn a_robot_on_fast_dds_with_a_watchdog_receives_commands_and_stops_and_sees_a_silent_driver() {
    if rclpy::is_there() && network::isolated(&|| ()) {
        world::run(a_driver_drives_and_is_silent(|| rclpy::script("watchdog.py", 3, &["/cmd_vel", REQUESTED])));
    }
}
