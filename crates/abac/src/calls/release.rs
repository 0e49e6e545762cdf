//! `release`: giving a service back, or taking it back.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::departures;
use crate::lifecycle::follow_up::Ending;
use crate::lifecycle::holders::{holders_of, own};
use crate::lifecycle::settle::settle;
use crate::policy::decider::Decider;
use crate::records::grant::Holding;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{LeftReason, Reason, Released};
use ledger_identity::Role;

/// `release SERVICE [HOLDER]`: the caller's own grant; without one, an admin of the owner takes the service back,
/// from everybody or from one holder. A contender in line leaves it.
pub(crate) fn release(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("release SERVICE [HOLDER]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let whose = if args.has(1) { Some(args.text(1, "HOLDER")?) } else { None };
    let is_own = whose.is_none_or(|holder| holder == principal.id());
    let takes_back = principal.role == Role::Admin && principal.organisation == target.robot.organisation;
    if is_own && let Ok(own) = own(ctx, &principal, &target) {
        return store::json(&settle(ctx, [Ending::of(&own, Reason::Released)])?);
    }
    if is_own && departures::leave(ctx, decider, &target, &principal.id(), LeftReason::Left)? {
        return store::json(&Vec::<Released>::new());
    }
    let holders = grant::live(ctx, &target.id)?;
    if !takes_back {
        return Err(match whose.filter(|_| !is_own) {
            Some(holder) => not_yours_to_take(&principal, &target, holder),
            None => nothing_to_release(&principal.id(), &target, &holders),
        });
    }
    let mut taken = holders.clone();
    taken.retain(|holding| whose.is_none_or(|holder| holder == holding.grant.holder));
    if let (Some(holder), true) = (whose, taken.is_empty()) {
        if departures::leave(ctx, decider, &target, holder, LeftReason::Removed)? {
            return store::json(&Vec::<Released>::new());
        }
        return Err(nothing_to_release(&shown(holder), &target, &holders).wanted("a holder of the service"));
    }
    store::json(&settle(ctx, taken.into_iter().map(|holding| Ending::of_many(holding, Reason::Taken)))?)
}

fn nothing_to_release(who: &str, target: &Target, holders: &[Holding]) -> Rejection {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let next = match holders {
        [] => format!("there is nothing to release; ledgerctl robot show {} shows the holders", target.robot.name),
        [holding] if holding.grant.holder == who => {
            format!("it expires by itself; to end it now: ledgerctl acquire {id}, then release it")
        }
        _ => format!("only the holder, or an admin of {owner}, can release it"),
    };
    Rejection::new(Code::NotHolder, format!("{who} holds no grant of {id}"))
        .found(holders_of(who, holders))
        .wanted("a grant to release")
        .next(next)
}

fn not_yours_to_take(principal: &Principal, target: &Target, holder: &str) -> Rejection {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let code = if principal.organisation == *owner { Code::NotAdmin } else { Code::NotOwner };
    Rejection::new(code, format!("{} may not revoke the grant of {id} of {}", principal.id(), shown(holder)))
        .found(format!("role {} of {}", principal.role, principal.organisation))
        .wanted(format!("an admin of {owner}, which owns {}", target.robot.name))
        .next(format!("ask an admin of {owner}, or release your own grant: ledgerctl release {id}"))
}
