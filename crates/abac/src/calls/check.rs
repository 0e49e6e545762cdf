//! `check`: the faults of a policy, or its meaning, with the names in it that are unknown today.

use crate::arguments::Arguments;
use crate::calls::question::{ASK_BYTES_MAX, OF_ROBOT, OF_SERVICE};
use crate::lifecycle::people;
use crate::policy::action::Object;
use crate::policy::decider::Decider;
use crate::policy::limits;
use crate::records::target::Target;
use crate::records::{robot, store, target};
use bytes::Bytes;
use ledger::{Context, Page, Paging};
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::Rejection;
use ledger_contract::{PolicyCheck, UnknownName};

/// Most questions to find out whom a policy concerns.
const QUESTIONS_MAX: usize = 4096;
/// Most steps of all these questions.
const STEPS_MAX: u64 = 16 * 1024 * 1024;
/// Most names that are looked up.
const NAMES_MAX: usize = 256;

/// `check TEXT`: the faults of a policy with their places. If it is acceptable, the meaning of each policy in words, and the names that
/// the network does not know today.
pub(crate) fn check(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("check TEXT", args, 1, 1)?;
    store::json(&checked(ctx, decider, args.document(0, "TEXT", ASK_BYTES_MAX)?)?)
}

/// The same for a text.
pub(crate) fn checked(ctx: &mut Context<'_>, decider: &Decider, text: &str) -> Result<PolicyCheck, Rejection> {
    let mut checked = decider.diagnose(text);
    checked.unknown.truncate(NAMES_MAX);
    let mut unknown = Vec::new();
    let organisations: Vec<String> = store::parse(b"msp organisations", &ctx.call("msp", "organisations", &[])?)?;
    for name in checked.unknown {
        if !is_known(ctx, &organisations, &name) {
            let near = near(ctx, &name)?;
            unknown.push(UnknownName { near, ..name });
        }
    }
    checked.unknown = unknown;
    if !checked.policies.is_empty() {
        let matched = matched(ctx, decider, text)?;
        for (policy, matched) in checked.policies.iter_mut().zip(matched) {
            policy.unmatched = !matched;
        }
    }
    Ok(checked)
}

/// For each policy: does it apply to anybody of today, and to a robot of the caller's organisation? Nothing where that would take too
/// many questions, or where the ledger knows no people or robots.
fn matched(ctx: &mut Context<'_>, decider: &Decider, text: &str) -> Result<Vec<bool>, Rejection> {
    let organisation = ctx.submitter()?.organisation.clone();
    let robots: Vec<_> = robot::all(ctx)?.into_iter().filter(|robot| robot.organisation == organisation).collect();
    let targets: Vec<Target> = robots.iter().flat_map(|robot| Target::all_of(robot).collect::<Vec<_>>()).collect();
    let of_services = targets.iter().flat_map(|target| OF_SERVICE.map(move |action| Object::Service(target, action)));
    let of_robots = robots.iter().flat_map(|robot| OF_ROBOT.map(move |action| Object::Robot(robot, action)));
    let objects: Vec<Object<'_>> = of_services.chain(of_robots).collect();
    let page = ctx.call("msp", "enrolled", &[store::json(&Paging::at(None))?])?;
    let page: Page<String> = store::parse(b"msp enrolled", &page)?;
    if page.next.is_some() || page.items.len().saturating_mul(objects.len()) > QUESTIONS_MAX {
        return Ok(Vec::new());
    }
    let people: Vec<_> = page.items.iter().filter_map(|id| people::certified(ctx, id).ok()).collect();
    if people.is_empty() || objects.is_empty() {
        return Ok(Vec::new());
    }
    let steps = limits::steps(text)?.saturating_mul((people.len() * objects.len()) as u64);
    if steps > STEPS_MAX {
        return Ok(Vec::new());
    }
    ctx.charge_steps(&organisation, steps, || Hash::of(&[b"matched\0", text.as_bytes()]));
    Ok(decider.matching(ctx, &people, &objects, text))
}

/// Does the network know it today?
fn is_known(ctx: &mut Context<'_>, organisations: &[String], UnknownName { kind, name, .. }: &UnknownName) -> bool {
    match kind.as_str() {
        "User" => people::certified(ctx, name).is_ok(),
        "Organisation" => organisations.contains(name),
        "Robot" => robot::find(ctx, name).is_ok(),
        _ => target::resolve(ctx, name).is_ok_and(|target| target.id == *name),
    }
}

/// The name of a robot or a service that was probably meant, in words.
fn near(ctx: &Context<'_>, UnknownName { kind, name, .. }: &UnknownName) -> Result<String, Rejection> {
    if !["Robot", "Service"].contains(&kind.as_str()) {
        return Ok(String::new());
    }
    let robots = robot::all(ctx)?;
    let robot_names = robots.iter().map(|robot| robot.name.clone());
    let names: Vec<String> = match kind.as_str() {
        "Robot" => robot_names.collect(),
        _ => robots.iter().flat_map(|robot| robot.services.iter().map(|service| robot.service_id(service))).collect(),
    };
    Ok(did_you_mean(name, names.iter().map(String::as_str), ""))
}
