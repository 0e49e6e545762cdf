//! How rights end without a call of their holder: expiry, revocation, a change of policy or of the robot.
//!
//! A right that ends at a height has no effect after it. But a block may report a bounded number of events. When very
//! many grants end at once, those beyond the bound are marked as ended, which no check overlooks. They are due at once;
//! the following blocks sweep them up and report why they ended.

use super::follow_up::{Ending, FollowUp};
use super::settle::settle;
use crate::lifecycle::capacity::ENDINGS_MAX;
use crate::lifecycle::{capacity, contest, departures, looks, robots, undecided};
use crate::policy::decider::Decider;
use crate::policy::{decider, texts};
use crate::records::grant::Holding;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{grant, policy_set, proposed, reader, robot, side_door, store};
use crate::rules::{Claim, Decision, Situation};
use ledger::{Context, Revocation};
use ledger_base::rejection::Rejection;
use ledger_contract::{Reason, Released};

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
        if expires > now || capacity::is_full(ctx) {
            break;
        }
        match store::read::<Holding>(ctx, &store::grant_key(service, holder))? {
            Some(holding) if holding.grant.expires == expires => {
                settle(ctx, [Ending::of(&holding, holding.reason())])?;
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
    [next_due(ctx), looks::next_look(ctx)].into_iter().flatten().min()
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
            ending.push(Ending::of_many(holding, Reason::Revoked));
        }
    }
    settle(ctx, ending)?;
    proposed::revoked(ctx, &revoked.issuer, &revoked.serial)?;
    reader::note_revocation(ctx)?;
    reader::revoked(ctx, &revoked.issuer, &revoked.serial)?;
    departures::revoked(ctx, decider, &revoked.issuer, &revoked.serial)
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
            departures::members_left(ctx, decider, &target, organisation)?;
            let live = grant::live(ctx, &target.id)?.into_iter();
            let theirs =
                live.filter(|holding| holding.principals().any(|principal| principal.organisation == organisation));
            ending.extend(theirs.map(|holding| Ending::of_many(holding, Reason::Revoked)));
        }
    }
    settle(ctx, ending).map(drop)
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
                looks::settings_changed(ctx, &kept)?;
            }
            None => {
                looks::look_now(ctx, &id)?;
                let gone = grant::live(ctx, &id)?;
                ending.extend(gone.into_iter().map(|holding| Ending::of_many(holding, Reason::RobotRemoved)));
            }
        }
    }
    side_door::forget(ctx, before, Some(after));
    reader::forget(ctx, before, Some(after))?;
    let mut released = settle(ctx, ending)?;
    if later {
        undecided::mark(ctx, &after.organisation, &after.name);
        released.extend(undecided::begin(ctx, decider, &after.organisation)?);
    }
    Ok(released)
}

/// The live grants of a service that policies deny now, or that its rule has no room for: the oldest stay. Those that stay
/// are renewed by no more than the service now allows. Policies are asked now, or later.
fn unfit(ctx: &mut Context<'_>, decider: &Decider, ask: bool, target: &Target) -> Result<Vec<FollowUp>, Rejection> {
    let rule = decider.rules.of(target)?;
    let mut stay: Vec<Claim> = Vec::new();
    let mut ending = Vec::new();
    for holding in grant::live(ctx, &target.id)? {
        let claim = contest::claim_of_holder(&holding);
        let beside = Situation { sharing: &target.service.sharing, holders: &stay, line: &[], now: ctx.block_time() };
        let has_room = matches!(rule.decide(&claim, &beside), Decision::Grant { ends } if ends.is_empty());
        let permit = if ask { decider::may_keep(ctx, decider, &holding, target).map(Some) } else { Ok(None) };
        let Ok(permit) = permit else {
            ending.push(Ending::of_many(holding, Reason::Policy));
            continue;
        };
        if !has_room {
            ending.push(Ending::of_many(holding, Reason::Taken));
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
