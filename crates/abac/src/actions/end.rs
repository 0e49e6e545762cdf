//! How grants end: expiry, revocation, a change of policy or of the robot, and whatever the other actions end.
//!
//! A right that ends at a height has no effect after it. But a block may tell of a bounded number of events. When very
//! many grants end at once, those beyond the bound are marked as ended, which no check overlooks. They are due at once;
//! the following blocks sweep them up and tell why they ended.

use super::{contest, queue, robots, task_turns, undecided};
use crate::policy::decider::{self, Decider};
use crate::policy::texts;
use crate::records::grant::{self, Holding};
use crate::records::principal::Principal;
use crate::records::robot::{self, Robot};
use crate::records::service::Target;
use crate::records::{policy_set, proposed, reader, side_door, store, used};
use crate::rules::{Claim, Decision, Situation};
use ledger::{Context, Revocation};
use ledger_base::rejection::Rejection;
use ledger_contract::{Grant, Reason, Released, read_from};

/// Most grants that one call or the start of one block ends with an event each.
const ENDINGS_MAX: usize = 256;

/// Events that the end of one right, or one turn, may take.
const EVENTS_OF_ONE: usize = 64;

/// Is there no room for the events of one more end or turn? The rest is done by the following blocks.
pub(crate) fn is_full(ctx: &Context<'_>) -> bool {
    ctx.events_left() < EVENTS_OF_ONE
}

/// Removes a grant, and tells the world why.
pub(crate) fn end(ctx: &mut Context<'_>, holding: &Holding, reason: Reason) -> Result<Released, Rejection> {
    tell(ctx, holding, reason, None, false)
}

/// Removes a grant because another one follows it in this block; the robot goes on between them, or stops.
pub(crate) fn pass_on(
    ctx: &mut Context<'_>,
    holding: &Holding,
    reason: Reason,
    to: &str,
    goes_on: bool,
) -> Result<Released, Rejection> {
    tell(ctx, holding, reason, Some(to.to_owned()), goes_on)
}

/// Removes a grant because somebody takes its place.
pub(crate) fn end_for(
    ctx: &mut Context<'_>,
    holding: &Holding,
    reason: Reason,
    by: &Principal,
) -> Result<Released, Rejection> {
    let by = matches!(reason, Reason::Preempted | Reason::Overridden).then(|| by.id());
    tell(ctx, holding, reason, by, false)
}

fn tell(
    ctx: &mut Context<'_>,
    holding: &Holding,
    reason: Reason,
    by: Option<String>,
    goes_on: bool,
) -> Result<Released, Rejection> {
    grant::remove(ctx, holding);
    if holding.counted {
        let Grant { service, holder, acquired_at, expires, .. } = &holding.grant;
        used::add(ctx, service, holder, (*acquired_at, ctx.block_time().min(*expires)))?;
    }
    let Grant { service, holder, epoch, .. } = holding.grant.clone();
    queue::look_now(ctx, &service)?;
    if let Some(read) = read_from(&service) {
        reader::place_ended(ctx, read, reason)?;
    }
    let released = Released { service, holder, epoch, reason: reason.into(), by, goes_on };
    ctx.emit("released", &released.service, store::json(&released)?);
    if let Some(id) = holding.grant.task {
        task_turns::grant_ended(ctx, id, reason)?;
    }
    Ok(released)
}

/// Ends grants now; returns those whose event was emitted now.
pub(crate) fn end_all(ctx: &mut Context<'_>, ending: Vec<(Holding, Reason)>) -> Result<Vec<Released>, Rejection> {
    let mut released = Vec::new();
    for (holding, reason) in ending {
        if released.len() < ENDINGS_MAX && !is_full(ctx) {
            released.push(end(ctx, &holding, reason)?);
        } else {
            let mut marked = holding.clone();
            marked.ending = Some(reason);
            marked.grant.expires = ctx.block_time().min(holding.grant.expires);
            grant::replace(ctx, &holding, &marked)?;
        }
    }
    Ok(released)
}

/// Ends what is due at the start of a block.
pub(crate) fn sweep(ctx: &mut Context<'_>, decider: &Decider) -> Result<(), Rejection> {
    if undecided::is_left(ctx) {
        undecided::go_on(ctx, decider)?;
    }
    let now = ctx.block_time();
    // Mostly nothing is due. One look is cheaper than reading everything that could be.
    if next_due(ctx).is_some_and(|due| due > now) {
        return Ok(());
    }
    for (key, _) in ctx.range(b"due/", ENDINGS_MAX) {
        let Some((expires, service, holder)) = store::parse_due_key(&key) else {
            ctx.delete(&key);
            continue;
        };
        if expires > now || is_full(ctx) {
            break;
        }
        match store::read::<Holding>(ctx, &store::grant_key(service, holder))? {
            Some(holding) if holding.grant.expires == expires => {
                end(ctx, &holding, holding.reason())?;
            }
            _ => ctx.delete(&key),
        }
    }
    Ok(())
}

/// When there is something to end or to decide (block time, microseconds).
pub(crate) fn next_deadline(ctx: &Context<'_>) -> Option<u64> {
    if undecided::is_left(ctx) {
        return Some(0);
    }
    [next_due(ctx), queue::next_look(ctx)].into_iter().flatten().min()
}

/// When the next grant is due (block time, microseconds).
fn next_due(ctx: &Context<'_>) -> Option<u64> {
    let due = ctx.range(b"due/", 1);
    let (key, _) = due.first()?;
    store::parse_due_key(key).map(|(expires, ..)| expires)
}

