//! Very many rights: none of them keeps others from ending, and what cannot be told at once is told by the following blocks.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, identity, owner, robot, salma};
use crate::tasks::{is, submit, two};
use ledger_abac::{EmergencyAnswer, Left, TaskState};
use ledger_identity::{Identity, Role};

/// Most events of a block that no transaction asked for.
const TOLD_MAX: usize = 1024;
const QUEUED: &str = r#""mode":"exclusive","sharing":{"on_conflict":"queue","queue_max":1024}"#;

fn user(number: usize) -> Identity {
    let serial = u16::try_from(number).unwrap().to_be_bytes();
    let mut user = salma();
    (user.name, user.serial) = (format!("user{number:04}"), [&[9], &serial[..]].concat());
    user.fingerprint[..2].copy_from_slice(&serial);
    user
}

/// A robot with so many services, each of which is described so.
fn with_services(name: &str, described: &str, count: usize) -> String {
    let service = |n| format!(r#"{{"topic":"/t{n}","type":"geometry_msgs/msg/Twist",{described}}}"#);
    let services: Vec<String> = (0..count).map(service).collect();
    format!(
        r#"{{"name":"{name}","attribute_required":"Turtlebot4","trusted":["Org1","Org2"],"services":[{}]}}"#,
        services.join(",")
    )
}

/// Blocks as the leader orders them, until nothing is due at once.
fn settle(fleet: &mut Fleet) -> usize {
    for blocks in 0..100 {
        if fleet.next_deadline().is_none_or(|due| due > fleet.time) {
            return blocks;
        }
        let before = fleet.events.len();
        fleet.tick();
        assert!(fleet.events.len() - before <= TOLD_MAX);
    }
    panic!("it never ends");
}

#[test]
fn a_task_waits_while_a_service_has_as_many_holders_as_there_may_be() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open")]);
    for number in 0..256 {
        fleet.ok(&user(number), "acquire", &[TURTLEBOT, "600000"]);
    }
    let last = Identity { name: "zoe".to_owned(), ..user(1000) };
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 5 * SECOND));
    submit(&mut fleet, &last, &later);
    submit(&mut fleet, &last, &later);
    fleet.time += 5 * SECOND;
    for _ in 0..3 {
        fleet.tick();
    }
    is(&fleet, 1, TaskState::Waiting);
    assert_eq!(fleet.keys("grant/"), 256);
    fleet.ok(&user(7), "release", &[TURTLEBOT]);
    fleet.tick();
    is(&fleet, 1, TaskState::Running);
    is(&fleet, 2, TaskState::Waiting);
    assert_eq!(fleet.keys("grant/"), 256);
}

#[test]
fn the_end_of_very_many_places_in_line_is_told_over_several_blocks() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&with_services("Turtlebot4", QUEUED, 5)]);
    for (number, topic) in (0..300).flat_map(|number| (0..5).map(move |topic| (number, topic))) {
        fleet.ok(&user(number), "acquire", &[&format!("Turtlebot4/t{topic}"), "600000"]);
    }
    let (places, since) = (fleet.keys("line/"), fleet.events.len());
    assert_eq!(places, 5 * 299, "one of them holds each service");
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    assert!(settle(&mut fleet) > 1);
    let left = fleet.events[since..].iter().filter(|event| event.name == "left");
    let left: Vec<Left> = left.map(|event| serde_json::from_slice(&event.payload).unwrap()).collect();
    assert_eq!((left.len(), fleet.keys("line/")), (places, 0));
}

#[test]
fn a_certificate_that_reads_very_much_can_be_revoked() {
    let mut fleet = Fleet::empty();
    let monitor = identity("Org2", "Monitor", Role::Admin, &[], 51);
    for number in 0..18 {
        let name = format!("Robot{number}");
        fleet.ok(&owner(), "setup", &[&with_services(&name, r#""direction":"feed""#, 64)]);
        for topic in 0..64 {
            fleet.ok(&monitor, "reader", &[&format!("{name}/t{topic}"), &"0a".repeat(32)]);
        }
    }
    assert_eq!(fleet.keys("reader/"), 18 * 64);
    fleet.revoke(&monitor);
    assert_eq!((fleet.keys("reader/"), fleet.keys("reading/")), (0, 0));
}

#[test]
fn all_robots_stop_however_many_there_are() {
    let mut fleet = Fleet::empty();
    fleet.members.3.lock().unwrap().robots = 1100;
    for fifty in 0..22 {
        let robots: Vec<String> = (0..50).map(|n| robot(&format!("R{fifty:02}{n:02}"), "exclusive")).collect();
        let robots: Vec<&str> = robots.iter().map(String::as_str).collect();
        fleet.ok(&owner(), "setup", &robots);
    }
    let stopped: EmergencyAnswer = fleet.get(&owner(), "stop", &["*", "smoke"]);
    assert_eq!((stopped.robots.len(), fleet.keys("stopped/")), (1100, 1100));
    let resumed: EmergencyAnswer = fleet.get(&owner(), "resume", &["*"]);
    assert_eq!((resumed.robots.len(), fleet.keys("stopped/")), (1100, 0));
}
