//! A call in the product and in the model: their answers must be alike.

use super::Run;
use super::steps::{By, Step, json};
use crate::fleet::{bytes, identity, owner};
use crate::model::{Answer, Got, OWNER, PRIORITIES, Wanted};
use bytes::Bytes;
use ledger_abac::{Acquired, Submitted, Task};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use serde_json::json;
use std::sync::LazyLock;

pub(super) const ROBOTS: [&str; 2] = ["Turtlebot4", "Husky"];
pub(super) const SERVICES: [&str; 3] = ["Turtlebot4/cmd_vel", "Husky/cmd_vel", "Turtlebot4/cmd_vel:subscribe"];

/// Five people with priorities of their own, and an admin of the owner. Made once: a key takes time.
static PEOPLE: LazyLock<Vec<Identity>> = LazyLock::new(|| {
    let ranked = |who: usize| {
        let attributes = ["Turtlebot4", "Husky"];
        let mut person = identity("Org1", &format!("P{who}"), Role::Member, &attributes, 60 + who as u8);
        person.attributes.insert("rank".to_owned(), PRIORITIES[who].to_string());
        person
    };
    (0..OWNER).map(ranked).chain([owner()]).collect()
});

/// The robots themselves.
static MACHINES: LazyLock<[Identity; 2]> =
    LazyLock::new(|| ROBOTS.map(|name| identity("Org2", name, Role::Robot, &[], 90 + name.len() as u8)));

pub(super) fn person(who: usize) -> &'static Identity {
    &PEOPLE[who]
}

pub(super) fn name(who: usize) -> String {
    person(who).id()
}

pub(super) fn policy(forbidden: &[usize]) -> String {
    let names: Vec<String> = forbidden.iter().map(|who| format!("\"P{who}\"")).collect();
    let forbid =
        format!("forbid (principal, action, resource) when {{ [{}].contains(principal.name) }};", names.join(","));
    let forbid = if forbidden.is_empty() { String::new() } else { forbid };
    format!(
        "permit (principal, action, resource); permit (principal, action == Action::\"confirm\", resource); {forbid}"
    )
}

/// The task as its submitter types it.
fn task(wanted: &Wanted, priority: i64, now: u64) -> String {
    let points: Vec<_> = (0..wanted.points).map(|x| json!({"x_um": x, "y_um": 0})).collect();
    let mut task = json!({"points": points, "lease_ms": 10_000, "priority": priority, "requeue": wanted.requeue});
    for (key, span) in [("not_before", wanted.not_before), ("deadline", wanted.deadline)] {
        span.into_iter().for_each(|span| task[key] = (now + span).into());
    }
    task.to_string()
}

/// An answer as far as the model knows it.
fn got(function: &str, outcome: Result<Bytes, Rejection>) -> Answer {
    let answer = outcome.map_err(|refused| {
        assert!(!refused.message.is_empty() && !refused.found.is_empty(), "{refused}");
        assert!(refused.code != Code::ChaincodePanic && refused.code != Code::Internal, "{refused}");
        refused.code
    })?;
    Ok(match function {
        "acquire" | "renew" | "take" | "delegate" | "handover" | "recall" => {
            match serde_json::from_slice(&answer).unwrap() {
                Acquired::Granted(grant) => Got::Granted(grant.epoch),
                Acquired::Queued { .. } => Got::Queued,
                Acquired::Pending { .. } => Got::Pending,
            }
        }
        "submit" => {
            let Submitted { task, .. } = serde_json::from_slice(&answer).unwrap();
            Got::Task(task.id, task.state.known().unwrap())
        }
        "progress" | "fail" | "cancel" => {
            let task: Task = serde_json::from_slice(&answer).unwrap();
            Got::Task(task.id, task.state.known().unwrap())
        }
        _ => Got::Done,
    })
}

