//! Confirmation: before a contender competes for a service, others must agree, as many as its owner says.
//!
//! A contender that waits to be confirmed holds no place, and takes none from others: it competes when the last one has
//! confirmed it. It never counts for itself.

use crate::lifecycle::capacity;
use crate::lifecycle::queue::WAITS_MAX;
use crate::policy::decider;
use crate::policy::decider::Decider;
use crate::records::pending::Asking;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{line, pending, store};
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Left, LeftReason, Pending};

/// Most contenders that wait to be confirmed for one service.
const PENDING_MAX: usize = 64;

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

/// How many have confirmed it who still may.
pub(crate) fn agreed(ctx: &Context<'_>, decider: &Decider, target: &Target, asking: &Asking) -> u64 {
    let may = |principal: &&Principal| decider::may_confirm(ctx, decider, principal, target).is_ok();
    asking.counted(ctx.block_time()).filter(may).count() as u64
}

/// Forgets those whose time is over, and all if the service is gone. Answers when to look again.
pub(crate) fn send_away(ctx: &mut Context<'_>, service: &str, gone: bool) -> Result<Option<u64>, Rejection> {
    let (now, mut next) = (ctx.block_time(), None);
    for asking in pending::all(ctx, service)? {
        if !gone && asking.until > now || capacity::is_full(ctx) {
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
        return Err(Rejection::new(Code::LineFull, format!("too many contenders wait for confirmation for {id}"))
            .found(format!("{others} contenders"))
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
        .next("withdraw one first: ledgerctl release ROBOT/TOPIC"));
    }
    Ok(())
}
