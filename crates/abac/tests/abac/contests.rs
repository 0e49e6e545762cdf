//! Random interleavings of everything that decides who has a service, in blocks of one call and of several, judged by the
//! [`Model`].

use crate::fleet::{Fleet, SECOND, TURTLEBOT, bytes, identity, owner, robot};
use crate::model::{Answer, Conflict, Model, Settings};
use bytes::Bytes;
use ledger_abac::{Acquired, Grant, LineState};
use ledger_identity::{Identity, Role};
use ledger_rejection::Code;
use proptest::prelude::*;

/// One block.
#[derive(Clone, Debug)]
enum Step {
    Acquire { who: usize, less: i64, wait: Option<u64> },
    Renew(usize),
    Release(usize),
    Publish(usize),
    Wait(u64),
    Revoke(usize),
    Take,
    Stop,
    Resume,
    Set(Settings),
    Forbid(Vec<usize>),
    Restart,
}

/// Five people with priorities 0, 1, 1, 2 and 3, and an admin of the owner, whose index is 5.
const PEOPLE: usize = 5;
const PRIORITIES: [i64; PEOPLE] = [0, 1, 1, 2, 3];

fn person(who: usize) -> Identity {
    if who == PEOPLE {
        return owner();
    }
    let mut person = identity("Org1", &format!("P{who}"), Role::Member, &["Turtlebot4"], 60 + who as u8);
    person.attributes.insert("rank".to_owned(), PRIORITIES[who].to_string());
    person
}

fn name(who: usize) -> String {
    person(who).id()
}

fn settings() -> impl Strategy<Value = Settings> {
    let conflict = prop_oneof![Just(Conflict::Deny), Just(Conflict::Queue), Just(Conflict::Preempt)];
    let spans = (1_u64..8, prop::option::of(1_u64..4), prop::option::of(1_u64..6));
    (1_usize..3, conflict, 1_usize..5, any::<bool>(), spans).prop_map(|(places, conflict, line, lined, spans)| {
        let has_line = conflict == Conflict::Queue || (conflict == Conflict::Preempt && lined);
        Settings {
            places,
            conflict,
            line: if has_line { line } else { 0 },
            patience: spans.0 * 3 * SECOND,
            aging: spans.1.filter(|_| has_line).map(|aging| aging * SECOND),
            min_hold: spans.2.filter(|_| conflict == Conflict::Preempt).map_or(0, |hold| hold * SECOND),
        }
    })
}

/// The settings as the owner types them. Those that are not set get their defaults.
fn json(settings: &Settings) -> String {
    let mut sharing = vec![(
        "on_conflict",
        match settings.conflict {
            Conflict::Deny => "\"deny\"".to_owned(),
            Conflict::Queue => "\"queue\"".to_owned(),
            Conflict::Preempt => "\"preempt\"".to_owned(),
        },
    )];
    let mut clear = Vec::new();
    let mut set = |key: &'static str, value: Option<String>| match value {
        Some(value) => sharing.push((key, value)),
        None => clear.push(key),
    };
    let (lined, fights) = (settings.line > 0, settings.conflict != Conflict::Deny);
    set("publishers", (settings.places > 1).then(|| settings.places.to_string()));
    set("queue_max", lined.then(|| settings.line.to_string()));
    set("queue_wait_max_ms", lined.then(|| (settings.patience / 1000).to_string()));
    set("aging_ms", settings.aging.map(|aging| (aging / 1000).to_string()));
    set("min_hold_ms", (settings.min_hold > 0).then(|| (settings.min_hold / 1000).to_string()));
    set("priority", fights.then(|| "\"attribute:rank\"".to_owned()));
    let mode = if settings.places > 1 { "limited" } else { "exclusive" };
    let sharing: Vec<String> = sharing.iter().map(|(key, value)| format!("\"{key}\":{value}")).collect();
    format!(r#"{{"mode":"{mode}","sharing":{{{}}},"clear":{clear:?}}}"#, sharing.join(","))
}

