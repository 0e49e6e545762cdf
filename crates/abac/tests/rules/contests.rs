//! The part of the story about who wins.

use crate::story::{self, BOSS, COMMANDS, FARHAD, MESSAGE, NODE1, OWNER, SALMA};
use crate::teller::{SECOND, Teller};
use ledger::msp::CarryCa;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code::{self, Ok};
use serde_json::json;

/// A task of two points.
const TASK: &str = r#"{"points":[{"x_um":1000000,"y_um":0},{"x_um":2000000,"y_um":-500000,"yaw_urad":1570796}]}"#;

/// Farhad holds the Turtlebot4 at the beginning and at the end.
pub(crate) fn contests(teller: &mut Teller) {
    registered(teller);
    lines(teller);
    hand_overs(teller);
    emergencies(teller);
    tasks(teller);
    confirmations(teller);
    readers(teller);
    teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4", "600000"]);
}

fn set(teller: &mut Teller, settings: &str) {
    teller.call(OWNER, Ok, "abac", "configure", &[COMMANDS, settings]);
}

/// Time passes, and an empty block tells what is due.
fn wait(teller: &mut Teller, seconds: u64) {
    teller.time += seconds * SECOND;
    teller.block(vec![]);
}

/// Only somebody whose certificate is on record receives a grant from another.
fn registered(teller: &mut Teller) {
    let carry = CarryCa::prove(&teller.network(), "Org1", "Org1/node1", &teller.ca);
    teller.call(NODE1, Ok, "msp", "carry_ca", &[&serde_json::to_string(&carry).unwrap()]);
    let secret = Hash::of(&[b"farhad's secret"]);
    let expires = teller.time + 600 * SECOND;
    let register = json!({ "name": "Farhad", "role": "member", "attributes": { "Turtlebot4": "true" },
        "secret": secret, "expires": expires });
    teller.call(BOSS, Ok, "msp", "register", &[&register.to_string()]);
    let certificate = hex::encode(&teller.farhad.certificate);
    let record = json!({ "organisation": "Org1", "certificate": certificate, "ground": { "secret": secret } });
    teller.call(NODE1, Ok, "msp", "record_certificate", &[&record.to_string()]);
}

