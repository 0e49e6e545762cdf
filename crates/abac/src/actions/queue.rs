//! The line of a service: joining it, leaving it, and the turns, which come at the start of a block.
//!
//! An action that ends a grant, or may change whose turn it is, notes that the service is to be [looked at](line::look_by).
//! The start of the next block [goes on](go_on) with it: no caller pays for the turns of others, and nobody's release can fail
//! because of who waits. The work of a block is bounded: services that are looked at, turns, and steps of policies.

use super::acquire::{self, Award, Passed};
use super::contest::{Contest, claim};
use super::undecided::{self, IN_BLOCK};
use super::{confirm, emergency, end, task_turns};
use crate::policy::decider::{self, Decider};
use crate::records::grant::{HOLDERS_MAX, Holding};
use crate::records::line::{self, Waiting};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::{last, pending, store, task};
use crate::rules::Decision;
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Left, LeftReason, LineTold, Place, Reason};

/// Most lines in which one certificate waits.
pub(crate) const WAITS_MAX: usize = 64;
/// Most services that are looked at in one block.
const LOOKS_MAX: usize = 16;
/// Most turns of one service in one block.
const TURNS_MAX: usize = 16;
/// Most contenders that one look sends away, each with an event.
const LEAVING_MAX: usize = 256;
/// How many of a line an event names.
const TOLD_MAX: usize = 16;

/// Puts a contender in line, or tells it the place that it has.
///
/// # Errors
/// [`Code::Held`] if it does not want to wait, [`Code::LineFull`], or [`Code::LimitExceeded`].
pub(crate) fn join(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    options: &AcquireOptions,
    priority: i64,
) -> Result<Place, Rejection> {
    let contest = Contest::of(ctx, target)?;
    let terms = Terms::of(&target.service.sharing);
    if options.wait_ms == Some(0) {
        return Err(acquire::held(target, &contest.holders));
    }
    let contender = principal.id();
    let before = contest.line.iter().find(|waiting| waiting.place() == contender);
    if before.is_none() {
        let most = decider.rules.of(target)?.line_max(&target.service.sharing);
        check_room(ctx, target, principal, &contest, most)?;
    }
    let now = ctx.block_time();
    let wait =
        options.wait_ms.map_or(terms.queue_wait_max_us, |ms| ms.saturating_mul(1000).min(terms.queue_wait_max_us));
    let waiting = Waiting {
        contender: contender.clone(),
        ticket: before.map_or_else(|| contest.line.last().map_or(1, |last| last.ticket + 1), |before| before.ticket),
        priority: before.map_or(priority, |before| before.priority),
        since: before.map_or(now, |before| before.since),
        until: now.saturating_add(wait).min(principal.not_after),
        lease_ms: options.lease_ms.or(before.and_then(|before| before.lease_ms)),
        task: None,
    };
    let is_new = before.is_none();
    pending::remove(ctx, &target.id, &contender)?;
    line::put(ctx, &target.id, &waiting, principal)?;
    line::look_by(ctx, &target.id, waiting.until)?;
    let places = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    let place = places.iter().find(|place| place.contender == contender && place.task.is_none()).cloned();
    let place = place.ok_or_else(|| Rejection::new(Code::Internal, format!("{contender} is not in line")))?;
    ctx.emit("queued", &target.id, store::json(&place)?);
    if is_new {
        tell_places(ctx, target, &places)?;
    }
    Ok(place)
}

/// Refuses one more place in a line that is full, or to a certificate that has too many.
pub(crate) fn check_room(
    ctx: &Context<'_>,
    target: &Target,
    principal: &Principal,
    contest: &Contest<'_>,
    most: u64,
) -> Result<(), Rejection> {
    let id = &target.id;
    if contest.line.len() as u64 >= most {
        return Err(Rejection::new(Code::LineFull, format!("the line of {id} is full"))
            .found(format!("{} who wait", contest.line.len()))
            .wanted(format!("fewer than {most}"))
            .next(format!("try again later; to see who waits: ledgerctl queue {id}")));
    }
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    let waits = line::of_certificate(ctx, &principal.issuer.0, &serial).len();
    if waits >= WAITS_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} waits in too many lines", principal.id()))
            .found(format!("{waits} lines"))
            .wanted(format!("fewer than {WAITS_MAX}"))
            .next("leave a line first: ledgerctl release ROBOT/TOPIC"));
    }
    Ok(())
}

/// Takes a contender out of the line, if it is there. Answers if it was.
pub(crate) fn leave(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    contender: &str,
    reason: LeftReason,
) -> Result<bool, Rejection> {
    if line::of(ctx, &target.id, contender)?.is_none() {
        return confirm::withdraw(ctx, &target.id, contender, reason);
    }
    drop_out(ctx, &target.id, contender, reason)?;
    line::look_by(ctx, &target.id, ctx.block_time())?;
    tell(ctx, decider, target)?;
    Ok(true)
}

