//! `stop` and `resume`: a robot that is stopped is commanded by nobody, until somebody who may resumes it.

use super::{end, queue};
use crate::arguments::Arguments;
use crate::policy::decider::{Decider, RobotAction};
use crate::records::principal::Principal;
use crate::records::robot::{self, Robot};
use crate::records::service::Target;
use crate::records::{grant, stopped, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, Emergency, EmergencyAnswer, Reason, Stopped};

/// Stands for all robots that the caller may stop or resume.
const ALL: &str = "*";

/// `stop ROBOT|* [REASON]`: ends every grant of its command services, and gives none until it is resumed.
pub(crate) fn stop(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("stop ROBOT|* [REASON]", args, 1, 2)?;
    let reason = reason(args)?;
    let by = ctx.submitter()?.id();
    let (mut robots, mut unchanged, mut ending) = (Vec::new(), Vec::new(), Vec::new());
    for robot in chosen(ctx, decider, args, RobotAction::Stop)? {
        if stopped::of(ctx, &robot.name)?.is_some() {
            unchanged.push(robot.name);
            continue;
        }
        let stop = Stopped { by: by.clone(), reason: reason.clone(), since: ctx.block_time() };
        stopped::put(ctx, &robot.name, &stop)?;
        for target in commands(&robot) {
            ending.extend(grant::live(ctx, &target.id)?.into_iter().map(|holding| (holding, Reason::Stopped)));
        }
        // So many robots that there is no room to tell of them are stopped all the same.
        if !end::is_full(ctx) {
            let told = told(&robot, &by, &reason)?;
            ctx.emit("stopped", &robot.name, told);
        }
        robots.push(robot.name);
    }
    let ended = end::end_all(ctx, ending)?;
    store::json(&EmergencyAnswer { robots, unchanged, ended })
}

/// `resume ROBOT|* [REASON]`: it may be commanded again. Nobody has it then but whose turn it is in line.
pub(crate) fn resume(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("resume ROBOT|* [REASON]", args, 1, 2)?;
    let reason = reason(args)?;
    let by = ctx.submitter()?.id();
    let (mut robots, mut unchanged) = (Vec::new(), Vec::new());
    for robot in chosen(ctx, decider, args, RobotAction::Resume)? {
        if stopped::of(ctx, &robot.name)?.is_none() {
            unchanged.push(robot.name);
            continue;
        }
        stopped::remove(ctx, &robot.name);
        for target in commands(&robot) {
            queue::look_now(ctx, &target.id)?;
        }
        if !end::is_full(ctx) {
            let told = told(&robot, &by, &reason)?;
            ctx.emit("resumed", &robot.name, told);
        }
        robots.push(robot.name);
    }
    store::json(&EmergencyAnswer { robots, unchanged, ended: Vec::new() })
}

fn reason(args: Arguments<'_>) -> Result<String, Rejection> {
    if args.has(1) { args.text(1, "REASON").map(str::to_owned) } else { Ok(String::new()) }
}

/// The robots that are meant, all of which the caller may stop or resume.
fn chosen(
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
fn commands(robot: &Robot) -> impl Iterator<Item = Target> + '_ {
    let commands = robot.services.iter().filter(|service| service.direction == Direction::Command);
    commands.map(|service| Target::of(robot, service))
}

fn told(robot: &Robot, by: &str, reason: &str) -> Result<Bytes, Rejection> {
    store::json(&Emergency { robot: robot.name.clone(), by: by.to_owned(), reason: reason.to_owned() })
}

/// May the service be commanded, or is its robot stopped?
///
/// # Errors
/// [`Code::Stopped`].
pub(crate) fn check_goes(ctx: &Context<'_>, target: &Target) -> Result<(), Rejection> {
    if target.service.direction != Direction::Command || target.is_for_readers() {
        return Ok(());
    }
    let Some(Stopped { by, reason, since }) = stopped::of(ctx, &target.robot.name)? else { return Ok(()) };
    let (name, owner) = (&target.robot.name, &target.robot.organisation);
    let why = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    Err(Rejection::new(Code::Stopped, format!("{name} is stopped"))
        .found(format!("stopped by {by} at {}{why}", rfc3339(since)))
        .wanted("a robot that is not stopped")
        .next(format!("once it is safe, an admin of {owner} resumes it: ledgerctl resume {name}")))
}
