//! The turns of those who wait, at the start of a block.
//!
//! An action that ends a grant, or may change whose turn it is, notes that the service is to be
//! [looked at](crate::records::line::look_by). The start of the next block [resumes](resume) it: no caller pays for the turns of
//! others, and no release can fail because of the contenders that wait. The work of a block is bounded: services that are looked at, turns,
//! and steps of policies.

use super::follow_up::Ending;
use super::settle::settle;
use crate::lifecycle::acquisition;
use crate::lifecycle::contest::Contest;
use crate::lifecycle::contest::claim;
use crate::lifecycle::grants::{GrantTerms, Inheritance};
use crate::lifecycle::undecided::IN_BLOCK;
use crate::lifecycle::{capacity, confirmation, departures, looks, queue, stops, task_ends, undecided};
use crate::policy::decider;
use crate::policy::decider::Decider;
use crate::records::grant::{HOLDERS_MAX, Holding};
use crate::records::line::Waiting;
use crate::records::target::Target;
use crate::records::{last, line, target};
use crate::rules::Decision;
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{LeftReason, Reason};

/// Most services that are looked at in one block.
const LOOKS_MAX: usize = 16;

/// Most turns of one service in one block.
const TURNS_MAX: usize = 16;

/// The work that the start of a block may still do.
struct Allowance {
    steps: u64,
    is_fresh: bool,
}

impl Allowance {
    /// Takes the steps of one more decision; the first one is always allowed.
    fn take(&mut self, steps: u64) -> bool {
        let is_allowed = self.is_fresh || steps <= self.steps;
        self.is_fresh = false;
        self.steps = self.steps.saturating_sub(steps);
        is_allowed
    }
}

/// Looks at the services whose time has come, at the start of a block.
pub(crate) fn resume(ctx: &mut Context<'_>, decider: &Decider) -> Result<(), Rejection> {
    let now = ctx.block_time();
    if looks::next_look(ctx).is_none_or(|time| time > now) {
        return Ok(());
    }
    let mut allowance = Allowance { steps: IN_BLOCK, is_fresh: true };
    for (_, service) in line::next_looks(ctx, LOOKS_MAX).into_iter().filter(|(time, _)| *time <= now) {
        if capacity::is_full(ctx) {
            break;
        }
        look(ctx, decider, &service, &mut allowance)?;
    }
    Ok(())
}

/// Looks at one service: ends what is idle, sends away who has waited too long, and gives it to whose turn it is.
fn look(ctx: &mut Context<'_>, decider: &Decider, service: &str, allowance: &mut Allowance) -> Result<(), Rejection> {
    line::looked_at(ctx, service)?;
    let target = match target::resolve(ctx, service) {
        Ok(target) => target,
        Err(gone) if matches!(gone.code, Code::UnknownRobot | Code::UnknownService) => return dissolve(ctx, service),
        Err(fault) => return Err(fault),
    };
    let (idle, unconfirmed) = (end_idle(ctx, decider, &target)?, confirmation::send_away(ctx, service, false)?);
    let before = line::all(ctx, service)?;
    task_ends::due(ctx, &target)?;
    departures::send_away(ctx, decider, &target)?;
    let again = if stops::check_goes(ctx, &target).is_ok() { turns(ctx, decider, &target, allowance)? } else { None };
    let line = line::all(ctx, service)?;
    let patience = line.iter().map(|waiting| waiting.until).min();
    if let Some(next) =
        [idle, unconfirmed, again, patience, task_ends::next_due(ctx, service)].into_iter().flatten().min()
    {
        line::look_by(ctx, service, next)?;
    }
    if line == before { Ok(()) } else { queue::tell(ctx, decider, &target) }
}

/// The service is gone: nobody waits for it any more.
fn dissolve(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let asks = confirmation::send_away(ctx, service, true)?.is_some();
    let line = line::all(ctx, service)?;
    let left = line.iter().map(|waiting| (waiting, LeftReason::RobotRemoved));
    let is_left = departures::drop_some(ctx, service, left)?;
    task_ends::dissolve(ctx, service)?;
    if is_left || asks { line::look_by(ctx, service, ctx.block_time()) } else { Ok(()) }
}

