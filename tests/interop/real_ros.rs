//! A service and an action through the ledger, with rclpy at both ends: what people of ROS 2 run.

use crate::actions::{self, PATIENT};
use crate::python::Python;
use crate::rclpy::{command, is_there, script};
use crate::world::{self, World};
use crate::{call, calls, network};
use std::time::{Duration, Instant};

/// The domains of Salma, Farhad and the robot.
const SALMA: u16 = 1;
const FARHAD: u16 = 2;
const ROBOT: u16 = 3;
/// A goal that does not end within a test.
const LONG: &str = "1000000";

fn started(name: &str, domain: u16, args: &[&str], first: &str) -> Python {
    let mut script = script(name, domain, args);
    assert_eq!(script.line().as_deref(), Some(first), "{name} {args:?}");
    script
}

#[test]
fn rclpy_calls_a_service_of_rclpy_through_the_ledger_and_only_for_its_holder() {
    if !is_there() || !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = calls::with_light("exclusive").await;
        let _salma = calls::bridge(&world, "Salma", SALMA, "service_server", "");
        let _farhad = calls::bridge(&world, "Farhad", FARHAD, "service_server", "");
        let _robot = calls::bridge(&world, "Rover", ROBOT, "service_client", "");
        let mut server = started("service.py", ROBOT, &["serve", "/light"], "ready");
        call(&world.salma, "acquire", &["Rover/light", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        let client = |domain, wait: &str, values: &[&str]| {
            started("service.py", domain, &[&["call", "/light", wait], values].concat(), "matched")
        };
        // Until the robot's bridge has found the server.
        let deadline = Instant::now() + Duration::from_secs(60);
        while client(SALMA, "2", &["true"]).line().as_deref() == Some("none") {
            assert!(Instant::now() < deadline, "the server is never called\n{}", world.logs());
        }
        let mut salma = client(SALMA, "20", &["false", "true", "false"]);
        for wanted in ["False from /light", "True from /light", "False from /light"] {
            assert_eq!(salma.line().as_deref(), Some(wanted), "{}", world.logs());
        }
        assert_eq!(client(FARHAD, "3", &["true"]).line().as_deref(), Some("none"));
        world.line("Farhad", &["the ledger refuses samples"]).await;
        // Farhad's call would stand between these.
        salma = client(SALMA, "20", &["true"]);
        assert_eq!(salma.line().as_deref(), Some("True from /light"));
        let mut requests: Vec<String> = Vec::new();
        while !requests.ends_with(&["False", "True", "False", "True"].map(|value| format!("request {value}"))) {
            requests.push(server.line().unwrap_or_else(|| panic!("{requests:?}\n{}", world.logs())));
        }
    });
}

/// Sets goals until the robot's bridge has found its server.
fn first_goal(world: &World, server: &mut Python) {
    let deadline = Instant::now() + Duration::from_secs(60);
    let goal = || started("action.py", SALMA, &["send", "/count", "20", "1"], "matched").line();
    while goal().as_deref() != Some("accepted True") {
        assert!(Instant::now() < deadline, "no goal is ever accepted\n{}", world.logs());
    }
    assert_eq!([server.line().unwrap(), server.line().unwrap()], ["goal 1", "ended 4"]);
}

#[test]
fn rclpy_sets_and_cancels_goals_of_rclpy_through_the_ledger_and_losing_the_grant_cancels_one() {
    if !is_there() || !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let told = command("action.py", ROBOT, &["type"]).output().unwrap().stdout;
        let of = String::from_utf8(told).unwrap().trim().to_owned();
        let (world, _) = actions::with_action_of(&of, "exclusive").await;
        let _salma = actions::bridge_of(&of, &world, ("Salma", SALMA), "action_server", "");
        let _farhad = actions::bridge_of(&of, &world, ("Farhad", FARHAD), "action_server", "");
        let _robot = actions::bridge_of(&of, &world, ("Rover", ROBOT), "action_client", PATIENT);
        let mut server = started("action.py", ROBOT, &["serve", "/count"], "ready");
        call(&world.salma, "acquire", &["Rover/count", "600000"]).await;
        world.line("Salma", &["grant held"]).await;
        first_goal(&world, &mut server);

        let goal = |domain, order: &str, more: &[&str]| {
            started("action.py", domain, &[&["send", "/count", "60", order], more].concat(), "matched")
        };
        let mut whole = goal(SALMA, "20", &[]);
        assert_eq!([(); 3].map(|()| whole.line().unwrap()), ["accepted True", "feedback", "result 4 22"]);
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["goal 20", "ended 4"]);

        assert_eq!(goal(FARHAD, "20", &[]).line().as_deref(), Some("accepted False"));

        let mut cancelled = goal(SALMA, LONG, &["cancel"]);
        assert_eq!([(); 3].map(|()| cancelled.line().unwrap()), ["accepted True", "feedback", "cancelling 0"]);
        assert!(cancelled.line().unwrap().starts_with("result 5 "), "{}", world.logs());
        assert_eq!([(); 3].map(|()| server.line().unwrap()), [&format!("goal {LONG}"), "cancel", "ended 5"]);

        // As with Nav2: who loses the grant loses the goal.
        let mut lost = goal(SALMA, LONG, &[]);
        assert_eq!([lost.line().unwrap(), lost.line().unwrap()], ["accepted True", "feedback"]);
        call(&world.salma, "release", &["Rover/count"]).await;
        assert!(lost.line().unwrap().starts_with("result 5 "), "{}", world.logs());
        assert_eq!([(); 3].map(|()| server.line().unwrap()), [&format!("goal {LONG}"), "cancel", "ended 5"]);
    });
}
