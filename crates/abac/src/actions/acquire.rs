//! `acquire`: who gets a grant.

use super::describe::LEASE_MS_MIN;
use super::hold::until;
use super::{end, publish, renew};
use crate::arguments::Arguments;
use crate::policy::decider::{self, Decider};
use crate::records::grant::{self, HOLDERS_MAX, Holding};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::store;
use crate::rules::{self, Decision};
use bytes::Bytes;
use ledger::Context;
use ledger_contract::{Grant, Reason};
use ledger_mutation::{Mutation, active};
use ledger_rejection::{Code, Rejection};

/// The position of a contender that has no grant.
pub(crate) enum Room {
    /// The contender has a grant already.
    Own(Box<Holding>),
    /// These grants, which end for it.
    After(Vec<Holding>),
}

/// `acquire SERVICE [LEASE_MS]`
pub(crate) fn acquire(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("acquire SERVICE [LEASE_MS]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let lease_ms = lease(&target, args)?;
    let ending = match may_acquire(ctx, decider, &principal, &target)? {
        Room::Own(own) if own.principal.same_certificate(&principal) => {
            return renew::renewed(ctx, &target, *own, lease_ms);
        }
        // Another certificate of the same person: whoever holds the old one must be fenced off.
        Room::Own(own) => vec![(*own, Reason::Released)],
        Room::After(ended) => ended.into_iter().map(|holding| (holding, Reason::Taken)).collect(),
    };
    for (holding, reason) in ending {
        end::end(ctx, &holding, reason)?;
    }
    let now = ctx.block_time();
    for dead in grant::stored(ctx, &target.id)?.iter().filter(|holding| !holding.is_live(now)) {
        end::end(ctx, dead, dead.reason())?;
    }
    give(ctx, &target, principal, lease_ms.unwrap_or(target.service.lease_ms))
}

/// Algorithm 1 of the paper: may this principal have a grant now, by the policies and beside those who hold one?
///
/// # Errors
/// The answer of the policies, [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn may_acquire(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Room, Rejection> {
    decider::may_hold(ctx, decider, principal, target)?;
    let (own, others): (Vec<_>, Vec<_>) =
        grant::live(ctx, &target.id)?.into_iter().partition(|holding| holding.grant.holder == principal.id());
    if let Some(own) = own.into_iter().next() {
        return Ok(Room::Own(Box::new(own)));
    }
    let grants: Vec<&Grant> = others.iter().map(|holding| &holding.grant).collect();
    match rules::rule(target)?.decide(principal, &grants) {
        Decision::Wait(grant) => Err(held(target, grant)),
        Decision::Grant { ends } => {
            let ended: Vec<Holding> = others.iter().filter(|other| ends.contains(&&other.grant)).cloned().collect();
            match others.len() - ended.len() {
                beside if beside >= HOLDERS_MAX => Err(full(target, beside)),
                _ => Ok(Room::After(ended)),
            }
        }
    }
}

fn give(ctx: &mut Context<'_>, target: &Target, principal: Principal, lease_ms: u64) -> Result<Bytes, Rejection> {
    let newest = grant::newest_epoch(ctx, &target.id)?;
    let epoch = newest
        .checked_add(u64::from(newest == 0 || !active(Mutation::ReuseAnEpoch)))
        .ok_or_else(|| Rejection::new(Code::LimitExceeded, format!("{} has used up its epochs", target.id)))?;
    store::write(ctx, &store::epoch_key(&target.id), &epoch)?;
    let mut holding = Holding {
        grant: Grant {
            service: target.id.clone(),
            holder: principal.id(),
            epoch,
            expires: 0,
            mode: target.service.mode.into(),
            acquired_at: ctx.block_time(),
            lease_ms,
            next_seq: publish::next_sequence(ctx, target, epoch, &principal.id())?,
        },
        principal,
        ending: None,
    };
    holding.extend(ctx.block_time());
    grant::put(ctx, &holding)?;
    let granted = store::json(&holding.grant)?;
    ctx.emit("granted", &target.id, granted.clone());
    Ok(granted)
}

/// The lease that the caller asks for, if any.
pub(crate) fn lease(target: &Target, args: Arguments<'_>) -> Result<Option<u64>, Rejection> {
    if !args.has(1) {
        return Ok(None);
    }
    let lease_ms = args.number(1, "LEASE_MS")?;
    let max = target.service.lease_ms_max;
    if (LEASE_MS_MIN..=max).contains(&lease_ms) {
        return Ok(Some(lease_ms));
    }
    Err(args.bad(1, "LEASE_MS", format!("{lease_ms} ms"), &format!("{LEASE_MS_MIN} to {max} ms for {}", target.id)))
}

fn held(target: &Target, grant: &Grant) -> Rejection {
    let (id, holder) = (&target.id, &grant.holder);
    Rejection::new(Code::Held, format!("{id} is held by {holder} until {}", until(grant)))
        .found(format!("{} service, held by {holder} with epoch {}", target.service.mode, grant.epoch))
        .wanted("no other holder")
        .next(format!(
            "acquire it after that time, ask {holder} to release it, or ask an admin of {} to take it back",
            target.robot.organisation
        ))
}

fn full(target: &Target, holders: usize) -> Rejection {
    Rejection::new(Code::LimitExceeded, format!("{} has no room for another holder", target.id))
        .found(format!("{holders} holders"))
        .wanted(format!("at most {HOLDERS_MAX}"))
}