/// Ends the grants of who has published nothing for too long. Answers when the next one would be.
fn end_idle(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<Option<u64>, Rejection> {
    let Some(idle) = Terms::of(&target.service.sharing).idle_release_us else { return Ok(None) };
    let (now, mut next) = (ctx.block_time(), None);
    for holding in Contest::of(ctx, target)?.holders {
        let until = last_use(ctx, decider, target, &holding)?.saturating_add(idle);
        if until <= now && !capacity::is_full(ctx) {
            settle(ctx, [Ending::of(&holding, Reason::Idle)])?;
        } else {
            next = Some(next.map_or(until, |next: u64| next.min(until)));
        }
    }
    Ok(next)
}

/// When a holder last published, or got the service (block time, microseconds).
fn last_use(ctx: &Context<'_>, decider: &Decider, target: &Target, holding: &Holding) -> Result<u64, Rejection> {
    let sequence = decider.rules.capabilities(target)?.sequence;
    let last = last::read(ctx, &target.id, sequence, &holding.grant.holder)?;
    let own = last.filter(|last| last.publisher == holding.grant.holder).and_then(|last| last.at);
    Ok(own.unwrap_or(0).max(holding.grant.acquired_at))
}

/// Gives the service to whose turn it is, one after the other. Answers when to look again, if that is known.
fn turns(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    allowance: &mut Allowance,
) -> Result<Option<u64>, Rejection> {
    let rule = decider.rules.of(target)?;
    let steps = undecided::of_one(ctx, &target.robot.organisation)?;
    for _ in 0..TURNS_MAX {
        let contest = Contest::of(ctx, target)?;
        let next = contest.in_order(rule).find(|waiting| !contest.holds(&waiting.contender)).cloned();
        let Some(next) = next else { return Ok(None) };
        match contest.decide(rule, &claim(&next)) {
            Decision::Wait { again } => return Ok(again),
            Decision::Refuse if capacity::is_full(ctx) => return Ok(Some(ctx.block_time())),
            Decision::Refuse => departures::dismiss(ctx, &target.id, &next.place(), LeftReason::Rule)?,
            // Whoever goes next makes room, and the service is looked at then.
            Decision::Grant { ends } if contest.holders.len() >= HOLDERS_MAX + ends.len() => return Ok(None),
            Decision::Grant { .. } if capacity::is_full(ctx) || !allowance.take(steps) => {
                return Ok(Some(ctx.block_time()));
            }
            Decision::Grant { ends } => {
                let ended = ends.iter().filter_map(|index| contest.holders.get(*index));
                turn(ctx, decider, target, &next, ended.cloned().collect())?;
            }
        }
    }
    Ok(Some(ctx.block_time()))
}

/// The turn of one contender: policies decide again.
fn turn(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    waiting: &Waiting,
    ended: Vec<Holding>,
) -> Result<(), Rejection> {
    let place = waiting.place();
    let Some(principal) = line::principal(ctx, &target.id, &place)? else {
        return line::remove(ctx, &target.id, &place);
    };
    if principal.not_after <= ctx.block_time() {
        return departures::dismiss(ctx, &target.id, &place, LeftReason::Expired);
    }
    let Ok(permit) = decider::may_hold(ctx, decider, &principal, target) else {
        return departures::dismiss(ctx, &target.id, &place, LeftReason::Policy);
    };
    let preempts = !ended.is_empty();
    let ending: Vec<_> =
        ended.iter().map(|holding| Ending::for_other(holding, Reason::Preempted, &principal)).collect();
    settle(ctx, ending)?;
    line::remove(ctx, &target.id, &place)?;
    let lease_ms = waiting.lease_ms.unwrap_or(target.service.lease_ms).min(target.service.lease_ms_max);
    let (priority, inherited) = (waiting.priority, Inheritance { preempts, ..Inheritance::default() });
    let terms = GrantTerms { principal, lease_ms, priority, permit, taken: None, inherited, task: waiting.task };
    acquisition::give(ctx, decider, target, terms).map(drop)
}
