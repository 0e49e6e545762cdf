//! Actions of the robot, used from a user's graph through the ledger. CycloneDDS is client and server.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, Process, World};
use crate::{call, network};
use ledger_api::Client;
use rustix::process::{Pid, Signal, kill_process};
use std::time::{Duration, Instant};

const TYPE: &str = "example_interfaces/action/Fibonacci";
/// A goal that does not end within a test.
const LONG: &str = "1000000";
/// A machine under load must not be taken for a network that is silent.
pub(crate) const PATIENT: &str = "stale_after_ms = 10000";

/// A lease that no test outlives.
const PATIENTLY: &str = "600000";
/// A lease that is waited for, and is longer than a client takes to start.
const SHORTLY: &str = "10000";

/// A network whose robot has the action, in this mode and with a lease of five seconds.
async fn with_action(mode: &str) -> (World, Client) {
    with_action_of(TYPE, mode).await
}

/// The same with another type.
pub(crate) async fn with_action_of(of: &str, mode: &str) -> (World, Client) {
    let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
    let owner = owner_of(&world).await;
    let service = |topic: &str, direction: &str, mode: &str| serde_json::json!({ "topic": topic, "type": of, "direction": direction, "mode": mode, "max_age_ms": 5000, "lease_ms": 5000 });
    let services = [service("/count", "command", mode), service("/count/_reply", "feed", "open")];
    let spec = serde_json::json!({ "name": "Rover", "attribute_required": "Rover", "trusted": ["Org1", "Org2"], "services": services });
    call(&owner, "replace", &[&spec.to_string()]).await;
    (world, owner)
}

/// Takes the action for a user for so long, and waits until that user's bridge has heard of it.
async fn acquire(world: &World, name: &str, lease_ms: &str) {
    let before = world.lines(name, "grant held");
    let client = if name == "Salma" { &world.salma } else { &world.farhad };
    call(client, "acquire", &["Rover/count", lease_ms]).await;
    world.another_line(name, "grant held", before).await;
}

fn bridge(world: &World, name: &str, domain: u16, direction: &str, more: &str) -> Process {
    bridge_of(TYPE, world, (name, domain), direction, more)
}

/// The same for another type.
pub(crate) fn bridge_of(of: &str, world: &World, (name, domain): (&str, u16), direction: &str, more: &str) -> Process {
    let route = format!("[[route]]\nservice = 'Rover/count'\ndirection = '{direction}'\ntype = '{of}'\n{more}\n");
    world.start_bridge_as(name, &format!("domain_id = {domain}\nshared_memory = false\n{route}"), &[])
}

/// The robot's own server.
fn server(more: &[&str]) -> Python {
    let mut server = Python::start("actions.py", &[&["serve", "3", "/count"], more].concat());
    assert_eq!(server.line().unwrap(), "ready");
    server
}

/// A client in a user's domain that sets a goal.
fn client(domain: &str, wait: &str, order: &str, more: &[&str]) -> Python {
    let mut client = Python::start("actions.py", &[&["send", domain, "/count", wait, order], more].concat());
    assert_eq!(client.line().unwrap(), "matched");
    client
}

/// Sets goals until the robot's bridge has found its server. One that nobody answers is cancelled.
fn first_goal(domain: &str, server: &mut Python, logs: &World) {
    let deadline = Instant::now() + Duration::from_secs(120);
    while client(domain, "20", "1", &[]).line().unwrap() != "accepted True" {
        assert!(Instant::now() < deadline, "no goal is ever accepted\n{}", logs.logs());
    }
    assert_eq!(but_for_cancels(server), "goal 1", "{}", logs.logs());
    assert_eq!(server.line().unwrap(), "ended 4", "{}", logs.logs());
}

/// The next line of a server that is not about the cancelling of an earlier goal.
fn but_for_cancels(server: &mut Python) -> String {
    loop {
        let line = server.line().unwrap();
        if line != "cancel" {
            return line;
        }
    }
}

/// A goal that runs, seen from both ends.
fn running(domain: &str, server: &mut Python) -> Python {
    let mut client = client(domain, "60", LONG, &[]);
    assert_eq!(client.line().unwrap(), "accepted True");
    assert_eq!(client.line().unwrap(), "feedback");
    assert_eq!(server.line().unwrap(), format!("goal {LONG}"));
    client
}

