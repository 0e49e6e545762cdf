//! Bad input about who wins, and about tasks: each is refused with a code, with what was found and wanted, and with what to
//! try. None makes a block work longer than for a bounded time.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, admin1, farhad, identity, owner, salma};
use crate::tasks::{TWO, queued, ranked, submit, task, two};
use ledger_abac::{Left, LeftReason, LineState, TaskState};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

/// A call that is refused with this code, and with words that contain these parts: found, wanted, what to try.
#[track_caller]
fn bad(fleet: &mut Fleet, who: &Identity, code: Code, call: (&str, &[&str]), parts: [&str; 3]) {
    let refused = fleet.refused(who, code, call.0, call.1);
    let told = [&*refused.found, &refused.wanted, refused.advice()];
    let fits = told.iter().zip(parts).all(|(told, part)| !told.is_empty() && told.contains(part));
    assert!(fits && !refused.message.is_empty(), "{call:?}: {refused}");
}

#[track_caller]
fn settings_refused(fleet: &mut Fleet, settings: &str, parts: [&str; 3]) {
    bad(fleet, &owner(), Code::BadArgument, ("configure", &[TURTLEBOT, settings]), parts);
}

#[test]
fn numbers_of_holders_readers_places_and_confirmations_are_within_their_bounds() {
    let mut fleet = Fleet::of_the_paper();
    let huge = "18446744073709551615";
    for (key, most, rest) in [
        ("publishers", "256", r#""mode":"limited","#),
        ("subscribers", "256", r#""mode":"limited","#),
        ("queue_max", "1024", ""),
        ("confirm", "16", ""),
    ] {
        let line = if key == "queue_max" { r#","on_conflict":"queue""# } else { "" };
        let with = |number: &str| format!(r#"{{{rest}"sharing":{{"{key}":{number}{line}}}}}"#);
        let wanted = format!("1 to {most}");
        for number in ["0", &(most.parse::<u64>().unwrap() + 1).to_string(), huge] {
            settings_refused(&mut fleet, &with(number), [number, &wanted, "within this range"]);
        }
        for number in ["-1", "1.5", "\"2\"", "99999999999999999999999", "NaN"] {
            settings_refused(&mut fleet, &with(number), ["", "sharing", "configure ROBOT[/TOPIC] SETTINGS_JSON"]);
        }
    }
}

#[test]
fn spans_are_neither_negative_nor_endless() {
    let mut fleet = Fleet::of_the_paper();
    for (key, rest) in [
        ("queue_wait_max_ms", r#""on_conflict":"queue""#),
        ("aging_ms", r#""on_conflict":"queue""#),
        ("min_hold_ms", r#""on_conflict":"preempt""#),
        ("idle_release_ms", r#""on_conflict":"queue""#),
        ("confirm_within_ms", r#""confirm":1"#),
    ] {
        let with = |span: &str| format!(r#"{{"sharing":{{{rest},"{key}":{span}}}}}"#);
        for span in ["0", "99", "86400001", "18446744073709551615"] {
            settings_refused(&mut fleet, &with(span), [span, "100 to 86400000 ms", "within this range"]);
        }
        for span in ["-1", "-9223372036854775808", "1e3", "null1"] {
            settings_refused(&mut fleet, &with(span), ["", "sharing", "SETTINGS_JSON"]);
        }
    }
    for wish in [r#"{"lease_ms":-1}"#, r#"{"wait_ms":-1}"#, r#"{"priority":1.5}"#, r#"{"wait":1}"#] {
        let parts = ["", "lease_ms, wait_ms and priority", "acquire SERVICE"];
        bad(&mut fleet, &salma(), Code::BadArgument, ("acquire", &[TURTLEBOT, wish]), parts);
    }
    for lease in ["-5", "+5", "5s", "18446744073709551616"] {
        let parts = [lease, "a decimal number", "acquire SERVICE"];
        bad(&mut fleet, &salma(), Code::BadArgument, ("acquire", &[TURTLEBOT, lease]), parts);
    }
    for (lease, advice) in [
        ("0", "acquire SERVICE"),
        ("99", "acquire SERVICE"),
        ("600001", "ledgerctl robot set Turtlebot4/cmd_vel lease-max="),
        ("18446744073709551615", "ledgerctl acquire Turtlebot4/cmd_vel --keep"),
    ] {
        let parts = [lease, "100 to", advice];
        bad(&mut fleet, &salma(), Code::BadArgument, ("acquire", &[TURTLEBOT, lease]), parts);
    }
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"delegable":true}}"#]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    for (options, wanted) in [
        (r#"{"for_ms":0}"#, "for_ms from 100 to 86400000"),
        (r#"{"for_ms":86400001}"#, "for_ms from 100 to 86400000"),
        (r#"{"for_ms":-1}"#, "for_ms, may_delegate and stop"),
    ] {
        let call = ("delegate", &[TURTLEBOT, "Org1/Farhad", options][..]);
        bad(&mut fleet, &salma(), Code::BadArgument, call, ["", wanted, "delegate SERVICE"]);
    }
    let now = fleet.time;
    for (more, wanted) in [
        (format!(r#""deadline":{}"#, now - SECOND), "a deadline after"),
        (format!(r#""not_before":{},"deadline":{}"#, now + 9 * SECOND, now + 8 * SECOND), "a deadline after"),
        (r#""deadline":-1"#.to_owned(), "not_before, deadline"),
        (r#""not_before":18446744073709551615"#.to_owned(), "when the certificate expires"),
        (r#""lease_ms":99"#.to_owned(), "100 to"),
    ] {
        let task = two(&more);
        let call = ("submit", &[HUSKY, &task][..]);
        bad(&mut fleet, &salma(), Code::BadArgument, call, ["", wanted, "submit SERVICE TASK_JSON"]);
    }
}

#[test]
fn a_line_and_a_holder_of_what_is_no_more_are_told_so() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    // The service goes, the robot stays.
    let other = r#"{"name":"Turtlebot4","attribute_required":"Turtlebot4","trusted":["Org1","Org2"],"services":
        [{"topic":"/gripper","type":"geometry_msgs/msg/Twist"}]}"#;
    fleet.ok(&owner(), "replace", &[other]);
    fleet.tick();
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Farhad", Some(LeftReason::RobotRemoved)));
    assert_eq!(task(&fleet, 1).state, TaskState::Failed);
    let gone = ["/cmd_vel", "Turtlebot4/gripper", "ledgerctl"];
    for (function, args) in [
        ("acquire", &[TURTLEBOT][..]),
        ("renew", &[TURTLEBOT]),
        ("release", &[TURTLEBOT]),
        ("delegate", &[TURTLEBOT, "Org1/Farhad"]),
        ("submit", &[TURTLEBOT, TWO]),
        ("configure", &[TURTLEBOT, r#"{"sharing":{"on_conflict":"queue"}}"#]),
    ] {
        let who = if function == "configure" { owner() } else { salma() };
        bad(&mut fleet, &who, Code::UnknownService, (function, args), gone);
    }
    // The robot goes, whoever holds it.
    fleet.ok(&salma(), "acquire", &["Turtlebot4/gripper"]);
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    let parts = ["Turtlebot4", "the name of a registered robot", "ledgerctl robot list"];
    let call = ("renew", &["Turtlebot4/gripper"][..]);
    bad(&mut fleet, &salma(), Code::UnknownRobot, call, parts);
    let refused = fleet.set_refused(&salma(), Code::UnknownRobot, "Turtlebot4/gripper", 1, 1);
    assert!(!refused.wanted.is_empty() && !refused.advice().is_empty(), "{refused}");
    fleet.tick();
    assert_eq!((fleet.keys("grant/"), fleet.keys("line/"), fleet.keys("due/")), (0, 0, 0));
}

#[test]
fn a_priority_is_a_whole_number_within_bounds() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(
        &owner(),
        "configure",
        &[TURTLEBOT, r#"{"sharing":{"on_conflict":"preempt","priority":"attribute:rank"}}"#],
    );
    let wanted = "a whole number from -1000000 to 1000000";
    for (serial, rank) in (70..).zip(["first", "", "1.5", "1000001", "-1000001", "9223372036854775808", " 1", "NaN"]) {
        let odd = ranked("Odd", rank, serial);
        let parts = [rank, wanted, "enrol again"];
        bad(&mut fleet, &odd, Code::BadArgument, ("acquire", &[TURTLEBOT]), parts);
        bad(&mut fleet, &odd, Code::BadArgument, ("submit", &[TURTLEBOT, TWO]), parts);
    }
    for source in ["fixed:", "fixed:9999999", "fixed:x", "attribute:", "rank", "policy:1"] {
        let settings = format!(r#"{{"sharing":{{"on_conflict":"queue","priority":"{source}"}}}}"#);
        settings_refused(&mut fleet, &settings, [source, "fixed:N", ""]);
    }
}

#[test]
fn nobody_passes_a_robot_to_itself_or_in_a_circle() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"delegable":true}}"#]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    for function in ["delegate", "handover"] {
        let call = (function, &[TURTLEBOT, "Org1/Salma"][..]);
        bad(&mut fleet, &salma(), Code::BadArgument, call, ["Org1/Salma", "another identity", "ledgerctl acquire"]);
    }
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"may_delegate":true}"#]);
    for function in ["delegate", "handover"] {
        let call = (function, &[TURTLEBOT, "Org1/Salma"][..]);
        let parts = ["delegated by Org1/Salma", "an identity that has not delegated it", "ledgerctl recall"];
        bad(&mut fleet, &farhad(), Code::BadArgument, call, parts);
    }
}

#[test]
fn only_those_who_may_confirm_do_and_never_themselves() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"confirm":1}}"#]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let call = ("confirm", &[TURTLEBOT, "Org1/Salma"][..]);
    bad(&mut fleet, &salma(), Code::BadArgument, call, ["the contender", "another identity", "an admin of Org2"]);
    for other in [farhad(), admin1(), identity("Org1", "Officer", Role::Member, &["Turtlebot4"], 71)] {
        bad(&mut fleet, &other, Code::DeniedByPolicy, call, ["role", "an admin of Org2", "Org2"]);
    }
    // An attribute of an organisation that the owner does not trust is none.
    let stranger = identity("Org3", "Officer", Role::Member, &["safety"], 72);
    bad(&mut fleet, &stranger, Code::DeniedByPolicy, call, ["role", "an admin of Org2", "Org2"]);
    let nobody = ("confirm", &[TURTLEBOT, "Org1/Nobody"][..]);
    bad(&mut fleet, &owner(), Code::NotFound, nobody, ["Org1/Salma", "a contender that waits", "ledgerctl acquire"]);
}

#[test]
fn windows_that_are_none_are_refused_when_the_policy_is_put() {
    let mut fleet = Fleet::of_the_paper();
    for window in [
        "",
        "always",
        "8-18",
        "24:00-25:00 Z",
        "08:00-18:00",
        "08:60-18:00 Z",
        "08:00-08:00 Z",
        "08:00-18:00 Mon-Fri Europe/Berlin",
        "08:00-18:00 Mon-Fri +99:00",
        "08:00-18:00 Mon-Fry Z",
        "-1:00-18:00 Z",
    ] {
        let text = format!("@between(\"{window}\") permit (principal, action, resource);");
        let call = ("policy", &["put", "p", &text][..]);
        bad(&mut fleet, &owner(), Code::PolicyInvalid, call, ["between", "", ""]);
    }
}

fn holders(fleet: &Fleet, service: &str) -> usize {
    let state = fleet.simulate(&owner(), "line", &[service.to_owned().into()]).unwrap();
    serde_json::from_slice::<LineState>(&state).unwrap().holders.len()
}

/// A robot with services on which one holds and many wait.
fn crowded(services: usize, places: usize) -> Fleet {
    let mut fleet = Fleet::empty();
    let service = |n: usize| {
        let sharing = format!(r#"{{"on_conflict":"queue","publishers":{places}}}"#);
        format!(r#"{{"topic":"/t{n}","type":"geometry_msgs/msg/Twist","mode":"limited","sharing":{sharing}}}"#)
    };
    let all: Vec<String> = (0..services).map(service).collect();
    let spec = format!(
        r#"{{"name":"R","attribute_required":"Turtlebot4","trusted":["Org1","Org2"],"services":[{}]}}"#,
        all.join(",")
    );
    fleet.ok(&owner(), "setup", &[&spec]);
    fleet
}

fn waiter(n: usize) -> Identity {
    identity("Org1", &format!("W{n}"), Role::Member, &["Turtlebot4"], 100 + n as u8)
}

#[test]
fn a_block_gives_sixteen_turns_of_a_service_and_the_rest_come_with_the_next_blocks() {
    let mut fleet = crowded(1, 64);
    fleet.ok(&owner(), "take", &["R/t0", "first"]);
    fleet.ok(&owner(), "configure", &["R/t0", r#"{"sharing":{"publishers":1}}"#]);
    for n in 0..40 {
        fleet.ok(&waiter(n), "acquire", &["R/t0"]);
    }
    fleet.ok(&owner(), "configure", &["R/t0", r#"{"sharing":{"publishers":64}}"#]);
    for wanted in [1 + 16, 1 + 32, 1 + 40] {
        fleet.tick();
        assert_eq!(holders(&fleet, "R/t0"), wanted);
    }
}

#[test]
fn a_block_looks_at_sixteen_services_and_at_the_rest_with_the_next_one() {
    let mut fleet = crowded(20, 1);
    let id = |n: usize| format!("R/t{n}");
    for n in 0..20 {
        fleet.ok(&salma(), "acquire", &[&id(n), "600000"]);
        fleet.ok(&farhad(), "acquire", &[&id(n)]);
    }
    fleet.ok(&owner(), "stop", &["R"]);
    fleet.tick();
    fleet.tick();
    fleet.ok(&owner(), "resume", &["R"]);
    let held = |fleet: &Fleet| (0..20).map(|n| holders(fleet, &id(n))).sum::<usize>();
    fleet.tick();
    assert_eq!(held(&fleet), 16);
    assert!(fleet.next_deadline().is_some_and(|due| due <= fleet.time), "the next block is due at once");
    fleet.tick();
    assert_eq!(held(&fleet), 20);
}

#[test]
fn the_turns_of_a_block_take_as_many_steps_as_one_set_of_policies_may_have() {
    let mut fleet = crowded(1, 64);
    fleet.ok(&owner(), "take", &["R/t0", "first"]);
    fleet.ok(&owner(), "configure", &["R/t0", r#"{"sharing":{"publishers":1}}"#]);
    for n in 0..8 {
        fleet.ok(&waiter(n), "acquire", &["R/t0"]);
    }
    for number in 0..32 {
        let pattern = format!("principal.name like \"{}b\"", "*a".repeat(30));
        let text = format!("permit (principal, action, resource) when {{ {pattern} || {number} < 100 }};");
        fleet.ok(&owner(), "policy", &["put", &format!("p{number}"), &text]);
    }
    fleet.ok(&owner(), "configure", &["R/t0", r#"{"sharing":{"publishers":64}}"#]);
    let (mut before, mut blocks) = (1, 0);
    while before < 9 {
        fleet.tick();
        blocks += 1;
        let (after, steps) = (holders(&fleet, "R/t0"), fleet.meter.used().steps);
        assert!(after > before, "a block gives one turn at least");
        assert!(steps <= 1024 * 1024 || after == before + 1, "{steps} steps for {} turns", after - before);
        before = after;
    }
    assert!(blocks > 1, "{blocks}");
}

#[test]
fn a_block_lets_sixty_four_tasks_of_a_service_join_its_line() {
    let mut fleet = queued();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"queue_max":1024}}"#]);
    fleet.ok(&owner(), "take", &[TURTLEBOT, "first", "600000"]);
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 60 * SECOND));
    for n in 0..2 {
        for _ in 0..50 {
            submit(&mut fleet, &waiter(n), &later);
        }
    }
    fleet.time += 60 * SECOND;
    let line = |fleet: &Fleet| crate::tasks::line(fleet).line.len();
    for wanted in [64, 100] {
        fleet.tick();
        assert_eq!(line(&fleet), wanted);
    }
}