/// A contender is given the service now: it waits no longer.
pub(crate) fn granted(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    contender: &str,
) -> Result<(), Rejection> {
    pending::remove(ctx, &target.id, contender)?;
    if line::of(ctx, &target.id, contender)?.is_some() {
        line::remove(ctx, &target.id, contender)?;
        tell(ctx, decider, target)?;
    }
    Ok(())
}

fn drop_out(ctx: &mut Context<'_>, service: &str, place: &str, reason: LeftReason) -> Result<(), Rejection> {
    line::remove(ctx, service, place)?;
    if let Some(id) = line::task_at(place) {
        return task_turns::left(ctx, id, reason);
    }
    let left = Left { service: service.to_owned(), contender: place.to_owned(), reason: reason.into() };
    ctx.emit("left", service, store::json(&left)?);
    Ok(())
}

/// Tells how the line is now.
pub(crate) fn tell(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<(), Rejection> {
    let places = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    tell_places(ctx, target, &places)
}

fn tell_places(ctx: &mut Context<'_>, target: &Target, places: &[Place]) -> Result<(), Rejection> {
    let next = places.iter().take(TOLD_MAX).map(|place| place.contender.clone()).collect();
    let told = LineTold { service: target.id.clone(), waiting: places.len() as u64, next };
    ctx.emit("line", &target.id, store::json(&told)?);
    Ok(())
}

/// A certificate was revoked: it waits nowhere any more.
pub(crate) fn revoked(
    ctx: &mut Context<'_>,
    decider: &Decider,
    issuer: &[u8; 32],
    serial: &[u8],
) -> Result<(), Rejection> {
    for (service, place) in line::of_certificate(ctx, issuer, serial) {
        drop_out(ctx, &service, &place, LeftReason::Revoked)?;
        line::look_by(ctx, &service, ctx.block_time())?;
        if let Ok(target) = service::resolve(ctx, &service) {
            tell(ctx, decider, &target)?;
        }
    }
    confirm::revoked(ctx, issuer, serial)?;
    task_turns::revoked(ctx, issuer, serial)
}

/// An organisation left: its members wait no more for this service. Events name the first of them.
pub(crate) fn members_left(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    organisation: &str,
) -> Result<(), Rejection> {
    let service = &target.id;
    confirm::members_left(ctx, service, organisation)?;
    let waiting = line::all(ctx, service)?;
    task_turns::members_left(ctx, service, organisation)?;
    let theirs = waiting.iter().filter(|waiting| waiting.contender.split('/').next() == Some(organisation));
    if theirs.clone().next().is_none() {
        return Ok(());
    }
    for (waiting, told) in theirs.zip(0_usize..) {
        if told < TOLD_MAX {
            drop_out(ctx, service, &waiting.place(), LeftReason::Revoked)?;
        } else {
            line::remove(ctx, service, &waiting.place())?;
        }
    }
    line::look_by(ctx, service, ctx.block_time())?;
    tell(ctx, decider, target)
}

/// Something about the service has changed that may make it somebody's turn.
pub(crate) fn look_now(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let nobody = |ctx: &Context<'_>| {
        line::is_empty(ctx, service) && task::open(ctx, service, 1).is_empty() && pending::is_empty(ctx, service)
    };
    if !nobody(ctx) {
        line::look_by(ctx, service, ctx.block_time())?;
    }
    Ok(())
}

/// The settings of the service have changed.
pub(crate) fn settings_changed(ctx: &mut Context<'_>, target: &Target) -> Result<(), Rejection> {
    if Terms::of(&target.service.sharing).idle_release_us.is_some() {
        line::look_by(ctx, &target.id, ctx.block_time())?;
    }
    look_now(ctx, &target.id)
}

/// When a service is to be looked at next (block time, microseconds).
pub(crate) fn next_look(ctx: &Context<'_>) -> Option<u64> {
    line::next_looks(ctx, 1).first().map(|(time, _)| *time)
}

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
pub(crate) fn go_on(ctx: &mut Context<'_>, decider: &Decider) -> Result<(), Rejection> {
    let now = ctx.block_time();
    if next_look(ctx).is_none_or(|time| time > now) {
        return Ok(());
    }
    let mut allowance = Allowance { steps: IN_BLOCK, is_fresh: true };
    for (_, service) in line::next_looks(ctx, LOOKS_MAX).into_iter().filter(|(time, _)| *time <= now) {
        if end::is_full(ctx) {
            break;
        }
        look(ctx, decider, &service, &mut allowance)?;
    }
    Ok(())
}