fn lines(teller: &mut Teller) {
    teller.call(OWNER, Code::BadArgument, "abac", "configure", &[COMMANDS, r#"{"sharing":{"queue_max":2}}"#]);
    set(teller, r#"{"sharing":{"on_conflict":"queue","queue_max":1,"queue_wait_max_ms":60000,"aging_ms":1000}}"#);
    let place = teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4", r#"{"wait_ms":30000,"priority":-2}"#]);
    assert_eq!(place["queued"]["position"], 1);
    teller.call(OWNER, Code::NotFound, "abac", "confirm", &[COMMANDS, "Org1/Salma"]);
    teller.call(FARHAD, Ok, "abac", "release", &["Turtlebot4"]);
    wait(teller, 0);
    // Her turn came.
    teller.call(SALMA, Ok, "abac", "renew", &["Turtlebot4"]);
    teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4", r#"{"wait_ms":1000}"#]);
    wait(teller, 2);
    // He waited in vain.
    teller.call(FARHAD, Code::NotHolder, "abac", "release", &["Turtlebot4"]);
    set(
        teller,
        r#"{"clear":["queue_max","queue_wait_max_ms","aging_ms"],"sharing":{"on_conflict":"preempt","priority":"fixed:5","min_hold_ms":1000}}"#,
    );
    let grant = teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4"]);
    assert_eq!(grant["holder"], "Org1/Farhad", "hers has a lower priority");
    teller.call(SALMA, Code::Held, "abac", "acquire", &["Turtlebot4", r#"{"priority":1}"#]);
    set(teller, r#"{"sharing":{"on_conflict":"deny","idle_release_ms":1000},"clear":["priority","min_hold_ms"]}"#);
    wait(teller, 3);
    teller.call(FARHAD, Code::NotHolder, "abac", "renew", &["Turtlebot4"]);
    set(teller, r#"{"clear":["idle_release_ms"]}"#);
}

fn hand_overs(teller: &mut Teller) {
    teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4", "60000"]);
    teller.call(SALMA, Code::NotDelegable, "abac", "delegate", &["Turtlebot4", "Org1/Farhad"]);
    set(teller, r#"{"sharing":{"delegable":true}}"#);
    let delegated = teller.call(SALMA, Ok, "abac", "delegate", &["Turtlebot4", "Org1/Farhad", r#"{"for_ms":5000}"#]);
    assert_eq!(delegated["givers"][0], "Org1/Salma");
    teller.call(FARHAD, Code::NotDelegable, "abac", "delegate", &["Turtlebot4", "Org1/Salma"]);
    teller.call(SALMA, Ok, "abac", "recall", &["Turtlebot4"]);
    teller.call(SALMA, Ok, "abac", "handover", &["Turtlebot4", "Org1/Farhad"]);
    teller.call(SALMA, Code::NotHolder, "abac", "recall", &["Turtlebot4"]);
    set(teller, r#"{"clear":["delegable"]}"#);
}

fn emergencies(teller: &mut Teller) {
    teller.call(SALMA, Code::DeniedByPolicy, "abac", "stop", &["Turtlebot4"]);
    teller.call(OWNER, Ok, "abac", "stop", &["*", "person in the cell"]);
    teller.call(FARHAD, Code::Stopped, "abac", "acquire", &["Turtlebot4"]);
    teller.call(OWNER, Ok, "abac", "resume", &["Turtlebot4"]);
    teller.call(OWNER, Ok, "abac", "take", &["Turtlebot4", "it turns in circles"]);
    teller.call(OWNER, Ok, "abac", "release", &["Turtlebot4"]);
    teller.call(SALMA, Code::BadArgument, "abac", "acquire_all", &["{}", COMMANDS, COMMANDS]);
    teller.call(SALMA, Ok, "abac", "acquire_all", &["{}", COMMANDS]);
    teller.call(SALMA, Ok, "abac", "release", &["Turtlebot4"]);
}

fn tasks(teller: &mut Teller) {
    set(teller, r#"{"sharing":{"on_conflict":"queue"}}"#);
    teller.call(SALMA, Code::BadArgument, "abac", "submit", &[COMMANDS, r#"{"points":[]}"#]);
    let later = teller.time + 10 * SECOND;
    let scheduled = format!(r#"{{"points":[{{"x_um":0,"y_um":0}}],"not_before":{later}}}"#);
    let ids = [TASK, TASK, &scheduled].map(|task| {
        let told = teller.call(SALMA, Ok, "abac", "submit", &[COMMANDS, task]);
        told["task"]["id"].as_u64().or(told["id"].as_u64()).unwrap().to_string()
    });
    teller.call(FARHAD, Ok, "abac", "submit", &[COMMANDS, r#"{"points":[{"x_um":5,"y_um":6}],"requeue":true}"#]);
    teller.call(SALMA, Ok, "abac", "progress", &[&ids[0], "1"]);
    teller.call(FARHAD, Code::NotOwner, "abac", "progress", &[&ids[0], "2"]);
    teller.call(SALMA, Ok, "abac", "progress", &[&ids[0], "2"]);
    wait(teller, 0);
    teller.call(SALMA, Ok, "abac", "fail", &[&ids[1], "the door is locked"]);
    wait(teller, 0);
    teller.call(OWNER, Ok, "abac", "stop", &["Turtlebot4"]);
    teller.call(SALMA, Ok, "abac", "cancel", &[&ids[2]]);
    teller.call(OWNER, Ok, "abac", "resume", &["Turtlebot4"]);
    wait(teller, 0);
    wait(teller, 1200);
    set(teller, r#"{"clear":["on_conflict"]}"#);
}

fn confirmations(teller: &mut Teller) {
    set(teller, r#"{"sharing":{"confirm":1}}"#);
    teller.call(SALMA, Ok, "abac", "acquire", &["Turtlebot4"]);
    teller.call(SALMA, Code::BadArgument, "abac", "confirm", &[COMMANDS, "Org1/Salma"]);
    teller.call(FARHAD, Code::DeniedByPolicy, "abac", "confirm", &[COMMANDS, "Org1/Salma"]);
    teller.call(OWNER, Ok, "abac", "confirm", &[COMMANDS, "Org1/Salma"]);
    let epoch = teller.call(SALMA, Ok, "abac", "renew", &["Turtlebot4"])["epoch"].to_string();
    teller.call(SALMA, Ok, "abac", "set", &[COMMANDS, &epoch, "1", MESSAGE]);
    teller.call(FARHAD, Code::Held, "abac", "acquire", &["Turtlebot4", r#"{"wait_ms":0}"#]);
    wait(teller, 120);
    set(teller, r#"{"clear":["confirm"]}"#);
}

fn readers(teller: &mut Teller) {
    let places = "Turtlebot4/cmd_vel:subscribe";
    teller.call(SALMA, Code::UnknownService, "abac", "acquire", &[places]);
    set(teller, r#"{"mode":"limited","sharing":{"publishers":2,"subscribers":1}}"#);
    teller.call(SALMA, Ok, "abac", "acquire", &[places]);
    teller.call(FARHAD, Code::Held, "abac", "acquire", &[places]);
    let policy = r#"@max_linear("0.5") @between("00:00-24:00 Z") permit (principal, action, resource);"#;
    teller.call(OWNER, Ok, "abac", "policy", &["apply", &story::set(&[("slow", policy)])]);
    let grant = teller.call(FARHAD, Ok, "abac", "acquire", &["Turtlebot4"]);
    assert_eq!(grant["limits"]["max_linear_mm_s"], 500);
    teller.call(FARHAD, Ok, "abac", "release", &["Turtlebot4"]);
    teller.call(OWNER, Ok, "abac", "policy", &["apply", &story::set(&[])]);
    set(teller, r#"{"mode":"exclusive","clear":["publishers","subscribers"]}"#);
}
