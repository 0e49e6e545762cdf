//! `delegate`, `handover` and `recall`: a holder passes its grant on, and takes it back.
//!
//! The old grant ends and the new one begins in one transaction, with a new epoch. At no height has the robot two holders,
//! and it need not stop between them. A grant that was delegated ends when anybody who passed it on may no longer hold it.

use super::acquire::{self, Award, Passed};
use super::describe::LEASE_MS_MIN;
use super::{contest, end, hold, queue};
use crate::arguments::{Arguments, shown};
use crate::policy::Permit;
use crate::policy::decider::{self, Decider};
use crate::records::grant::{self, Giver, Holding};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger::msp::CertifiedHolder;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Delegated, Grant, PassOptions, Reason};

/// Most who pass one grant on, one after the other.
pub(crate) const GIVERS_MAX: usize = 4;
/// Longest time for which a grant is delegated (milliseconds): a day.
const FOR_MS_MAX: u64 = 86_400_000;

/// `delegate SERVICE RECEIVER [OPTIONS_JSON]`: by the holder, who may take it back.
pub(crate) fn delegate(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("delegate SERVICE RECEIVER [OPTIONS_JSON]", args, 2, 3)?;
    let options = options(args, 2)?;
    if let Some(ms) = options.for_ms.filter(|ms| !(LEASE_MS_MIN..=FOR_MS_MAX).contains(ms)) {
        let wanted = format!("for_ms from {LEASE_MS_MIN} to {FOR_MS_MAX}");
        return Err(args.bad(2, "OPTIONS_JSON", format!("{ms} ms"), &wanted));
    }
    pass_on(ctx, decider, args, &options, false)
}

/// `handover SERVICE RECEIVER [OPTIONS_JSON]`: by the holder, for good.
pub(crate) fn handover(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("handover SERVICE RECEIVER [OPTIONS_JSON]", args, 2, 3)?;
    let options = options(args, 2)?;
    only_stop(args, 2, &options)?;
    pass_on(ctx, decider, args, &options, true)
}

