//! The settings of rules: what is refused, and what each of them does by itself.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, farhad, identity, owner, robot, salma};
use ledger_abac::{
    AccessControl, Acquired, Authorization, Capabilities, Claim, Decision, Fencing, Grant, Left, LeftReason, LineState,
    LineTold, Mode, Place, Publishing, Reason, Released, RobotAsset, RobotChange, Rule, Sequence, Sharing, Situation,
    contend,
};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};
use std::sync::Arc;

fn set(fleet: &mut Fleet, sharing: &str) -> RobotChange {
    fleet.get(&owner(), "configure", &[TURTLEBOT, sharing])
}

fn with(sharing: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    set(&mut fleet, sharing);
    fleet
}

fn ranked(name: &str, rank: &str, serial: u8) -> Identity {
    let mut person = identity("Org1", name, Role::Member, &["Turtlebot4"], serial);
    person.attributes.insert("rank".to_owned(), rank.to_owned());
    person
}

fn place(fleet: &mut Fleet, who: &Identity, args: &[&str]) -> Place {
    match fleet.get(who, "acquire", args) {
        Acquired::Queued { queued } => queued,
        other => panic!("{other:?}"),
    }
}

fn holders(fleet: &Fleet) -> Vec<String> {
    let state = fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap();
    let state: LineState = serde_json::from_slice(&state).unwrap();
    state.holders.into_iter().map(|grant| grant.holder).collect()
}

