//! `check`: the faults of a policy, or its meaning, with the names in it that are unknown today.

use crate::arguments::Arguments;
use crate::calls::question::ASK_BYTES_MAX;
use crate::lifecycle::people;
use crate::policy::decider::Decider;
use crate::records::{robot, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::Rejection;
use ledger_contract::UnknownName;

/// Most names that are looked up.
const NAMES_MAX: usize = 256;

/// `check TEXT`: the faults of a policy with their places. If it is acceptable, the meaning of each policy in words, and the names that
/// the network does not know today.
pub(crate) fn check(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("check TEXT", args, 1, 1)?;
    let mut checked = decider.diagnose(args.document(0, "TEXT", ASK_BYTES_MAX)?);
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
    store::json(&checked)
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
