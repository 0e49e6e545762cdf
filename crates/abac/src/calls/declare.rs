//! `declare`: the state of a robot, certified by the voters.

use crate::arguments::Arguments;
use crate::calls::{emergency, views};
use crate::lifecycle::holders;
use crate::policy::decider::Decider;
use crate::records::cancelled;
use crate::records::target::Target;
use crate::records::task::Kept;
use crate::records::{robot, store, task};
use bytes::Bytes;
use ledger::{CallRef, Context};
use ledger_base::rejection::Rejection;
use ledger_contract::{Declaration, Grant, NEXT_MAX, RunningTask, Task};

/// `declare ROBOT [CALL...]`: writes the robot's record once more, so that voters certify this block, and with it the answer. So a
/// reader that trusts no single node learns the robot's state. Of the stops that it names (`ID:NOT_AFTER`), the answer lists those
/// that are settled.
pub(crate) fn declare(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("declare ROBOT [CALL...]", args, 1, 1 + emergency::NAMED_MAX)?;
    let named = emergency::named(args, 1)?;
    let robot = robot::find(ctx, args.text(0, "ROBOT")?)?;
    store::write(ctx, &store::robot_key(&robot.name), &robot)?;
    let mut grants = Vec::new();
    for service in &robot.services {
        grants.extend(holders::live(ctx, decider, &Target::of(&robot, service))?);
    }
    let told = views::asset(ctx, decider, &robot)?;
    let tasks = running(ctx, &grants)?;
    let mut settled = Vec::new();
    for CallRef { id, not_after } in named {
        if ctx.is_settled(&id, not_after) || cancelled::has(ctx, &robot.name, &id)? {
            settled.push(id.to_string());
        }
    }
    store::json(&Declaration { robot: told, grants, tasks, settled })
}

/// The tasks that these grants serve.
pub(crate) fn running(ctx: &Context<'_>, grants: &[Grant]) -> Result<Vec<RunningTask>, Rejection> {
    let mut running = Vec::new();
    for id in grants.iter().filter_map(|grant| grant.task) {
        if let Some(Kept { task, .. }) = task::find(ctx, id)? {
            let Task { id, service, frame, reached, .. } = task;
            let skipped = usize::try_from(reached).unwrap_or(usize::MAX);
            let next = task::points(ctx, id)?.into_iter().skip(skipped).take(NEXT_MAX).collect();
            running.push(RunningTask { id, service, frame, reached, next });
        }
    }
    Ok(running)
}