/// Plays one call. It is a block of its own, a millisecond after the one before, or in the same block.
pub(super) fn play(run: &mut Run, joins: bool, step: &Step) {
    run.fleet.joins = joins;
    let now = if joins { run.fleet.time } else { run.fleet.time + 1000 };
    if !joins {
        run.model.begin(now);
    }
    let newest = run.model.tasks.len() as u64;
    let id = |back: u64| newest.saturating_sub(back);
    let model = &mut run.model;
    let (who, function, args, wanted): (&Identity, &str, Vec<String>, Answer) = match step {
        Step::Acquire { at, who, less, wait } => {
            let wait_ms = wait.map(|wait| wait / 1000);
            let options =
                json!({"lease_ms": 10_000, "priority": priority(model, *at, *who, *less), "wait_ms": wait_ms});
            let answer = model.acquire(*at, *who, *less, *wait, now);
            (person(*who), "acquire", vec![SERVICES[*at].into(), options.to_string()], answer)
        }
        Step::AcquireAll { who, services, less } => {
            // One priority for all of them: the lowest that this one has anywhere.
            let lowest = services.iter().map(|at| priority(model, *at, *who, *less)).min().unwrap_or(0);
            let less: Vec<i64> = services.iter().map(|at| priority(model, *at, *who, 0) - lowest).collect();
            let same = less.iter().all(|one| *one == less[0]);
            let services = if same { &services[..] } else { &services[..1] };
            let lowest = priority(model, services[0], *who, less[0]);
            let options = json!({"lease_ms": 10_000, "priority": lowest});
            let ids = services.iter().map(|at| SERVICES[*at].to_owned());
            let args = std::iter::once(options.to_string()).chain(ids).collect();
            (person(*who), "acquire_all", args, model.acquire_all(*who, services, less[0], now))
        }
        Step::Confirm { at, by, who } => {
            let answer = model.confirm(*at, *by, *who, now);
            (person(*by), "confirm", vec![SERVICES[*at].into(), name(*who)], answer)
        }
        Step::Renew { at, who } => (person(*who), "renew", vec![SERVICES[*at].into()], model.renew(*at, *who, now)),
        Step::Release { at, who } => {
            (person(*who), "release", vec![SERVICES[*at].into()], model.release(*at, *who, now))
        }
        Step::Delegate { at, who, to, lasts, may_delegate } => {
            let lends = Some((*lasts, *may_delegate));
            let options = json!({"for_ms": lasts.map(|lasts| lasts / 1000), "may_delegate": may_delegate});
            let args = vec![SERVICES[*at].into(), name(*to), options.to_string()];
            (person(*who), "delegate", args, model.pass_on(*at, (*who, *to), lends, now))
        }
        Step::Lend { at, to, may_delegate } => {
            let who = model.services[*at].holders.last().map_or(0, |holder| holder.who);
            let options = json!({"may_delegate": may_delegate}).to_string();
            let args = vec![SERVICES[*at].into(), name(*to), options];
            (person(who), "delegate", args, model.pass_on(*at, (who, *to), Some((None, *may_delegate)), now))
        }
        Step::HandOver { at, who, to } => {
            let args = vec![SERVICES[*at].into(), name(*to)];
            (person(*who), "handover", args, model.pass_on(*at, (*who, *to), None, now))
        }
        Step::Recall { at, who } => (person(*who), "recall", vec![SERVICES[*at].into()], model.recall(*at, *who, now)),
        Step::Submit { at, who, wanted } => {
            let json = task(wanted, priority(model, *at, *who, wanted.less), now);
            (person(*who), "submit", vec![SERVICES[*at].into(), json], model.submit(*at, *who, wanted, now))
        }
        Step::Progress { by, back, more } => {
            let id = id(*back);
            let reached = model.kept(id).map_or(0, |task| task.reached) + more;
            let (identity, who) = reporter(model, *by, id);
            let args = vec![id.to_string(), reached.to_string()];
            (identity, "progress", args, model.progress(who, id, reached, now))
        }
        Step::Fail { by, back } => {
            let (identity, who) = reporter(model, *by, id(*back));
            (identity, "fail", vec![id(*back).to_string(), "no way".into()], model.fail(who, id(*back), now))
        }
        Step::Cancel { by, back } => {
            let id = id(*back);
            let who = match by {
                By::Submitter => model.kept(id).map_or(0, |task| task.who),
                By::Robot => OWNER,
                By::Person(who) => *who,
            };
            (person(who), "cancel", vec![id.to_string()], model.cancel(who, id, now))
        }
        Step::Take(at) => {
            let args = vec![SERVICES[*at].into(), "person in the cell".into(), "10000".into()];
            (person(OWNER), "take", args, model.take(*at, now))
        }
        Step::Stop(robot) => {
            model.stop(*robot, now);
            (person(OWNER), "stop", vec![ROBOTS[*robot].into(), "smoke".into()], Ok(Got::Done))
        }
        Step::Resume(robot) => {
            model.stopped[*robot] = false;
            (person(OWNER), "resume", vec![ROBOTS[*robot].into()], Ok(Got::Done))
        }
        Step::Set(at, settings) => {
            model.set(*at, *settings, now);
            (person(OWNER), "configure", vec![SERVICES[*at].into(), json(settings)], Ok(Got::Done))
        }
        Step::Forbid(who) => {
            model.forbid(who.clone(), now);
            (person(OWNER), "policy", vec!["put".into(), "p".into(), policy(who)], Ok(Got::Done))
        }
        Step::Publish { .. } | Step::Wait(_) | Step::Revoke(_) | Step::Restart => return otherwise(run, step, now),
    };
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let found = got(function, run.fleet.call(who, function, &bytes(&args)));
    assert_eq!(found, wanted, "{step:?}");
}

/// Plays a step that has no answer of which the model tells.
fn otherwise(run: &mut Run, step: &Step, now: u64) {
    match step {
        Step::Publish { at, who } => {
            let own = run.model.holder(*at, *who).map(|holder| holder.epoch);
            run.seq += 1;
            let published = run.fleet.set(person(*who), SERVICES[*at], own.unwrap_or(1), run.seq, 1);
            assert_eq!(published.is_ok(), run.model.publish(*at, *who, now), "{published:?}");
        }
        Step::Revoke(who) => {
            run.fleet.revoke(person(*who));
            run.model.revoke(*who, now);
        }
        Step::Restart => {
            run.fleet.forget();
            run.fleet.tick();
        }
        _ => run.fleet.tick(),
    }
}

fn priority(model: &crate::model::Model, at: usize, who: usize, less: i64) -> i64 {
    model.services[at].settings.priority(who, less)
}

/// The one who reports about a task, and its number among the people; the robot has none.
fn reporter(model: &crate::model::Model, by: By, id: u64) -> (&'static Identity, Option<usize>) {
    let task = model.kept(id).ok();
    match by {
        By::Submitter => {
            let who = task.map_or(0, |task| task.who);
            (person(who), Some(who))
        }
        By::Robot => (&MACHINES[task.map_or(0, |task| task.at)], None),
        By::Person(who) => (person(who), Some(who)),
    }
}
