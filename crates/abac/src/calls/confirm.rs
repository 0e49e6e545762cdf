//! `confirm`: agreeing that a contender competes for a service.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::acquisition::Outcome;
use crate::lifecycle::{acquisition, confirmation};
use crate::policy::decider;
use crate::policy::decider::Decider;
use crate::records::pending::Asking;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{pending, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Acquired, Confirmation};

/// `confirm SERVICE CONTENDER`: by an admin of the owner, or whom policies permit `confirm`.
pub(crate) fn confirm(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("confirm SERVICE CONTENDER", args, 2, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let contender = args.text(1, "CONTENDER")?;
    let asking = pending::of(ctx, &target.id, contender)?.filter(|asking| asking.until > ctx.block_time());
    let Some(mut asking) = asking else { return Err(nothing_to_confirm(ctx, &target, contender)?) };
    if contender == principal.id() && !active(Mutation::CountTheRequester) {
        return Err(Rejection::new(Code::BadArgument, format!("{contender} cannot confirm itself"))
            .found("the contender")
            .wanted("another identity")
            .next(format!("ask {}", who_may(&target))));
    }
    decider::may_confirm(ctx, decider, &principal, &target)?;
    let wanted = target.service.sharing.confirm.unwrap_or(0);
    asking.confirmed.retain(|confirmed| confirmed.id() != principal.id());
    asking.confirmed.push(principal);
    pending::put(ctx, &target.id, &asking)?;
    let pending = confirmation::told(&target, &asking, wanted);
    ctx.emit("confirmed", &target.id, store::json(&pending)?);
    let (acquired, refused) = if confirmation::agreed(ctx, decider, &target, &asking) < wanted {
        (None, String::new())
    } else {
        compete(ctx, decider, &target, asking)?
    };
    store::json(&Confirmation { pending, acquired, refused })
}

/// The contender competes for the service, or hears why it cannot have it now.
fn compete(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    asking: Asking,
) -> Result<(Option<Acquired>, String), Rejection> {
    let Asking { principal, options, .. } = asking;
    match acquisition::may_acquire(ctx, decider, &principal, target, options.priority) {
        Ok((room, permit)) => {
            let waits = matches!(room, Outcome::InLine { .. });
            match acquisition::enter(ctx, decider, target, principal, &options, room, permit) {
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

fn who_may(target: &Target) -> String {
    let owner = &target.robot.organisation;
    format!("an admin of {owner}, or an identity to which its policies permit the action confirm")
}

fn nothing_to_confirm(ctx: &Context<'_>, target: &Target, contender: &str) -> Result<Rejection, Rejection> {
    let waiting: Vec<String> = pending::all(ctx, &target.id)?.iter().map(|asking| asking.principal.id()).collect();
    let found = if waiting.is_empty() { "no contender waits for confirmation".to_owned() } else { waiting.join(", ") };
    let message = format!("{} does not wait for a confirmation for {}", shown(contender), target.id);
    Ok(Rejection::new(Code::NotFound, message)
        .found(found)
        .wanted("a contender that waits for confirmation")
        .next(format!("the contender requests it with: ledgerctl acquire {}", target.id)))
}