/// `recall SERVICE [OPTIONS_JSON]`: by one who has passed the grant on.
pub(crate) fn recall(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("recall SERVICE [OPTIONS_JSON]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let options = options(args, 1)?;
    only_stop(args, 1, &options)?;
    let who = principal.id();
    let holders = grant::live(ctx, &target.id)?;
    let place = |holding: &Holding| holding.givers.iter().position(|giver| giver.principal.id() == who);
    let found = holders.iter().find_map(|holding| Some((holding, place(holding)?)));
    let Some((holding, place)) = found else { return Err(not_passed_on(&target, &who, &holders)) };
    check_has_none(ctx, &target, &who)?;
    let (before, after) = holding.givers.split_at(place);
    let giver = after.first().cloned().ok_or_else(|| Rejection::new(Code::Internal, "a giver has no place"))?;
    let permit = permit_of_all(ctx, decider, &target, before, &principal)?;
    let passed = Passed {
        givers: before.to_vec(),
        may_delegate: giver.may_delegate,
        ends_by: giver.ends_by,
        since: Some(holding.held_since()),
        follows: (!options.stop).then_some(holding.grant.epoch),
        preempts: false,
    };
    end::pass_on(ctx, holding, Reason::Recalled, &who, !options.stop)?;
    queue::granted(ctx, decider, &target, &who)?;
    let Giver { priority, lease_ms, .. } = giver;
    acquire::give(
        ctx,
        decider,
        &target,
        Award { principal, lease_ms, priority, permit, taken: None, passed, task: None },
    )
}

fn pass_on(
    ctx: &mut Context<'_>,
    decider: &Decider,
    args: Arguments<'_>,
    options: &PassOptions,
    for_good: bool,
) -> Result<Bytes, Rejection> {
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let to = args.text(1, "RECEIVER")?;
    let own = hold::own(ctx, &principal, &target)?;
    check_may_pass_on(&target, &own, for_good)?;
    check_receiver(ctx, &target, &own, to)?;
    let receiver = certified(ctx, to)?;
    let mut givers = own.givers.clone();
    if !for_good {
        givers.push(Giver {
            principal: own.principal.clone(),
            priority: own.priority,
            lease_ms: own.grant.lease_ms,
            ends_by: own.ends_by,
            may_delegate: own.grant.may_delegate,
        });
    }
    let permit = permit_of_all(ctx, decider, &target, &givers, &receiver)?;
    let priority = contest::priority(&target, &receiver, &permit, None)?;
    let asked = options.for_ms.map(|ms| ctx.block_time().saturating_add(ms.saturating_mul(1000)));
    let passed = Passed {
        givers,
        may_delegate: if for_good { own.grant.may_delegate } else { options.may_delegate },
        ends_by: if for_good { own.ends_by } else { asked },
        since: Some(own.held_since()),
        follows: (!options.stop).then_some(own.grant.epoch),
        preempts: false,
    };
    end::pass_on(ctx, &own, Reason::Delegated, to, !options.stop)?;
    queue::granted(ctx, decider, &target, to)?;
    let (lease_ms, ends_by) = (own.grant.lease_ms, passed.ends_by);
    let award = Award { principal: receiver, lease_ms, priority, permit, taken: None, passed, task: None };
    let granted = acquire::give(ctx, decider, &target, award)?;
    let Grant { service, holder: receiver, epoch, .. } = store::parse(b"grant", &granted)?;
    let told = store::json(&Delegated { service, giver: principal.id(), receiver, epoch, for_good, ends_by })?;
    ctx.emit("delegated", &target.id, told);
    Ok(granted)
}

fn options(args: Arguments<'_>, index: usize) -> Result<PassOptions, Rejection> {
    if !args.has(index) {
        return Ok(PassOptions::default());
    }
    serde_json::from_str(args.text(index, "OPTIONS_JSON")?).map_err(|fault| {
        args.bad(index, "OPTIONS_JSON", fault.to_string(), "JSON with some of for_ms, may_delegate and stop")
    })
}

fn only_stop(args: Arguments<'_>, index: usize, options: &PassOptions) -> Result<(), Rejection> {
    if options.for_ms.is_none() && !options.may_delegate {
        return Ok(());
    }
    Err(args.bad(index, "OPTIONS_JSON", "for_ms or may_delegate".to_owned(), "JSON with stop, or nothing"))
}

/// Does the owner allow it, and whoever gave the grant?
fn check_may_pass_on(target: &Target, own: &Holding, for_good: bool) -> Result<(), Rejection> {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let refused =
        |why: &str| Rejection::new(Code::NotDelegable, format!("the grant of {id} cannot be passed on: {why}"));
    if target.service.sharing.delegable != Some(true) {
        return Err(refused("its owner does not allow it")
            .found("delegable=false")
            .wanted("delegable=true")
            .next(format!("ask an admin of {owner}: ledgerctl robot set {id} delegable=true; or release it")));
    }
    if own.grant.taken.is_some() {
        return Err(refused("it was taken whatever the rule says")
            .found("a grant by take")
            .wanted("a grant by acquire")
            .next(format!("release it; the next one acquires it: ledgerctl release {id}")));
    }
    if let Some(task) = own.grant.task {
        return Err(refused("it serves a task")
            .found(format!("task {task}"))
            .wanted("a grant by acquire")
            .next(format!("end the task first: ledgerctl task cancel {task}")));
    }
    let Some(giver) = own.givers.last().map(|giver| giver.principal.id()) else { return Ok(()) };
    if !own.grant.may_delegate {
        return Err(refused("its giver does not allow it")
            .found(format!("delegated by {giver}"))
            .wanted("a delegation with may_delegate")
            .next(format!("ask {giver} to delegate it with --may-delegate")));
    }
    if own.givers.len() >= GIVERS_MAX && !for_good {
        return Err(refused("it was passed on too often")
            .found(format!("{GIVERS_MAX} who passed it on"))
            .wanted(format!("fewer than {GIVERS_MAX}"))
            .next(format!("hand it over for good: ledgerctl handover {id} --to ORGANISATION/NAME")));
    }
    Ok(())
}

/// Is it somebody else, and not one of those who passed it on?
fn check_receiver(ctx: &Context<'_>, target: &Target, own: &Holding, to: &str) -> Result<(), Rejection> {
    let id = &target.id;
    let refused =
        |why: String| Rejection::new(Code::BadArgument, format!("{id} cannot be passed to {}: {why}", shown(to)));
    if own.grant.holder == to {
        return Err(refused("it is the holder itself".to_owned())
            .found(to)
            .wanted("somebody else")
            .next(format!("to keep it longer: ledgerctl acquire {id}")));
    }
    if own.givers.iter().any(|giver| giver.principal.id() == to) {
        return Err(refused("it would come back to one who passed it on".to_owned())
            .found(format!("passed on by {}", own.grant.givers.join(", then ")))
            .wanted("somebody who has not passed it on")
            .next(format!("{to} takes it back: ledgerctl recall {id}; or release it")));
    }
    check_has_none(ctx, target, to)
}

/// Refuses a second grant of the service for the same holder, as there may be where several hold it.
fn check_has_none(ctx: &Context<'_>, target: &Target, to: &str) -> Result<(), Rejection> {
    let id = &target.id;
    if grant::held_by(ctx, id, to)?.is_none() {
        return Ok(());
    }
    Err(Rejection::new(Code::BadArgument, format!("{id} cannot be passed to {}: it holds it already", shown(to)))
        .found("a grant of its own")
        .wanted("somebody without one")
        .next(format!("one of the two is released first: ledgerctl release {id}")))
}

/// The person behind a name, by its certificate on the ledger.
pub(super) fn certified(ctx: &mut Context<'_>, id: &str) -> Result<Principal, Rejection> {
    let answer = ctx.call("msp", "holder", &[Bytes::copy_from_slice(id.as_bytes())])?;
    let holder: CertifiedHolder = store::parse(b"msp holder", &answer)?;
    let CertifiedHolder { organisation, name, role, attributes, issuer, serial, fingerprint, not_after } = holder;
    Ok(Principal { organisation, name, role, attributes, issuer, serial, fingerprint, not_after })
}

/// The limits of the receiver, if policies permit it and everybody who passes it on to hold the service.
fn permit_of_all(
    ctx: &Context<'_>,
    decider: &Decider,
    target: &Target,
    givers: &[Giver],
    receiver: &Principal,
) -> Result<Permit, Rejection> {
    super::emergency::check_goes(ctx, target)?;
    decider::may_hold_after(ctx, decider, givers.iter().map(|giver| &giver.principal), receiver, target)
}

fn not_passed_on(target: &Target, who: &str, holders: &[Holding]) -> Rejection {
    let found = match holders {
        [own] if own.grant.holder == who => format!("held by {who}, until {}", hold::until(&own.grant)),
        _ => hold::holders_of(who, holders),
    };
    Rejection::new(Code::NotHolder, format!("{who} has passed on no grant of {} that is left", target.id))
        .found(found)
        .wanted("a grant that it delegated")
        .next(format!("to get it: ledgerctl acquire {}", target.id))
}