fn step() -> impl Strategy<Value = Step> {
    let who = || 0..PEOPLE;
    let wait = prop_oneof![3 => Just(None), 1 => Just(Some(0)), 3 => (1_u64..20).prop_map(|s| Some(s * SECOND))];
    prop_oneof![
        14 => (who(), 0_i64..2, wait).prop_map(|(who, less, wait)| Step::Acquire { who, less, wait }),
        2 => who().prop_map(Step::Renew),
        4 => who().prop_map(Step::Release),
        4 => who().prop_map(Step::Publish),
        8 => (0..12 * SECOND).prop_map(Step::Wait),
        1 => who().prop_map(Step::Revoke),
        1 => Just(Step::Take),
        1 => Just(Step::Stop),
        2 => Just(Step::Resume),
        3 => settings().prop_map(Step::Set),
        1 => prop::collection::vec(who(), 0..2).prop_map(Step::Forbid),
        1 => Just(Step::Restart),
    ]
}

fn policy(forbidden: &[usize]) -> String {
    let names: Vec<String> = forbidden.iter().map(|who| format!("\"P{who}\"")).collect();
    let forbid =
        format!("forbid (principal, action, resource) when {{ [{}].contains(principal.name) }};", names.join(","));
    let forbid = if forbidden.is_empty() { String::new() } else { forbid };
    format!("permit (principal, action, resource); {forbid}")
}

/// Leaders order an empty block whenever a deadline has passed.
fn tick_until(fleet: &mut Fleet, model: &mut Model, until: u64) {
    while let Some(due) = fleet.next_deadline().filter(|due| *due <= until) {
        fleet.time = fleet.time.max(due.saturating_sub(1000));
        fleet.tick();
        model.begin(fleet.time);
    }
    fleet.time = fleet.time.max(until);
}

fn call(fleet: &mut Fleet, who: usize, function: &str, args: &[&str]) -> Result<Bytes, Code> {
    fleet.call(&person(who), function, &bytes(args)).map_err(|rejection| rejection.code)
}

fn answer(outcome: Result<Bytes, Code>) -> Answer {
    match outcome {
        Ok(bytes) => match serde_json::from_slice(&bytes).unwrap() {
            Acquired::Granted(grant) => Answer::Granted(grant.epoch),
            Acquired::Queued { .. } => Answer::Queued,
            Acquired::Pending { pending } => panic!("{pending:?}"),
        },
        Err(Code::Held) => Answer::Held,
        Err(Code::LineFull) => Answer::LineFull,
        Err(Code::Stopped) => Answer::Stopped,
        Err(Code::DeniedByPolicy) => Answer::Denied,
        Err(other) => panic!("{other}"),
    }
}