#[test]
fn the_holder_alone_sets_goals_and_has_their_feedback_their_states_and_their_results() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let salma = bridge(&world, "Salma", 1, "action_server", "");
        let farhad = bridge(&world, "Farhad", 2, "action_server", "");
        let robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut server = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut server, &world);

        let mut salmas = client("1", "60", "20", &[]);
        assert_eq!(salmas.line().unwrap(), "accepted True", "{}", world.logs());
        assert_eq!(salmas.line().unwrap(), "feedback", "{}", world.logs());
        assert_eq!(salmas.line().unwrap(), "result 4 22", "{}", world.logs());
        let states = salmas.line().unwrap();
        assert!(states.ends_with("4]"), "{states}");
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["goal 20", "ended 4"]);

        // One who may not is told so, and the robot hears nothing of it.
        assert_eq!(client("2", "20", "20", &[]).line().unwrap(), "accepted False");
        world.line("Farhad", &["the ledger refuses samples"]).await;

        // Cancelled by the one who set it.
        let mut cancelled = client("1", "60", LONG, &["cancel"]);
        let lines = [(); 4].map(|()| cancelled.line().unwrap());
        assert_eq!(lines[..2], ["accepted True", "feedback"], "{}", world.logs());
        // The server ends the goal when it answers, so both answers are under way together.
        assert!(lines[2..].contains(&"cancelling 0 1".to_owned()), "{lines:?}");
        assert!(lines[2..].iter().any(|line| line.starts_with("result 5")), "{lines:?}");
        let next = [(); 3].map(|()| server.line().unwrap());
        assert_eq!(next, [&format!("goal {LONG}"), "cancel", "ended 5"]);

        let [salma, farhad, robot] = [salma, farhad, robot].map(|bridge| bridge.report()["routes"][0].clone());
        assert_eq!(farhad["refused"]["NOT_HOLDER"], 1, "{farhad}");
        assert_eq!(salma["refused"], serde_json::json!({}), "{salma}");
        assert_eq!(robot["stops"], serde_json::json!({}), "{robot}");
    });
}

#[test]
fn a_goal_whose_grant_ends_is_cancelled_and_its_client_hears_of_it() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, owner) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let farhad = bridge(&world, "Farhad", 2, "action_server", "");
        let robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut server = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut server, &world);

        // Given back while the goal runs. Until then its own signs of life have kept the grant, beyond its lease.
        let mut goal = running("1", &mut server);
        call(&world.salma, "renew", &["Rover/count", "6000"]).await;
        let until = Instant::now() + Duration::from_secs(9);
        while Instant::now() < until {
            tokio::time::sleep(Duration::from_millis(100)).await;
            let grants = owner.query("abac", "grants", vec!["Rover/count".into()]).await.unwrap().response;
            assert_ne!(grants[..], b"[]"[..], "the grant of a running goal has ended\n{}", world.logs());
        }
        call(&world.salma, "release", &["Rover/count"]).await;
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        let result = goal.line().unwrap();
        assert!(result.starts_with("result 5"), "{result}");

        // An emergency stop.
        acquire(&world, "Farhad", PATIENTLY).await;
        let mut goal = running("2", &mut server);
        call(&owner, "stop", &["Rover"]).await;
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        assert!(goal.line().unwrap().starts_with("result 5"));
        call(&owner, "resume", &["Rover"]).await;

        // A bridge that was killed: nobody uses the grant, and its lease ends.
        acquire(&world, "Farhad", SHORTLY).await;
        let goal = running("2", &mut server);
        drop(farhad);
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        drop(goal);

        let robot = robot.report()["routes"][0].clone();
        assert!(robot["stops"]["released"].as_u64().unwrap() > 0, "{robot}");
        assert!(robot["stops"]["stopped"].as_u64().unwrap() > 0, "{robot}");
    });
}

#[test]
fn a_goal_ends_with_the_robots_bridge_or_with_its_client() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut server = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut server, &world);

        // Nobody is there any more for whom it runs. That is no matter of the lease.
        drop(running("1", &mut server));
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());

        let _goal = running("1", &mut server);
        robot.report();
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
    });
}

