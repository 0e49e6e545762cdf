//! Limits: what policies bind a grant to, and windows of time.

use crate::fleet::{Fleet, SECOND, START, TURTLEBOT, farhad, owner, salma};
use ledger_abac::{Grant, Limits, Reason, Released};
use ledger_base::rejection::Code;

const HOUR: u64 = 3600 * SECOND;

fn under(policy: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    put(&mut fleet, policy);
    fleet
}

fn put(fleet: &mut Fleet, policy: &str) {
    fleet.ok(&owner(), "policy", &["put", "p", policy]);
}

fn grant_of(fleet: &Fleet) -> Option<Grant> {
    let grants = fleet.simulate(&owner(), "grants", &[TURTLEBOT.into()]).unwrap();
    serde_json::from_slice::<Vec<Grant>>(&grants).unwrap().pop()
}

#[test]
fn a_grant_carries_the_strictest_limits_of_the_policies_that_permit_it() {
    let mut fleet = under(
        r#"@max_rate("50") @max_linear("0.5") permit (principal, action, resource);
           @max_rate("20") @max_age("200ms") permit (principal == User::"Org1/Salma", action == Action::"acquire", resource);
           @max_angular("1.25") permit (principal == User::"Org1/Salma", action == Action::"publish", resource);
           @max_rate("1") permit (principal == User::"Org1/Farhad", action, resource);"#,
    );
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let wanted = Limits {
        max_rate_mhz: Some(20_000),
        max_age_ms: Some(200),
        max_linear_mm_s: Some(500),
        max_angular_mrad_s: Some(1250),
        between: vec![],
    };
    assert_eq!(grant.limits, wanted);
    assert_eq!(grant_of(&fleet).unwrap().limits, wanted, "everybody sees them");
    assert_eq!(fleet.get::<Grant>(&salma(), "renew", &[TURTLEBOT]).limits, wanted);
}

#[test]
fn speeds_are_limited_only_where_messages_have_them() {
    let mut fleet = under(r#"@max_linear("0.5") @max_rate("5") permit (principal, action, resource);"#);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"type":"std_msgs/msg/String"}"#]);
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    assert_eq!(grant.limits, Limits { max_rate_mhz: Some(5000), ..Limits::default() });
}

#[test]
fn a_change_of_policies_changes_the_limits_of_a_grant_that_goes_on() {
    let mut fleet = under("permit (principal, action, resource);");
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    put(&mut fleet, r#"@max_linear("0.1") permit (principal, action, resource);"#);
    let grant = grant_of(&fleet).unwrap();
    assert_eq!((grant.epoch, grant.limits.max_linear_mm_s), (1, Some(100)));
    put(&mut fleet, "permit (principal, action, resource);");
    assert!(grant_of(&fleet).unwrap().limits.is_none());
}

/// 2026-11-21, when the tests start, is a Saturday.
#[test]
fn a_window_that_closes_ends_the_grant_in_block_time_whatever_renews_it() {
    let mut fleet = under(r#"@between("02:00-04:00 Sat +01:00") permit (principal, action, resource);"#);
    let refused = fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    assert_eq!(refused.wanted, "a time within 02:00-04:00 Sat +01:00");
    fleet.time = START + HOUR;
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT, "600000"]);
    assert_eq!(grant.limits.between, ["02:00-04:00 Sat +01:00"]);
    let closes = START + 3 * HOUR;
    let mut seq = 0;
    while fleet.time < closes - 200 * SECOND {
        fleet.time += 100 * SECOND;
        seq += 1;
        fleet.set(&salma(), TURTLEBOT, 1, seq, 1).unwrap();
    }
    assert_eq!(grant_of(&fleet).unwrap().expires, closes);
    assert_eq!(fleet.get::<Grant>(&salma(), "renew", &[TURTLEBOT]).expires, closes);
    assert_eq!(fleet.next_deadline(), Some(closes));
    fleet.time = closes - 1000;
    fleet.set_refused(&salma(), Code::DeniedByPolicy, TURTLEBOT, 1, seq + 1);
    assert_eq!(fleet.newest::<Released>("released").reason.known(), Some(Reason::Expired));
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
}

#[test]
fn a_policy_without_a_window_permits_at_any_time() {
    let mut fleet = under(
        r#"@between("02:00-04:00 Sat Z") permit (principal, action, resource);
           permit (principal == User::"Org1/Salma", action, resource);"#,
    );
    fleet.time = START + 2 * HOUR;
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT, "600000"]);
    assert!(grant.limits.is_none() && grant.expires == fleet.time + 600 * SECOND);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.time = START + 5 * HOUR;
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
}

#[test]
fn where_a_policy_is_enough_to_publish_limits_ask_for_a_grant() {
    let mut fleet = under(r#"@max_rate("5") permit (principal, action, resource);"#);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open"}"#]);
    let refused = fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 0, 1);
    assert_eq!(refused.wanted, "a grant, whose limits the robot enforces");
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, grant.epoch, 1, 1).unwrap();
}

#[test]
fn limits_that_nobody_could_enforce_are_refused() {
    let mut fleet = Fleet::of_the_paper();
    for (annotation, part) in [
        ("@max_rate(\"0\")", "0.001 to 10000 Hz"),
        ("@max_rate(\"fast\")", "0.001 to 10000 Hz"),
        ("@max_rate(\"-5\")", "0.001 to 10000 Hz"),
        ("@max_linear(\"NaN\")", "0 to 10000 metres per second"),
        ("@max_linear(\"0.0001\")", "at most three decimals"),
        ("@max_angular(\"1e9\")", "0 to 10000 radians per second"),
        ("@max_age(\"200\")", "e.g. 200ms or 2s"),
        ("@max_age(\"0ms\")", "e.g. 200ms or 2s"),
        ("@between(\"8-18\")", "08:00-18:00 Mon-Fri +02:00"),
        ("@between(\"08:00-18:00 Europe/Berlin\")", "08:00-18:00 Mon-Fri +02:00"),
        ("@max_speed(\"1\")", "unknown annotation @max_speed"),
    ] {
        let text = format!("{annotation} permit (principal, action, resource);");
        let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
        assert!(refused.found.contains(part), "{refused}");
    }
    let text = "@max_rate(\"5\") forbid (principal, action, resource);";
    let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", text]);
    assert_eq!(refused.found, "@max_rate on a forbid; wanted it on a permit");
}
