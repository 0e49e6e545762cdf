//! Confirmation: before a contender competes for a service, others must agree, as many as its owner says.
//!
//! A contender that waits to be confirmed holds no place, and takes none from anybody: it competes when the last one has
//! confirmed it. It never counts for itself.

use super::acquire::{self, Room};
use super::end;
use super::queue::WAITS_MAX;
use crate::arguments::{Arguments, shown};
use crate::policy::decider::{self, Decider};
use crate::records::pending::{self, Asking};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::{line, store};
use crate::rules::terms::Terms;
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Acquired, Confirmation, Left, LeftReason, Pending};

/// Most contenders that wait to be confirmed for one service.
pub(crate) const PENDING_MAX: usize = 64;

/// Must others confirm this contender first? Answers how it waits for that then. One that is in line was confirmed.
pub(crate) fn first(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    options: &AcquireOptions,
) -> Result<Option<Pending>, Rejection> {
    let Some(wanted) = target.service.sharing.confirm else { return Ok(None) };
    let contender = principal.id();
    if line::of(ctx, &target.id, &contender)?.is_some() {
        return Ok(None);
    }
    let known = pending::of(ctx, &target.id, &contender)?.filter(|known| known.principal.same_certificate(principal));
    let now = ctx.block_time();
    if let Some(known) = known.as_ref().filter(|known| known.until > now) {
        let is_confirmed = agreed(ctx, decider, target, known) >= wanted;
        return Ok((!is_confirmed).then(|| told(target, known, wanted)));
    }
    check_room(ctx, target, principal)?;
    let until = now.saturating_add(Terms::of(&target.service.sharing).confirm_within_us).min(principal.not_after);
    let asking = Asking { principal: principal.clone(), until, options: options.clone(), confirmed: Vec::new() };
    pending::put(ctx, &target.id, &asking)?;
    line::look_by(ctx, &target.id, until)?;
    let told = told(target, &asking, wanted);
    ctx.emit("pending", &target.id, store::json(&told)?);
    Ok(Some(told))
}