/// Ends the grants of a certificate that was revoked.
pub(crate) fn identity_revoked(
    ctx: &mut Context<'_>,
    decider: &Decider,
    revoked: &Revocation,
) -> Result<(), Rejection> {
    let prefix = store::certificate_prefix(&revoked.issuer, &revoked.serial);
    let mut ending = Vec::new();
    for (key, _) in ctx.range(&prefix, usize::MAX) {
        if let Some((service, holder)) = store::parse_certificate_key(&key, &prefix)
            && let Some(holding) = store::read::<Holding>(ctx, &store::grant_key(service, holder))?
            && holding.ending.is_none()
        {
            ending.push((holding, Reason::Revoked));
        }
    }
    end_all(ctx, ending)?;
    proposed::revoked(ctx, &revoked.issuer, &revoked.serial)?;
    reader::note_revocation(ctx)?;
    reader::revoked(ctx, &revoked.issuer, &revoked.serial)?;
    queue::revoked(ctx, decider, &revoked.issuer, &revoked.serial)
}

/// Ends the rights of all whom an authority has certified.
pub(crate) fn authority_lost(ctx: &mut Context<'_>, decider: &Decider, issuer: &[u8; 32]) -> Result<(), Rejection> {
    reader::note_revocation(ctx)?;
    for serial in store::serials(ctx, issuer) {
        identity_revoked(ctx, decider, &Revocation { issuer: *issuer, serial })?;
    }
    Ok(())
}

/// Ends the grants of an organisation's members, and takes its robots out of service: nobody can govern them any more.
pub(crate) fn organisation_removed(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
) -> Result<(), Rejection> {
    reader::note_revocation(ctx)?;
    policy_set::forget_all(ctx, organisation)?;
    texts::forget(ctx, organisation)?;
    let (mut ending, mut told) = (Vec::new(), 0);
    for robot in robot::all(ctx)? {
        if robot.organisation == organisation {
            ending.extend(robots::take_out(ctx, &robot)?);
            if told < ENDINGS_MAX {
                robots::tell(ctx, &robot, "removed")?;
                told += 1;
            }
            continue;
        }
        for service in &robot.services {
            reader::members_left(ctx, &robot.service_id(service), organisation)?;
        }
        for target in Target::all_of(&robot) {
            queue::members_left(ctx, decider, &target, organisation)?;
            let live = grant::live(ctx, &target.id)?.into_iter();
            let theirs =
                live.filter(|holding| holding.principals().any(|principal| principal.organisation == organisation));
            ending.extend(theirs.map(|holding| (holding, Reason::Revoked)));
        }
    }
    end_all(ctx, ending).map(drop)
}

/// Ends the grants that an organisation's policies no longer permit, on all its robots.
pub(crate) fn policies_changed(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
) -> Result<Vec<Released>, Rejection> {
    for name in robot::names_of(ctx, organisation) {
        undecided::mark(ctx, organisation, &name);
    }
    undecided::begin(ctx, decider, organisation)
}

/// Ends the grants that a changed robot no longer offers, permits or has room for.
pub(crate) fn robot_changed(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: &Robot,
    after: &Robot,
) -> Result<Vec<Released>, Rejection> {
    let mut ending = Vec::new();
    let later = undecided::are_many(ctx, after)?;
    for Target { id, .. } in Target::all_of(before) {
        match Target::all_of(after).find(|kept| kept.id == id) {
            Some(kept) => {
                ending.extend(unfit(ctx, decider, !later, &kept)?);
                queue::settings_changed(ctx, &kept)?;
            }
            None => {
                queue::look_now(ctx, &id)?;
                let gone = grant::live(ctx, &id)?;
                ending.extend(gone.into_iter().map(|holding| (holding, Reason::RobotRemoved)));
            }
        }
    }
    side_door::forget(ctx, before, Some(after));
    reader::forget(ctx, before, Some(after))?;
    let mut released = end_all(ctx, ending)?;
    if later {
        undecided::mark(ctx, &after.organisation, &after.name);
        released.extend(undecided::begin(ctx, decider, &after.organisation)?);
    }
    Ok(released)
}

/// The live grants of a service that policies deny now, or that its rule has no room for: the oldest stay. Those that stay
/// are renewed by no more than the service now allows. Policies are asked now, or later.
fn unfit(
    ctx: &mut Context<'_>,
    decider: &Decider,
    ask: bool,
    target: &Target,
) -> Result<Vec<(Holding, Reason)>, Rejection> {
    let rule = decider.rules.of(target)?;
    let mut stay: Vec<Claim> = Vec::new();
    let mut ending = Vec::new();
    for holding in grant::live(ctx, &target.id)? {
        let claim = contest::claim_of_holder(&holding);
        let beside = Situation { sharing: &target.service.sharing, holders: &stay, line: &[], now: ctx.block_time() };
        let has_room = matches!(rule.decide(&claim, &beside), Decision::Grant { ends } if ends.is_empty());
        let permit = if ask { decider::may_keep(ctx, decider, &holding, target).map(Some) } else { Ok(None) };
        let Ok(permit) = permit else {
            ending.push((holding, Reason::Policy));
            continue;
        };
        if !has_room {
            ending.push((holding, Reason::Taken));
        } else {
            let mut changed = holding.clone();
            if let Some(permit) = permit {
                changed.bind(&target.service, &permit.limits, permit.closes);
            }
            changed.grant.mode = target.service.mode.clone();
            changed.grant.lease_ms = holding.grant.lease_ms.min(target.service.lease_ms_max);
            if changed != holding {
                grant::replace(ctx, &holding, &changed)?;
            }
            stay.push(claim);
        }
    }
    Ok(ending)
}
