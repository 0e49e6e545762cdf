//! The robots that a caller may stop and resume.

use crate::arguments::Arguments;
use crate::policy::action::RobotAction;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::{CallRef, Context};
use ledger_base::rejection::Rejection;
use ledger_contract::{Direction, Emergency};

/// Most calls that one call names.
pub(crate) const NAMED_MAX: usize = 64;
/// Stands for all robots that the caller may stop or resume.
const ALL: &str = "*";

pub(crate) fn reason(args: Arguments<'_>) -> Result<String, Rejection> {
    // A resume without a reason that names calls has an empty one before them.
    let given = args.rest(1).first().is_some_and(|reason| args.rest(2).is_empty() || !reason.is_empty());
    if given { args.text(1, "REASON").map(str::to_owned) } else { Ok(String::new()) }
}

/// The calls that the arguments name, from this index on.
///
/// # Errors
/// [`ledger_base::rejection::Code::BadArgument`].
pub(crate) fn named(args: Arguments<'_>, index: usize) -> Result<Vec<CallRef>, Rejection> {
    let named = index..index.saturating_add(args.rest(index).len());
    named
        .map(|at| {
            let text = args.text(at, "CALL")?;
            text.parse().map_err(|wrong: Rejection| args.bad(at, "CALL", wrong.found, &wrong.wanted))
        })
        .collect()
}

/// The robots that are meant, all of which the caller may stop or resume.
pub(crate) fn chosen(
    ctx: &Context<'_>,
    decider: &Decider,
    args: Arguments<'_>,
    action: RobotAction,
) -> Result<Vec<Robot>, Rejection> {
    let principal = Principal::of(ctx.submitter()?);
    let name = args.text(0, "ROBOT|*")?;
    if name != ALL {
        let robot = robot::find(ctx, name)?;
        decider.decide_on_robot(ctx, &principal, &robot, action)?;
        return Ok(vec![robot]);
    }
    let (mut may, mut refused) = (Vec::new(), None);
    for robot in robot::all(ctx)? {
        match decider.decide_on_robot(ctx, &principal, &robot, action) {
            Ok(()) => may.push(robot),
            Err(no) => refused = refused.or(Some(no)),
        }
    }
    match refused {
        Some(refused) if may.is_empty() => Err(refused),
        _ => Ok(may),
    }
}

/// The command services of a robot.
pub(crate) fn commands(robot: &Robot) -> impl Iterator<Item = Target> + '_ {
    let commands = robot.services.iter().filter(|service| service.direction == Direction::Command);
    commands.map(|service| Target::of(robot, service))
}

pub(crate) fn told(robot: &Robot, by: &str, reason: &str) -> Result<Bytes, Rejection> {
    store::json(&Emergency { robot: robot.name.clone(), by: by.to_owned(), reason: reason.to_owned() })
}