/// Looks at one service: ends what is idle, sends away who has waited too long, and gives it to whose turn it is.
fn look(ctx: &mut Context<'_>, decider: &Decider, service: &str, allowance: &mut Allowance) -> Result<(), Rejection> {
    line::looked_at(ctx, service)?;
    let target = match service::resolve(ctx, service) {
        Ok(target) => target,
        Err(gone) if matches!(gone.code, Code::UnknownRobot | Code::UnknownService) => return dissolve(ctx, service),
        Err(fault) => return Err(fault),
    };
    let (idle, unconfirmed) = (end_idle(ctx, decider, &target)?, confirm::send_away(ctx, service, false)?);
    let before = line::all(ctx, service)?;
    task_turns::due(ctx, &target)?;
    send_away(ctx, decider, &target)?;
    let again =
        if emergency::check_goes(ctx, &target).is_ok() { turns(ctx, decider, &target, allowance)? } else { None };
    let line = line::all(ctx, service)?;
    let patience = line.iter().map(|waiting| waiting.until).min();
    if let Some(next) =
        [idle, unconfirmed, again, patience, task_turns::next_due(ctx, service)].into_iter().flatten().min()
    {
        line::look_by(ctx, service, next)?;
    }
    if line == before { Ok(()) } else { tell(ctx, decider, &target) }
}

/// The service is gone: nobody waits for it any more.
fn dissolve(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let asks = confirm::send_away(ctx, service, true)?.is_some();
    let line = line::all(ctx, service)?;
    let left = line.iter().map(|waiting| (waiting, LeftReason::RobotRemoved));
    let is_left = drop_some(ctx, service, left)?;
    task_turns::dissolve(ctx, service)?;
    if is_left || asks { line::look_by(ctx, service, ctx.block_time()) } else { Ok(()) }
}

/// Ends the grants of who has published nothing for too long. Answers when the next one would be.
fn end_idle(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<Option<u64>, Rejection> {
    let Some(idle) = Terms::of(&target.service.sharing).idle_release_us else { return Ok(None) };
    let (now, mut next) = (ctx.block_time(), None);
    for holding in Contest::of(ctx, target)?.holders {
        let until = last_use(ctx, decider, target, &holding)?.saturating_add(idle);
        if until <= now && !end::is_full(ctx) {
            end::end(ctx, &holding, Reason::Idle)?;
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

/// Sends away who has waited as long as it wanted, and who the service has no room for any more.
fn send_away(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<(), Rejection> {
    let (now, most) = (ctx.block_time(), decider.rules.of(target)?.line_max(&target.service.sharing));
    let mut beside = 0;
    let mut leaving = Vec::new();
    for waiting in line::all(ctx, &target.id)? {
        if waiting.until <= now {
            leaving.push((waiting, LeftReason::TimedOut));
        } else if beside >= most && !(most == 0 && waiting.task.is_some()) {
            leaving.push((waiting, LeftReason::Rule));
        } else {
            beside += 1;
        }
    }
    let leaving = leaving.iter().map(|(waiting, reason)| (waiting, *reason));
    if drop_some(ctx, &target.id, leaving)? { line::look_by(ctx, &target.id, now) } else { Ok(()) }
}

/// Takes contenders out of the line, as many as one look may. Answers if others are left.
fn drop_some<'w>(
    ctx: &mut Context<'_>,
    service: &str,
    leaving: impl Iterator<Item = (&'w Waiting, LeftReason)>,
) -> Result<bool, Rejection> {
    for ((waiting, reason), left) in leaving.zip(0..) {
        if left >= LEAVING_MAX || end::is_full(ctx) {
            return Ok(true);
        }
        drop_out(ctx, service, &waiting.place(), reason)?;
    }
    Ok(false)
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
            Decision::Refuse if end::is_full(ctx) => return Ok(Some(ctx.block_time())),
            Decision::Refuse => drop_out(ctx, &target.id, &next.place(), LeftReason::Rule)?,
            // Whoever goes next makes room, and the service is looked at then.
            Decision::Grant { ends } if contest.holders.len() >= HOLDERS_MAX + ends.len() => return Ok(None),
            Decision::Grant { .. } if end::is_full(ctx) || !allowance.take(steps) => {
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
        return drop_out(ctx, &target.id, &place, LeftReason::Expired);
    }
    let Ok(permit) = decider::may_hold(ctx, decider, &principal, target) else {
        return drop_out(ctx, &target.id, &place, LeftReason::Policy);
    };
    let preempts = !ended.is_empty();
    for holding in ended {
        end::end_for(ctx, &holding, Reason::Preempted, &principal)?;
    }
    line::remove(ctx, &target.id, &place)?;
    let lease_ms = waiting.lease_ms.unwrap_or(target.service.lease_ms).min(target.service.lease_ms_max);
    let (priority, passed) = (waiting.priority, Passed { preempts, ..Passed::default() });
    let award = Award { principal, lease_ms, priority, permit, taken: None, passed, task: waiting.task };
    acquire::give(ctx, decider, target, award).map(drop)
}