#[test]
fn a_goal_that_takes_too_long_is_cancelled_until_it_ends_and_a_silent_server_is_one_that_refuses() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("open").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "reply_timeout_ms = 15000");
        let more = "goal_timeout_ms = 4000\nserver_timeout_ms = 5000\nstale_after_ms = 10000";
        let robot = bridge(&world, "Rover", 3, "action_client", more);
        let mut stubborn = server(&["stubborn"]);
        first_goal("1", &mut stubborn, &world);
        let goal = running("1", &mut stubborn);
        // It refuses, and is asked again.
        assert_eq!([stubborn.line().unwrap(), stubborn.line().unwrap()], ["cancel", "cancel"], "{}", world.logs());
        world.line("Rover", &["THE ROBOT REFUSES TO CANCEL A GOAL"]).await;
        // The client before the server: a goal that the robot has lost has no client any more.
        drop(goal);
        world.line("Salma", &["the client of a goal has left"]).await;
        drop(stubborn);
        world.line("Rover", &["the action server has left"]).await;

        // A bridge with a log of its own. The goal is told to be refused. So it must not run, should the server have heard of it.
        robot.report();
        let _robot = bridge(&world, "Rover", 3, "action_client", more);
        let mut silent = server(&["silent"]);
        let deadline = Instant::now() + Duration::from_secs(60);
        while world.has_not_said("Rover", "the action server has not replied in time") {
            assert!(Instant::now() < deadline, "{}", world.logs());
            assert_eq!(client("1", "20", "5", &[]).line().unwrap(), "accepted False");
        }
        assert_eq!(but_for_cancels(&mut silent), "goal 5");
        assert_eq!(silent.line().unwrap(), "cancel");
    });
}

#[test]
fn a_goal_whose_client_has_left_is_cancelled_and_those_of_others_go_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let _robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut server = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut server, &world);

        let gone = running("1", &mut server);
        let mut stays = client("1", "180", LONG, &["beside"]);
        assert_eq!([stays.line().unwrap(), stays.line().unwrap()], ["accepted True", "feedback"], "{}", world.logs());
        assert_eq!(server.line().unwrap(), format!("goal {LONG}"));
        drop(gone);
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        world.line("Salma", &["the client of a goal has left"]).await;

        // The other one runs until the grant ends.
        assert_eq!(stays.try_line(), None, "{}", world.logs());
        call(&world.salma, "release", &["Rover/count"]).await;
        assert!(stays.line().unwrap().starts_with("result 5"), "{}", world.logs());
        assert_eq!(but_for_cancels(&mut server), "ended 5", "{}", world.logs());
    });
}

#[test]
fn a_bridge_that_comes_back_cancels_the_goals_that_run_and_none_that_others_set_later() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut first = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut first, &world);

        // One that is killed cancels nothing.
        let _goal = running("1", &mut first);
        drop(robot);
        let _robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        assert_eq!([first.line().unwrap(), first.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        world.line("Rover", &["it ran when the bridge came"]).await;

        // A goal of the robot's own, on a server that the bridge hears for the first time. Salma's goal comes after it.
        drop(first);
        let mut second = server(&[]);
        let mut own = client("3", "180", LONG, &["beside"]);
        assert_eq!([own.line().unwrap(), own.line().unwrap()], ["accepted True", "feedback"], "{}", world.logs());
        assert_eq!(second.line().unwrap(), format!("goal {LONG}"));
        first_goal("1", &mut second, &world);
        assert_eq!((own.try_line(), second.try_line()), (None, None), "{}", world.logs());
    });
}

#[test]
fn a_goal_that_a_robot_has_lost_as_it_started_again_keeps_no_grant() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut first = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut first, &world);

        // The client stays.
        let _goal = running("1", &mut first);
        drop((robot, first));
        let _robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        world.line("Salma", &["the robot has lost a goal"]).await;
    });
}

#[test]
fn the_goals_of_a_server_that_stood_still_are_cancelled_when_it_comes_back() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("exclusive").await;
        let _salma = bridge(&world, "Salma", 1, "action_server", "");
        let _robot = bridge(&world, "Rover", 3, "action_client", PATIENT);
        let mut server = server(&[]);
        acquire(&world, "Salma", PATIENTLY).await;
        first_goal("1", &mut server, &world);

        let _goal = running("1", &mut server);
        let pid = Pid::from_child(&server.child);
        kill_process(pid, Signal::STOP).unwrap();
        world.line("Rover", &["the action server has left"]).await;
        kill_process(pid, Signal::CONT).unwrap();
        assert_eq!([server.line().unwrap(), server.line().unwrap()], ["cancel", "ended 5"], "{}", world.logs());
        world.line("Rover", &["its server has come back"]).await;
    });
}

#[test]
fn an_action_that_neither_bridge_names_is_offered_and_its_goals_run() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _) = with_action("open").await;
        let discover = |name: &str, domain: u16, more: &str| {
            let settings = format!("domain_id = {domain}\nshared_memory = false\n[discover]\n{more}");
            world.start_bridge_as(name, &settings, &[])
        };
        let _salma = discover("Salma", 1, "remap = { 'Rover/count' = '/count' }");
        let _robot = discover("Rover", 3, "robot = 'Rover'");
        let mut server = server(&[]);
        first_goal("1", &mut server, &world);
    });
}
