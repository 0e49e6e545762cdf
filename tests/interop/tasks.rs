//! Tasks of two users, one after the other, at a controller that knows no ledger. CycloneDDS is at the robot's end.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, World};
use crate::{call, network};

const BRIDGE: &str = "domain_id = 3\nshared_memory = false\n[[route]]\nservice = 'Rover/cmd_vel'\n\
    direction = 'from_ledger'\ntype = 'geometry_msgs/msg/Twist'\ngoal_topic = '/goal_pose'\npath_topic = '/task/path'\n";

/// The robot's controller.
struct Controller(Python);

impl Controller {
    fn listen() -> Self {
        Self(Python::start("points_subscriber.py", &["3", "rt/goal_pose", "rt/task/path", "240"]))
    }

    /// Hears these goals and paths, each kind in this order. Between the paths of two tasks there may be an empty one.
    fn hears(&mut self, goals: &[&str], paths: &[&str]) {
        let (mut goals, mut paths) = (goals.iter().peekable(), paths.iter().peekable());
        while goals.peek().is_some() || paths.peek().is_some() {
            let line = self.0.line().expect("the controller hears of the task within a minute");
            match line.split_once(' ').unwrap() {
                ("goal", goal) => assert_eq!(Some(&goal), goals.next(), "{line}"),
                ("path", "") if paths.peek().is_some_and(|path| !path.is_empty()) => {}
                ("path", path) => assert_eq!(Some(&path.trim_end()), paths.next(), "{line}"),
                _ => panic!("{line}"),
            }
        }
    }
}

#[test]
fn tasks_of_two_users_reach_a_controller_one_after_the_other_and_a_stop_takes_them_away() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let owner = owner_of(&world).await;
        call(&owner, "configure", &["Rover/cmd_vel", r#"{"sharing":{"on_conflict":"queue"}}"#]).await;
        let _bridge = world.start_bridge_as("Rover", BRIDGE, &[]);
        let mut controller = Controller::listen();
        controller.hears(&[], &[""]);

        let points = r#"{"points":[{"x_um":1000000,"y_um":0},{"x_um":2000000,"y_um":-500000,"yaw_urad":1570796}],"lease_ms":600000}"#;
        call(&world.salma, "submit", &["Rover/cmd_vel", points]).await;
        controller.hears(&["map 1,0,0.000"], &["map 1,0,0.000 2,-0.5,1.571"]);
        let points = r#"{"points":[{"x_um":-1000000,"y_um":-250000}],"frame":"hall","lease_ms":600000}"#;
        call(&world.farhad, "submit", &["Rover/cmd_vel", points]).await;
        call(&world.salma, "progress", &["1", "1"]).await;
        controller.hears(&["map 2,-0.5,1.571"], &["map 2,-0.5,1.571"]);
        // One who comes late gets what is on show.
        Controller::listen().hears(&["map 2,-0.5,1.571"], &["map 2,-0.5,1.571"]);

        call(&world.salma, "progress", &["1", "2"]).await;
        controller.hears(&["hall -1,-0.25,0.000"], &["hall -1,-0.25,0.000"]);
        call(&owner, "stop", &["Rover", "person in the cell"]).await;
        controller.hears(&[], &[""]);
    });
}
