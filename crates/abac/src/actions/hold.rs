//! The holders of services: `grants`, and the caller's own grant.

use super::publish;
use crate::arguments::Arguments;
use crate::policy::decider::Decider;
use crate::records::grant::{self, Holding};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::store;
use crate::timestamp::rfc3339;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Grant;

/// `grants [SERVICE|PAGE_JSON]`: the live grants of one service or of all.
pub(crate) fn list(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let of_one = args.first().is_some_and(|argument| !argument.starts_with(b"{"));
    let given = Arguments::new("grants [SERVICE|PAGE_JSON]", args, 0, 1)?;
    if of_one {
        let target = service::resolve(ctx, given.text(0, "SERVICE")?)?;
        return store::json(&live(ctx, decider, &target)?);
    }
    let paging = Paging::of("grants", args)?;
    let read = |key: &[u8], value: &[u8]| shown(ctx, decider, store::parse(key, value)?);
    paging.answer(&paging.page(ctx, b"grant/", read)?)
}

/// The live grants of a service, as they are listed.
pub(crate) fn live(ctx: &Context<'_>, decider: &Decider, target: &Target) -> Result<Vec<Grant>, Rejection> {
    let listed = |Holding { mut grant, .. }| {
        grant.next_seq = publish::next_sequence(ctx, decider, target, grant.epoch, &grant.holder)?;
        Ok(grant)
    };
    grant::live(ctx, &target.id)?.into_iter().map(listed).collect()
}

/// A grant as it is listed, if it is live.
fn shown(ctx: &Context<'_>, decider: &Decider, holding: Holding) -> Result<Option<Grant>, Rejection> {
    if !holding.is_live(ctx.block_time()) {
        return Ok(None);
    }
    let mut grant = holding.grant;
    let target = service::resolve(ctx, &grant.service)?;
    grant.next_seq = publish::next_sequence(ctx, decider, &target, grant.epoch, &grant.holder)?;
    Ok(Some(grant))
}

/// The principal's own live grant, acquired with this certificate.
///
/// # Errors
/// [`Code::NotHolder`], saying who holds the service instead.
pub(crate) fn own(ctx: &Context<'_>, principal: &Principal, target: &Target) -> Result<Holding, Rejection> {
    let own = grant::held_by(ctx, &target.id, &principal.id())?;
    if let Some(own) = own.filter(|own| own.principal.same_certificate(principal)) {
        return Ok(own);
    }
    Err(not_holder(target, &principal.id(), &grant::live(ctx, &target.id)?))
}

fn not_holder(target: &Target, who: &str, holders: &[Holding]) -> Rejection {
    let id = &target.id;
    Rejection::new(Code::NotHolder, format!("{who} holds no grant of {id}"))
        .found(holders_of(who, holders))
        .wanted(format!("a grant of {id} to {who}"))
        .next(match holders {
            [holding] if holding.grant.givers.iter().any(|giver| giver == who) => {
                format!("take it back: ledgerctl recall {id}")
            }
            [holding] if holding.grant.holder != who => format!("once it is free: ledgerctl acquire {id}"),
            _ => format!("ledgerctl acquire {id}"),
        })
}

/// The refusal that names the holders of a service to somebody who is none.
pub(crate) fn holders_of(who: &str, holders: &[Holding]) -> String {
    match holders {
        [] => "held by nobody".to_owned(),
        [holding] if holding.grant.holder == who => {
            format!("acquired with another certificate, until {}", until(&holding.grant))
        }
        [holding] => format!("held by {} until {}", holding.grant.holder, until(&holding.grant)),
        many => format!("{} other holders", many.len()),
    }
}

/// When a grant ends, for people and for programs.
pub(crate) fn until(grant: &Grant) -> String {
    format!("{} ({} µs)", rfc3339(grant.expires), grant.expires)
}
