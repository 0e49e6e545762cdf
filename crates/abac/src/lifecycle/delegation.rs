//! Passing a grant on. The old grant ends and the new one begins in one transaction, with a new epoch.
//!
//! At no height has the robot two holders, and it need not stop between them. A grant that was delegated ends when one of those who
//! passed it on may no longer hold it.

use super::follow_up::Ending;
use super::settle::settle;
use crate::arguments::{Arguments, shown};
use crate::lifecycle::acquisition;
use crate::lifecycle::grants::{GrantTerms, Inheritance};
use crate::lifecycle::{contest, holders, people, queue, stops};
use crate::policy::decider::Decider;
use crate::policy::{Permit, decider};
use crate::records::grant::{Giver, Holding};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Delegated, Grant, PassOptions, Reason};

/// Most who pass one grant on, one after the other.
const GIVERS_MAX: usize = 4;

pub(crate) fn pass_on(
    ctx: &mut Context<'_>,
    decider: &Decider,
    args: Arguments<'_>,
    options: &PassOptions,
    for_good: bool,
) -> Result<Bytes, Rejection> {
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let to = args.text(1, "RECEIVER")?;
    let own = holders::own(ctx, &principal, &target)?;
    check_may_pass_on(&target, &own, for_good)?;
    check_receiver(ctx, &target, &own, to)?;
    let receiver = people::certified(ctx, to)?;
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
    let inherited = Inheritance {
        givers,
        may_delegate: if for_good { own.grant.may_delegate } else { options.may_delegate },
        ends_by: if for_good { own.ends_by } else { asked },
        since: Some(own.held_since()),
        follows: (!options.stop).then_some(own.grant.epoch),
        preempts: false,
    };
    settle(ctx, [Ending::passed_on(&own, Reason::Delegated, to, !options.stop)])?;
    queue::granted(ctx, decider, &target, to)?;
    let (lease_ms, ends_by) = (own.grant.lease_ms, inherited.ends_by);
    let terms = GrantTerms { principal: receiver, lease_ms, priority, permit, taken: None, inherited, task: None };
    let granted = acquisition::give(ctx, decider, &target, terms)?;
    let Grant { service, holder: receiver, epoch, .. } = store::parse(b"grant", &granted)?;
    let told = store::json(&Delegated { service, giver: principal.id(), receiver, epoch, for_good, ends_by })?;
    ctx.emit("delegated", &target.id, told);
    Ok(granted)
}

pub(crate) fn options(args: Arguments<'_>, index: usize) -> Result<PassOptions, Rejection> {
    if !args.has(index) {
        return Ok(PassOptions::default());
    }
    serde_json::from_str(args.text(index, "OPTIONS_JSON")?).map_err(|fault| {
        args.bad(index, "OPTIONS_JSON", fault.to_string(), "JSON with some of for_ms, may_delegate and stop")
    })
}

pub(crate) fn only_stop(args: Arguments<'_>, index: usize, options: &PassOptions) -> Result<(), Rejection> {
    if options.for_ms.is_none() && !options.may_delegate {
        return Ok(());
    }
    Err(args.bad(index, "OPTIONS_JSON", "for_ms or may_delegate".to_owned(), "JSON with stop, or nothing"))
}

/// Does the owner allow it, and whoever gave the grant?
fn check_may_pass_on(target: &Target, own: &Holding, for_good: bool) -> Result<(), Rejection> {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let refused =
        |why: &str| Rejection::new(Code::NotDelegable, format!("the grant of {id} cannot be delegated: {why}"));
    if target.service.sharing.delegable != Some(true) {
        return Err(refused("its owner does not permit it")
            .found("delegable=false")
            .wanted("delegable=true")
            .next(format!("ask an admin of {owner}: ledgerctl robot set {id} delegable=true; or release it")));
    }
    if own.grant.taken.is_some() {
        return Err(refused("it is an override")
            .found("a grant by override")
            .wanted("a grant by acquire")
            .next(format!("release it, so that the next contender can acquire it: ledgerctl release {id}")));
    }
    if let Some(task) = own.grant.task {
        return Err(refused("it serves a task")
            .found(format!("task {task}"))
            .wanted("a grant by acquire")
            .next(format!("end the task first: ledgerctl task cancel {task}")));
    }
    let Some(giver) = own.givers.last().map(|giver| giver.principal.id()) else { return Ok(()) };
    if !own.grant.may_delegate {
        return Err(refused("its giver does not permit it")
            .found(format!("delegated by {giver}"))
            .wanted("a delegation with may_delegate")
            .next(format!("ask {giver} to delegate it with --may-delegate")));
    }
    if own.givers.len() >= GIVERS_MAX && !for_good {
        return Err(refused("it was delegated too often")
            .found(format!("{GIVERS_MAX} delegations"))
            .wanted(format!("fewer than {GIVERS_MAX}"))
            .next(format!("hand it over permanently: ledgerctl handover {id} --to ORGANISATION/NAME")));
    }
    Ok(())
}

/// Is it somebody else, and not one of those who passed it on?
fn check_receiver(ctx: &Context<'_>, target: &Target, own: &Holding, to: &str) -> Result<(), Rejection> {
    let id = &target.id;
    let refused =
        |why: String| Rejection::new(Code::BadArgument, format!("{id} cannot be delegated to {}: {why}", shown(to)));
    if own.grant.holder == to {
        return Err(refused("the receiver is the holder".to_owned())
            .found(to)
            .wanted("another identity")
            .next(format!("to hold it longer: ledgerctl acquire {id}")));
    }
    if own.givers.iter().any(|giver| giver.principal.id() == to) {
        return Err(refused("the receiver delegated it before".to_owned())
            .found(format!("delegated by {}", own.grant.givers.join(", then ")))
            .wanted("an identity that has not delegated it")
            .next(format!("{to} can recall it: ledgerctl recall {id}; or release it")));
    }
    check_has_none(ctx, target, to)
}

/// Refuses a second grant of the service for the same holder, as there may be where several hold it.
pub(crate) fn check_has_none(ctx: &Context<'_>, target: &Target, to: &str) -> Result<(), Rejection> {
    let id = &target.id;
    if grant::held_by(ctx, id, to)?.is_none() {
        return Ok(());
    }
    Err(Rejection::new(Code::BadArgument, format!("{id} cannot be delegated to {}: it has a grant already", shown(to)))
        .found("a grant of its own")
        .wanted("an identity without a grant")
        .next(format!("first release one of the two: ledgerctl release {id}")))
}

/// The limits of the receiver, if policies permit it and everybody who passes it on to hold the service.
pub(crate) fn permit_of_all(
    ctx: &Context<'_>,
    decider: &Decider,
    target: &Target,
    givers: &[Giver],
    receiver: &Principal,
) -> Result<Permit, Rejection> {
    stops::check_goes(ctx, target)?;
    decider::may_hold_after(ctx, decider, givers.iter().map(|giver| &giver.principal), receiver, target)
}
