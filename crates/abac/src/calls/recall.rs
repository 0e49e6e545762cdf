//! `recall`: taking back a grant that was passed on.

use crate::arguments::Arguments;
use crate::lifecycle::acquisition;
use crate::lifecycle::follow_up::Ending;
use crate::lifecycle::grants::{GrantTerms, Inheritance};
use crate::lifecycle::settle::settle;
use crate::lifecycle::{delegation, holders, queue};
use crate::policy::decider::Decider;
use crate::records::grant::{Giver, Holding};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Reason;

/// `recall SERVICE [OPTIONS_JSON]`: by one who has passed the grant on.
pub(crate) fn recall(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("recall SERVICE [OPTIONS_JSON]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let options = delegation::options(args, 1)?;
    delegation::only_stop(args, 1, &options)?;
    let who = principal.id();
    let holders = grant::live(ctx, &target.id)?;
    let place = |holding: &Holding| holding.givers.iter().position(|giver| giver.principal.id() == who);
    let found = holders.iter().find_map(|holding| Some((holding, place(holding)?)));
    let Some((holding, place)) = found else { return Err(not_passed_on(&target, &who, &holders)) };
    delegation::check_has_none(ctx, &target, &who)?;
    let (before, after) = holding.givers.split_at(place);
    let giver = after.first().cloned().ok_or_else(|| Rejection::new(Code::Internal, "a giver has no place"))?;
    let permit = delegation::permit_of_all(ctx, decider, &target, before, &principal)?;
    let inherited = Inheritance {
        givers: before.to_vec(),
        may_delegate: giver.may_delegate,
        ends_by: giver.ends_by,
        since: Some(holding.held_since()),
        follows: (!options.stop).then_some(holding.grant.epoch),
        preempts: false,
    };
    settle(ctx, [Ending::passed_on(holding, Reason::Recalled, &who, !options.stop)])?;
    queue::granted(ctx, decider, &target, &who)?;
    let Giver { priority, lease_ms, .. } = giver;
    acquisition::give(
        ctx,
        decider,
        &target,
        GrantTerms { principal, lease_ms, priority, permit, taken: None, inherited, task: None },
    )
}

fn not_passed_on(target: &Target, who: &str, holders: &[Holding]) -> Rejection {
    let found = match holders {
        [own] if own.grant.holder == who => format!("held by {who}, until {}", holders::until(&own.grant)),
        _ => holders::holders_of(who, holders),
    };
    Rejection::new(Code::NotHolder, format!("{who} has delegated no current grant of {}", target.id))
        .found(found)
        .wanted("a grant that it delegated")
        .next(format!("to acquire it: ledgerctl acquire {}", target.id))
}