#[test]
fn settings_that_do_not_go_together_are_refused_with_both_names() {
    let mut fleet = Fleet::of_the_paper();
    for (settings, parts) in [
        (r#"{"sharing":{"publishers":2}}"#, ["mode=exclusive", "publishers"]),
        (r#"{"mode":"open","sharing":{"on_conflict":"queue"}}"#, ["mode=open", "on_conflict"]),
        (r#"{"mode":"limited"}"#, ["mode=limited", "publishers"]),
        (r#"{"sharing":{"queue_max":2}}"#, ["on_conflict=deny", "queue_max"]),
        (r#"{"sharing":{"priority":"fixed:1"}}"#, ["on_conflict=deny", "priority"]),
        (r#"{"sharing":{"on_conflict":"queue","min_hold_ms":1000}}"#, ["on_conflict=queue", "min_hold_ms"]),
        (r#"{"sharing":{"on_conflict":"preempt","aging_ms":1000}}"#, ["no queue_max", "aging_ms"]),
        (r#"{"sharing":{"on_conflict":"preempt","queue_wait_max_ms":1000}}"#, ["no queue_max", "queue_wait_max_ms"]),
    ] {
        let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, settings]);
        assert!(parts.iter().all(|part| refused.message.contains(part)), "{settings}: {refused}");
        assert!(!refused.wanted.is_empty() && !refused.advice().is_empty(), "{settings}: {refused}");
    }
}

#[test]
fn numbers_beyond_their_bounds_are_refused_with_the_bounds() {
    let mut fleet = Fleet::of_the_paper();
    for (settings, wanted) in [
        (r#"{"mode":"limited","sharing":{"publishers":0}}"#, "1 to 256"),
        (r#"{"mode":"limited","sharing":{"publishers":257}}"#, "1 to 256"),
        (r#"{"sharing":{"on_conflict":"queue","queue_max":0}}"#, "1 to 1024"),
        (r#"{"sharing":{"on_conflict":"queue","queue_max":18446744073709551615}}"#, "1 to 1024"),
        (r#"{"sharing":{"on_conflict":"queue","queue_wait_max_ms":99}}"#, "100 to 86400000 ms"),
        (r#"{"sharing":{"idle_release_ms":86400001}}"#, "100 to 86400000 ms"),
        (r#"{"sharing":{"on_conflict":"queue","priority":"fixed:9999999"}}"#, "fixed:N"),
        (r#"{"sharing":{"on_conflict":"queue","priority":"rank"}}"#, "attribute:NAME"),
        (r#"{"sharing":{"on_conflict":"queue","queue_max":-1}}"#, "sharing"),
        (r#"{"sharing":{"on_conflict":"fight"}}"#, "sharing"),
        (r#"{"sharing":{"queue":1}}"#, "sharing"),
        (r#"{"clear":["queue"]}"#, "queue_max"),
        (r#"{"mode":"exclusiv"}"#, "exclusive"),
    ] {
        let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, settings]);
        assert!(refused.wanted.contains(wanted), "{settings}: {refused}");
    }
}

#[test]
fn a_change_of_settings_tells_each_and_takes_back_what_is_cleared() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let change = set(&mut fleet, r#"{"sharing":{"on_conflict":"queue","queue_max":8}}"#);
    let told: Vec<_> = change.changed.iter().map(|one| (one.setting.as_str(), one.after.as_str())).collect();
    assert_eq!(told, [("on_conflict", "queue"), ("queue_max", "8")]);
    assert!(change.ended.is_empty(), "the grant that is still allowed goes on");
    assert_eq!(change.robot.services[0].sharing.queue_max, Some(8));
    let change = set(&mut fleet, r#"{"clear":["queue_max"]}"#);
    assert_eq!((change.changed[0].before.as_str(), change.changed[0].after.as_str()), ("8", ""));
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
}

#[test]
fn who_waits_hears_the_place_and_when_its_turn_comes() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue","queue_max":2}}"#);
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let first = place(&mut fleet, &farhad(), &[TURTLEBOT]);
    assert_eq!((first.position, first.expected), (1, Some(grant.expires)));
    assert_eq!(first.until, fleet.time + 600 * SECOND);
    let third = ranked("Third", "0", 61);
    let second = place(&mut fleet, &third, &[TURTLEBOT, r#"{"wait_ms":1000}"#]);
    assert_eq!((second.position, second.expected), (2, Some(grant.expires + 10 * SECOND)));
    assert_eq!(second.until, fleet.time + SECOND);
    let told: LineTold = fleet.newest("line");
    assert_eq!((told.waiting, told.next), (2, vec!["Org1/Farhad".to_owned(), "Org1/Third".to_owned()]));
    // Asking again keeps the place.
    assert_eq!(place(&mut fleet, &farhad(), &[TURTLEBOT]).position, 1);
    let asset: RobotAsset = fleet.get(&owner(), "robot", &["Turtlebot4"]);
    assert_eq!(asset.services[0].waiting, 2);

    let fourth = ranked("Fourth", "0", 62);
    let refused = fleet.refused(&fourth, Code::LineFull, "acquire", &[TURTLEBOT]);
    assert_eq!(refused.wanted, "fewer than 2");
    let refused = fleet.refused(&fourth, Code::Held, "acquire", &[TURTLEBOT, r#"{"wait_ms":0}"#]);
    assert!(refused.message.contains("held by Org1/Salma"), "{refused}");
    let could: Authorization = fleet.get(&fourth, "authorize", &[TURTLEBOT, "acquire"]);
    assert_eq!((could.allowed, could.name.as_str()), (false, "HELD"));
}

#[test]
fn a_release_gives_the_service_to_the_next_in_line_and_who_has_waited_too_long_drops_out() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue"}}"#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let third = ranked("Third", "0", 61);
    place(&mut fleet, &third, &[TURTLEBOT, r#"{"wait_ms":2000}"#]);
    place(&mut fleet, &farhad(), &[TURTLEBOT, r#"{"lease_ms":5000}"#]);
    assert_eq!(fleet.next_deadline(), Some(fleet.time - 1000 + 2 * SECOND));
    fleet.time += 2 * SECOND;
    fleet.tick();
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Third", Some(LeftReason::TimedOut)));

    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    assert!(holders(&fleet).is_empty(), "turns come with the next block");
    assert!(fleet.next_deadline().is_some_and(|due| due <= fleet.time), "which is due at once");
    fleet.tick();
    assert_eq!(holders(&fleet), ["Org1/Farhad"]);
    let grant: Grant = fleet.newest("granted");
    assert_eq!((grant.epoch, grant.lease_ms), (2, 5000));
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 9);
    fleet.set(&farhad(), TURTLEBOT, 2, 1, 1).unwrap();
}

#[test]
fn who_waits_leaves_by_release_and_an_admin_of_the_owner_sends_away() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue"}}"#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let third = ranked("Third", "0", 61);
    place(&mut fleet, &farhad(), &[TURTLEBOT]);
    place(&mut fleet, &third, &[TURTLEBOT]);
    let released: Vec<Released> = fleet.get(&farhad(), "release", &[TURTLEBOT]);
    assert!(released.is_empty());
    assert_eq!(fleet.newest::<Left>("left").reason.known(), Some(LeftReason::Left));
    fleet.refused(&farhad(), Code::NotOwner, "release", &[TURTLEBOT, "Org1/Third"]);
    fleet.ok(&owner(), "release", &[TURTLEBOT, "Org1/Third"]);
    assert_eq!(fleet.newest::<Left>("left").reason.known(), Some(LeftReason::Removed));
    fleet.refused(&farhad(), Code::NotHolder, "release", &[TURTLEBOT]);
}

#[test]
fn a_place_in_line_ends_with_the_certificate_the_policy_and_the_robot() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue"}}"#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let (third, fourth) = (ranked("Third", "0", 61), ranked("Fourth", "0", 62));
    for who in [&farhad(), &third, &fourth] {
        place(&mut fleet, who, &[TURTLEBOT]);
    }
    fleet.revoke(&farhad());
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Farhad", Some(LeftReason::Revoked)));

    let only_third = "forbid (principal, action, resource) when { principal.name == \"Third\" };";
    let permit = "permit (principal, action, resource);";
    fleet.ok(&owner(), "policy", &["put", "p", &format!("{permit} {only_third}")]);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.tick();
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Third", Some(LeftReason::Policy)));
    assert_eq!(holders(&fleet), ["Org1/Fourth"]);

    place(&mut fleet, &salma(), &[TURTLEBOT]);
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    fleet.tick();
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Salma", Some(LeftReason::RobotRemoved)));
    assert_eq!(fleet.next_deadline(), None, "nothing of the line is left");
}

#[test]
fn a_limited_service_has_as_many_holders_as_its_owner_says_and_each_publishes_in_its_own_epoch() {
    let mut fleet = with(r#"{"mode":"limited","sharing":{"publishers":2}}"#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let refused = fleet.refused(&ranked("Third", "0", 61), Code::Held, "acquire", &[TURTLEBOT]);
    assert_eq!(refused.found, "limited service, held by Org1/Salma, Org1/Farhad");
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
    fleet.set(&farhad(), TURTLEBOT, 2, 1, 1).unwrap();
    fleet.set(&salma(), TURTLEBOT, 1, 2, 1).unwrap();
    fleet.set_refused(&salma(), Code::StaleSequence, TURTLEBOT, 1, 2);
    fleet.set_refused(&ranked("Third", "0", 61), Code::NotHolder, TURTLEBOT, 0, 3);
    let change = set(&mut fleet, r#"{"sharing":{"publishers":1}}"#);
    assert_eq!(change.ended[0].holder, "Org1/Farhad", "the oldest stays");
}

#[test]
fn priorities_come_from_attributes_that_count_from_policies_or_are_fixed() {
    let preempt = |source: &str| format!(r#"{{"sharing":{{"on_conflict":"preempt","priority":"{source}"}}}}"#);
    let mut fleet = with(&preempt("attribute:rank"));
    let (low, high) = (ranked("Low", "1", 61), ranked("High", "2", 62));
    fleet.ok(&low, "acquire", &[TURTLEBOT]);
    fleet.refused(&salma(), Code::Held, "acquire", &[TURTLEBOT]);
    fleet.refused(&high, Code::Held, "acquire", &[TURTLEBOT, r#"{"priority":1}"#]);
    fleet.ok(&high, "acquire", &[TURTLEBOT, r#"{"priority":9}"#]);
    let released: Released = fleet.newest("released");
    assert_eq!(
        (released.holder.as_str(), released.reason.known(), released.by.as_deref()),
        ("Org1/Low", Some(Reason::Preempted), Some("Org1/High"))
    );
    fleet.set_refused(&low, Code::StaleEpoch, TURTLEBOT, 1, 1);
    let refused = fleet.refused(&ranked("Odd", "first", 63), Code::BadArgument, "acquire", &[TURTLEBOT]);
    assert!(refused.message.contains("rank"), "{refused}");
    // Who is not trusted has no attributes that count.
    let stranger = {
        let mut stranger = ranked("High", "9", 64);
        stranger.organisation = "Org3".to_owned();
        stranger
    };
    fleet.ok(&owner(), "policy", &["put", "p", "permit (principal, action, resource);"]);
    fleet.refused(&stranger, Code::Held, "acquire", &[TURTLEBOT]);

    let mut fleet = with(&preempt("policy"));
    let of_salma = r#"@priority("-3") permit (principal, action, resource);
        @id("s") @priority("5") permit (principal == User::"Org1/Salma", action == Action::"acquire", resource);
        @priority("7") permit (principal == User::"Org1/Salma", action == Action::"publish", resource);"#;
    fleet.ok(&owner(), "policy", &["put", "p", of_salma]);
    assert_eq!(fleet.get::<Grant>(&farhad(), "acquire", &[TURTLEBOT]).epoch, 1);
    assert_eq!(fleet.get::<Grant>(&salma(), "acquire", &[TURTLEBOT]).epoch, 2);
    set(&mut fleet, r#"{"sharing":{"queue_max":4}}"#);
    assert_eq!(place(&mut fleet, &farhad(), &[TURTLEBOT]).priority, -3);
}

#[test]
fn a_policy_has_annotations_that_exist_with_values_that_they_can_have() {
    let mut fleet = Fleet::of_the_paper();
    for (annotation, part) in [
        ("@prioritty(\"1\")", "did you mean \"priority\"?"),
        ("@priority(\"high\")", "whole number"),
        ("@priority(\"1000001\")", "whole number"),
        ("@priority", "whole number"),
    ] {
        let text = format!("{annotation} permit (principal, action, resource);");
        let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
        assert!(refused.found.contains(part), "{refused}");
    }
    let text = "@description(\"all\") @id(\"x\") @priority(\"-1\") permit (principal, action, resource);";
    fleet.ok(&owner(), "policy", &["put", "p", text]);
}

#[test]
fn a_holder_that_publishes_nothing_for_too_long_loses_the_service() {
    let mut fleet = with(r#"{"sharing":{"idle_release_ms":3000,"on_conflict":"queue"},"lease_ms":60000}"#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    place(&mut fleet, &farhad(), &[TURTLEBOT]);
    for seq in 1..=4 {
        fleet.time += 2 * SECOND;
        fleet.set(&salma(), TURTLEBOT, 1, seq, 1).unwrap();
    }
    let quiet_since = fleet.time;
    let mut ticks = 0;
    while holders(&fleet) == ["Org1/Salma"] {
        fleet.time = fleet.next_deadline().unwrap().max(fleet.time);
        fleet.tick();
        ticks += 1;
        assert!(ticks < 5, "the service is looked at when something is due");
    }
    assert!(fleet.time - quiet_since <= 3 * SECOND + 5000);
    assert_eq!(fleet.newest::<Released>("released").reason.known(), Some(Reason::Idle));
    assert_eq!(holders(&fleet), ["Org1/Farhad"], "in the same block");
}

#[test]
fn a_certificate_waits_in_a_bounded_number_of_lines() {
    let mut fleet = Fleet::empty();
    let services: Vec<String> = (0..64)
        .map(|n| format!(r#"{{"topic":"/t{n}","type":"geometry_msgs/msg/Twist","sharing":{{"on_conflict":"queue"}}}}"#))
        .collect();
    for robot in ["A", "B"] {
        let spec = format!(
            r#"{{"name":"{robot}","attribute_required":"Turtlebot4","trusted":["Org1","Org2"],"services":[{}]}}"#,
            services.join(",")
        );
        fleet.ok(&owner(), "setup", &[&spec]);
    }
    let id = |n: usize| if n < 64 { format!("A/t{n}") } else { "B/t0".to_owned() };
    for n in 0..=64 {
        fleet.ok(&salma(), "acquire", &[&id(n)]);
    }
    for n in 0..64 {
        place(&mut fleet, &farhad(), &[&id(n)]);
    }
    let refused = fleet.refused(&farhad(), Code::LimitExceeded, "acquire", &[&id(64)]);
    assert_eq!((refused.found.as_str(), refused.wanted.as_str()), ("64 queues", "fewer than 64"));
}

/// Everybody may have it while the hour is even: a rule that this crate does not have.
struct EvenHours;

impl Rule for EvenHours {
    fn mode(&self) -> Mode {
        Mode::named("even-hours")
    }

    fn capabilities(&self, _sharing: &Sharing) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher }
    }

    fn keys(&self) -> &'static [&'static str] {
        &["queue_max"]
    }

    fn line_max(&self, sharing: &Sharing) -> u64 {
        sharing.queue_max.unwrap_or(8)
    }

    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision {
        let hour = 3600 * SECOND;
        match situation.now / hour % 2 {
            0 => contend(usize::MAX, contender, situation),
            _ => Decision::Wait { again: Some((situation.now / hour + 1) * hour) },
        }
    }
}

#[test]
fn a_rule_of_somebody_else_decides_like_those_of_this_crate() {
    let mut fleet = Fleet::with(AccessControl::new().unwrap().with_rule(Arc::new(EvenHours)).unwrap());
    fleet.ok(&owner(), "setup", &[&robot("Husky", "even-hours")]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    // Five minutes before the next even hour; nobody waits longer than ten.
    fleet.time += (3600 + 55 * 60) * SECOND;
    place(&mut fleet, &salma(), &[HUSKY]);
    fleet.time = fleet.next_deadline().unwrap();
    fleet.tick();
    assert_eq!(fleet.newest::<Grant>("granted").epoch, 2);
    assert!(
        AccessControl::new().unwrap().with_rule(Arc::new(EvenHours)).unwrap().with_rule(Arc::new(EvenHours)).is_err()
    );
    let mut without = Fleet::empty();
    without.refused(&owner(), Code::BadArgument, "setup", &[&robot("Husky", "even-hours")]);
}

/// Least use goes first: a rule that remembers.
struct LeastUsed;

impl Rule for LeastUsed {
    fn mode(&self) -> Mode {
        Mode::named("least-used")
    }

    fn capabilities(&self, _sharing: &Sharing) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::Newest, sequence: Sequence::PerEpoch }
    }

    fn keys(&self) -> &'static [&'static str] {
        &[]
    }

    fn line_max(&self, _sharing: &Sharing) -> u64 {
        8
    }

    fn remembers_use(&self) -> bool {
        true
    }

    fn decide(&self, _contender: &Claim, situation: &Situation<'_>) -> Decision {
        if situation.holders.is_empty() { Decision::Grant { ends: vec![] } } else { Decision::Wait { again: None } }
    }

    fn order(&self, situation: &Situation<'_>) -> Vec<usize> {
        let mut order: Vec<usize> = (0..situation.line.len()).collect();
        order.sort_by_key(|index| situation.line[*index].used);
        order
    }
}

#[test]
fn a_rule_that_remembers_sees_how_long_each_one_held_the_service_within_the_last_hour() {
    let mut fleet = Fleet::with(AccessControl::new().unwrap().with_rule(Arc::new(LeastUsed)).unwrap());
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "least-used")]);
    let used = |fleet: &mut Fleet, who: &Identity, seconds: u64| {
        fleet.ok(who, "acquire", &[TURTLEBOT, "600000"]);
        fleet.time += seconds * SECOND;
        fleet.ok(who, "release", &[TURTLEBOT]);
    };
    let third = ranked("Third", "0", 61);
    used(&mut fleet, &salma(), 100);
    used(&mut fleet, &farhad(), 50);
    fleet.ok(&third, "acquire", &[TURTLEBOT]);
    place(&mut fleet, &salma(), &[TURTLEBOT]);
    place(&mut fleet, &farhad(), &[TURTLEBOT]);
    fleet.ok(&third, "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(holders(&fleet), ["Org1/Farhad"], "it came later, and used the robot less");
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(holders(&fleet), ["Org1/Salma"]);
    assert_eq!(fleet.keys("used/"), 3);
    // Whoever has not used it for an hour is forgotten.
    fleet.time += 2 * 3600 * SECOND;
    fleet.tick();
    fleet.ok(&third, "acquire", &[TURTLEBOT]);
    fleet.time += SECOND;
    fleet.ok(&third, "release", &[TURTLEBOT]);
    assert_eq!(fleet.keys("used/"), 1);
}