/// `confirm SERVICE CONTENDER`: by an admin of the owner, or whom policies permit `confirm`.
pub(crate) fn confirm(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("confirm SERVICE CONTENDER", args, 2, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let contender = args.text(1, "CONTENDER")?;
    let asking = pending::of(ctx, &target.id, contender)?.filter(|asking| asking.until > ctx.block_time());
    let Some(mut asking) = asking else { return Err(nothing_to_confirm(ctx, &target, contender)?) };
    if contender == principal.id() && !active(Mutation::CountTheRequester) {
        return Err(Rejection::new(Code::BadArgument, format!("{contender} cannot confirm itself"))
            .found("the contender")
            .wanted("somebody else")
            .next(format!("ask {}", who_may(&target))));
    }
    decider::may_confirm(ctx, decider, &principal, &target)?;
    let wanted = target.service.sharing.confirm.unwrap_or(0);
    asking.confirmed.retain(|confirmed| confirmed.id() != principal.id());
    asking.confirmed.push(principal);
    pending::put(ctx, &target.id, &asking)?;
    let pending = told(&target, &asking, wanted);
    ctx.emit("confirmed", &target.id, store::json(&pending)?);
    let (acquired, refused) = if agreed(ctx, decider, &target, &asking) < wanted {
        (None, String::new())
    } else {
        compete(ctx, decider, &target, asking)?
    };
    store::json(&Confirmation { pending, acquired, refused })
}

/// How many have confirmed it who still may.
fn agreed(ctx: &Context<'_>, decider: &Decider, target: &Target, asking: &Asking) -> u64 {
    let may = |principal: &&Principal| decider::may_confirm(ctx, decider, principal, target).is_ok();
    asking.counted(ctx.block_time()).filter(may).count() as u64
}

/// The contender competes for the service, or hears why it cannot have it now.
fn compete(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    asking: Asking,
) -> Result<(Option<Acquired>, String), Rejection> {
    let Asking { principal, options, .. } = asking;
    match acquire::may_acquire(ctx, decider, &principal, target, options.priority) {
        Ok((room, permit)) => {
            let waits = matches!(room, Room::InLine { .. });
            match acquire::settle(ctx, decider, target, principal, &options, room, permit) {
                Ok(acquired) => Ok((Some(store::parse(b"acquired", &acquired)?), String::new())),
                // The line refuses before anything is written.
                Err(refused) if waits => told_or_fault(refused),
                Err(fault) => Err(fault),
            }
        }
        Err(refused) => told_or_fault(refused),
    }
}

/// Why the contender cannot have it now, unless the state is at fault.
fn told_or_fault(refused: Rejection) -> Result<(Option<Acquired>, String), Rejection> {
    if matches!(refused.code, Code::Corrupt | Code::Internal) { Err(refused) } else { Ok((None, refused.message)) }
}

/// Forgets those whose time is over, and all if the service is gone. Answers when to look again.
pub(crate) fn send_away(ctx: &mut Context<'_>, service: &str, gone: bool) -> Result<Option<u64>, Rejection> {
    let (now, mut next) = (ctx.block_time(), None);
    for asking in pending::all(ctx, service)? {
        if !gone && asking.until > now || end::is_full(ctx) {
            next = Some(next.map_or(asking.until, |next: u64| next.min(asking.until)));
            continue;
        }
        drop_out(ctx, service, &asking, if gone { LeftReason::RobotRemoved } else { LeftReason::Unconfirmed })?;
    }
    Ok(next)
}

/// A certificate was revoked: it contends no more, and its confirmations do not count.
pub(crate) fn revoked(ctx: &mut Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Result<(), Rejection> {
    let serial_text = hex::encode(serial);
    let is_revoked = |principal: &Principal| principal.issuer.0 == *issuer && principal.serial == serial_text;
    for (service, contender) in pending::of_certificate(ctx, issuer, serial) {
        let Some(mut asking) = pending::of(ctx, &service, &contender)? else { continue };
        if is_revoked(&asking.principal) {
            drop_out(ctx, &service, &asking, LeftReason::Revoked)?;
        } else {
            let before = asking.clone();
            asking.confirmed.retain(|confirmed| !is_revoked(confirmed));
            pending::remove(ctx, &service, &before.principal.id())?;
            pending::put(ctx, &service, &asking)?;
        }
    }
    Ok(())
}

/// An organisation left: its members contend no more for this service, and confirm nobody.
pub(crate) fn members_left(ctx: &mut Context<'_>, service: &str, organisation: &str) -> Result<(), Rejection> {
    for mut asking in pending::all(ctx, service)? {
        if asking.principal.organisation == organisation {
            drop_out(ctx, service, &asking, LeftReason::Revoked)?;
        } else if asking.confirmed.iter().any(|confirmed| confirmed.organisation == organisation) {
            pending::remove(ctx, service, &asking.principal.id())?;
            asking.confirmed.retain(|confirmed| confirmed.organisation != organisation);
            pending::put(ctx, service, &asking)?;
        }
    }
    Ok(())
}

/// The contender takes back that it asked. Answers if it had.
pub(crate) fn withdraw(
    ctx: &mut Context<'_>,
    service: &str,
    contender: &str,
    reason: LeftReason,
) -> Result<bool, Rejection> {
    let Some(asking) = pending::of(ctx, service, contender)? else { return Ok(false) };
    drop_out(ctx, service, &asking, reason)?;
    Ok(true)
}

fn drop_out(ctx: &mut Context<'_>, service: &str, asking: &Asking, reason: LeftReason) -> Result<(), Rejection> {
    let contender = asking.principal.id();
    pending::remove(ctx, service, &contender)?;
    let left = Left { service: service.to_owned(), contender, reason: reason.into() };
    ctx.emit("left", service, store::json(&left)?);
    Ok(())
}

/// A contender that waits to be confirmed, as everybody may see it.
pub(crate) fn told(target: &Target, asking: &Asking, wanted: u64) -> Pending {
    Pending {
        service: target.id.clone(),
        contender: asking.principal.id(),
        confirmed: asking.confirmed.iter().map(Principal::id).collect(),
        wanted,
        owner: target.robot.organisation.clone(),
        until: asking.until,
    }
}

fn check_room(ctx: &Context<'_>, target: &Target, principal: &Principal) -> Result<(), Rejection> {
    let id = &target.id;
    let others = pending::all(ctx, id)?.len();
    if others >= PENDING_MAX {
        return Err(Rejection::new(Code::LineFull, format!("too many wait to be confirmed for {id}"))
            .found(format!("{others} who wait"))
            .wanted(format!("fewer than {PENDING_MAX}"))
            .next(format!("try again later; to see them: ledgerctl queue {id}")));
    }
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    let asks = pending::of_certificate(ctx, &principal.issuer.0, &serial).len();
    if asks >= WAITS_MAX {
        return Err(Rejection::new(
            Code::LimitExceeded,
            format!("{} waits for too many confirmations", principal.id()),
        )
        .found(format!("{asks} services"))
        .wanted(format!("fewer than {WAITS_MAX}"))
        .next("take one back first: ledgerctl release ROBOT/TOPIC"));
    }
    Ok(())
}

fn who_may(target: &Target) -> String {
    let owner = &target.robot.organisation;
    format!("an admin of {owner}, or somebody whom its policies permit the action confirm")
}

fn nothing_to_confirm(ctx: &Context<'_>, target: &Target, contender: &str) -> Result<Rejection, Rejection> {
    let waiting: Vec<String> = pending::all(ctx, &target.id)?.iter().map(|asking| asking.principal.id()).collect();
    let found = if waiting.is_empty() { "nobody waits to be confirmed".to_owned() } else { waiting.join(", ") };
    let message = format!("{} does not wait to be confirmed for {}", shown(contender), target.id);
    Ok(Rejection::new(Code::NotFound, message)
        .found(found)
        .wanted("somebody who waits to be confirmed")
        .next(format!("it asks with: ledgerctl acquire {}", target.id)))
}
