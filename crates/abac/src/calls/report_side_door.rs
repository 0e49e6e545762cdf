//! `report_side_door`: the robot's bridge reports a rogue publisher, which publishes on the robot's own topic around the ledger.
//!
//! A report changes nobody's rights. It is there so that the owner's people see it on any node, also later. So it comes from
//! those whom the owner has put next to the robot, and rarely.

use crate::arguments::Arguments;
use crate::calls::description::check_topic;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{side_door, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, SideDoor};
use ledger_identity::{Identity, Role};

/// At least so long between two reports about one service (block time, microseconds).
pub(crate) const PAUSE_US: u64 = 60_000_000;

/// Most publishers of one report: more than a graph has.
pub(crate) const PUBLISHERS_MAX: u64 = 65_535;

/// `report_side_door SERVICE TOPIC PUBLISHERS`: so many publish on the local topic beside the bridge; 0 once they have left.
pub(crate) fn report(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("report_side_door SERVICE TOPIC PUBLISHERS", args, 3, 3)?;
    let submitter = ctx.submitter()?;
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    check_reporter(submitter, &target.robot)?;
    if target.service.direction != Direction::Command || target.is_for_readers() {
        return Err(Rejection::new(Code::BadArgument, format!("{} has no side door", target.id))
            .found(if target.is_for_readers() { "subscriber slots" } else { "a feed: the robot publishes there" })
            .wanted("a command service")
            .next(format!("choose a command service: ledgerctl robot show {}", target.robot.name)));
    }
    let (topic, publishers) = (args.text(1, "TOPIC")?, args.number(2, "PUBLISHERS")?);
    check_topic(topic)?;
    if publishers > PUBLISHERS_MAX {
        return Err(args.bad(2, "PUBLISHERS", publishers.to_string(), &format!("0 to {PUBLISHERS_MAX}")));
    }
    let last = side_door::of(ctx, &target.id)?;
    check_pause(ctx, &target, last.as_ref())?;
    let (now, by) = (ctx.block_time(), submitter.id());
    let open = last.filter(|last| last.publishers > 0);
    if open.is_none() && publishers == 0 {
        return Err(args.bad(
            2,
            "PUBLISHERS",
            "0, although no side door is reported".to_owned(),
            "the number of rogue publishers",
        ));
    }
    let since = open.map_or(now, |open| open.since);
    let report = SideDoor { service: target.id.clone(), topic: topic.to_owned(), publishers, by, since, at: now };
    side_door::put(ctx, &report)?;
    let told = store::json(&report)?;
    ctx.emit("side_door", &target.id, told.clone());
    Ok(told)
}

/// Refuses who is neither the robot itself nor a node of its owner.
fn check_reporter(submitter: &Identity, robot: &Robot) -> Result<(), Rejection> {
    let is_owners_node = submitter.role == Role::Node && submitter.organisation == robot.organisation;
    if is_owners_node || robot.is(submitter) {
        return Ok(());
    }
    let (name, owner) = (&robot.name, &robot.organisation);
    Err(Rejection::new(Code::NotOwner, format!("{} may not report a side door of {name}", submitter.id()))
        .found(format!("role {} of {}", submitter.role, submitter.organisation))
        .wanted(format!("the robot {owner}/{name} itself, or a node of {owner}"))
        .next(format!("run the robot's bridge as {owner}/{name}: ledgerctl identity register {name} --role robot")))
}

/// Refuses a report that comes too soon after the last one.
fn check_pause(ctx: &Context<'_>, target: &Target, last: Option<&SideDoor>) -> Result<(), Rejection> {
    let Some(last) = last else { return Ok(()) };
    let since = ctx.block_time().saturating_sub(last.at);
    if since >= PAUSE_US {
        return Ok(());
    }
    let seconds = PAUSE_US / 1_000_000;
    Err(Rejection::new(Code::LimitExceeded, format!("a side door of {} was reported a moment ago", target.id))
        .found(format!("a report by {} {} s ago", last.by, since / 1_000_000))
        .wanted(format!("a report at most once in {seconds} s"))
        .next("report again in a minute, if it is still open then"))
}