/// Plays one call in the product and in the model; their answers must be alike. It is a block of its own, a millisecond after
/// the one before, or in the same block.
fn play(fleet: &mut Fleet, model: &mut Model, seq: &mut u64, joins: bool, step: &Step) {
    fleet.joins = joins;
    let now = if joins { fleet.time } else { fleet.time + 1000 };
    if !joins {
        model.begin(now);
    }
    match step {
        Step::Acquire { who, less, wait } => {
            let base = if model.settings.conflict == Conflict::Deny { 0 } else { PRIORITIES[*who] };
            let priority = base - less;
            let wait_ms = wait.map(|wait| format!(r#","wait_ms":{}"#, wait / 1000)).unwrap_or_default();
            let options = format!(r#"{{"lease_ms":10000,"priority":{priority}{wait_ms}}}"#);
            let found = answer(call(fleet, *who, "acquire", &[TURTLEBOT, &options]));
            assert_eq!(found, model.acquire(*who, priority, *wait, now), "{step:?}");
        }
        Step::Renew(who) => {
            let holds = model.holders.iter().any(|holder| holder.who == *who);
            let renewed = call(fleet, *who, "renew", &[TURTLEBOT]);
            assert_eq!(renewed.is_ok(), holds, "{renewed:?}");
            if holds {
                model.acquire(*who, 0, None, now);
            }
        }
        Step::Release(who) => {
            let released = call(fleet, *who, "release", &[TURTLEBOT]);
            assert_eq!(released.is_ok(), model.release(*who), "{released:?}");
        }
        Step::Publish(who) => {
            let own = model.holders.iter().find(|holder| holder.who == *who).map(|holder| holder.epoch);
            *seq += 1;
            let published = fleet.set(&person(*who), TURTLEBOT, own.unwrap_or(1), *seq, 1);
            assert_eq!(published.is_ok(), own.is_some(), "{published:?}");
            model.publish(*who, now);
        }
        Step::Wait(_) => fleet.tick(),
        Step::Revoke(who) => {
            fleet.revoke(&person(*who));
            model.revoke(*who);
        }
        Step::Take => {
            let found = answer(call(fleet, PEOPLE, "take", &[TURTLEBOT, "person in the cell", "10000"]));
            assert_eq!(found, model.take(PEOPLE, now));
        }
        Step::Stop => {
            call(fleet, PEOPLE, "stop", &["Turtlebot4", "smoke"]).unwrap();
            model.stop();
        }
        Step::Resume => {
            call(fleet, PEOPLE, "resume", &["Turtlebot4"]).unwrap();
            model.stopped = false;
        }
        Step::Set(settings) => {
            call(fleet, PEOPLE, "configure", &[TURTLEBOT, &json(settings)]).unwrap();
            model.set(*settings);
        }
        Step::Forbid(who) => {
            call(fleet, PEOPLE, "policy", &["put", "p", &policy(who)]).unwrap();
            model.forbid(who.clone());
        }
        Step::Restart => {
            fleet.forget();
            fleet.tick();
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn holders_and_line_are_those_of_the_model_at_every_height(
        first in settings(),
        steps in prop::collection::vec((prop::bool::weighted(0.3), step()), 1..120),
    ) {
        let mut fleet = Fleet::empty();
        fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "exclusive")]);
        fleet.ok(&owner(), "policy", &["put", "p", &policy(&[])]);
        fleet.ok(&owner(), "configure", &[TURTLEBOT, &json(&first)]);
        let (mut model, mut seq) = (Model::new(first), 0);
        let mut newest = 0;
        for (joins, step) in &steps {
            let joins = *joins && !matches!(step, Step::Wait(_) | Step::Restart);
            let until = match step { Step::Wait(span) => fleet.time + span, _ => fleet.time };
            if !joins {
                tick_until(&mut fleet, &mut model, until);
            }
            let since = fleet.events.len();
            play(&mut fleet, &mut model, &mut seq, joins, step);
            for event in fleet.events[since..].iter().filter(|event| event.name == "granted") {
                let grant: Grant = serde_json::from_slice(&event.payload).unwrap();
                prop_assert!(grant.epoch > newest, "epoch {} after {newest}", grant.epoch);
                newest = grant.epoch;
            }
            let state: LineState = serde_json::from_slice(
                &fleet.simulate(&owner(), "line", &bytes(&[TURTLEBOT])).unwrap(),
            ).unwrap();
            let holders: Vec<_> = state.holders.iter().map(|grant| (grant.holder.clone(), grant.epoch)).collect();
            let wanted: Vec<_> = model.holders.iter().map(|holder| (name(holder.who), holder.epoch)).collect();
            prop_assert_eq!(holders, wanted, "holders after {:?}", step);
            let mut line: Vec<_> = state.line.iter().map(|place| place.contender.clone()).collect();
            let mut wanted: Vec<_> = model.line.iter().map(|waiter| name(waiter.who)).collect();
            line.sort();
            wanted.sort();
            prop_assert_eq!(line, wanted, "line after {:?}", step);
        }
    }
}
