//! The holders of a service, and the refusals that name them.

use crate::policy::decider::Decider;
use crate::records::grant::Holding;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, last};
use ledger::Context;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Grant;

/// The live grants of a service, as they are listed.
pub(crate) fn live(ctx: &Context<'_>, decider: &Decider, target: &Target) -> Result<Vec<Grant>, Rejection> {
    let listed = |Holding { mut grant, .. }| {
        grant.next_seq = next_sequence(ctx, decider, target, grant.epoch, &grant.holder)?;
        Ok(grant)
    };
    grant::live(ctx, &target.id)?.into_iter().map(listed).collect()
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
                format!("recall it: ledgerctl recall {id}")
            }
            [holding] if holding.grant.holder != who => format!("once it is free: ledgerctl acquire {id}"),
            _ => format!("ledgerctl acquire {id}"),
        })
}

/// The refusal that names the holders of a service to somebody who is none.
pub(crate) fn holders_of(who: &str, holders: &[Holding]) -> String {
    match holders {
        [] => "no holder".to_owned(),
        [holding] if holding.grant.holder == who => {
            format!("acquired with another certificate, until {}", until(&holding.grant))
        }
        [holding] => format!("held by {} until {}", holding.grant.holder, until(&holding.grant)),
        many => format!("{} other holders", many.len()),
    }
}

/// The expiry of a grant, for people; programs read `expires`.
pub(crate) fn until(grant: &Grant) -> String {
    rfc3339(grant.expires)
}

/// The smallest sequence number that `set` accepts from a publisher in an epoch.
pub(crate) fn next_sequence(
    ctx: &Context<'_>,
    decider: &Decider,
    target: &Target,
    epoch: u64,
    publisher: &str,
) -> Result<u64, Rejection> {
    last::next_sequence(ctx, &target.id, decider.rules.capabilities(target)?.sequence, epoch, publisher)
}

/// The refusal that names who stands before the caller.
pub(crate) fn held(target: &Target, holders: &[Holding]) -> Rejection {
    let (id, mode, owner) = (&target.id, &target.service.mode, &target.robot.organisation);
    // Whoever ends first; no rule refuses while nobody holds the service.
    let Some(first) = holders.iter().min_by_key(|holding| holding.grant.expires) else {
        return Rejection::new(Code::Held, format!("{id} is not available")).found(format!("{mode} service"));
    };
    let Grant { holder, epoch, .. } = &first.grant;
    if let [_] = holders {
        return Rejection::new(Code::Held, format!("{id} is held by {holder} until {}", until(&first.grant)))
            .found(format!("{mode} service, held by {holder} with epoch {epoch}"))
            .wanted("no other holder")
            .next(format!(
                "acquire it after that time, ask {holder} to release it, or ask an admin of {owner} to revoke the grant"
            ));
    }
    let names: Vec<&str> = holders.iter().map(|holding| holding.grant.holder.as_str()).collect();
    Rejection::new(Code::Held, format!("all slots of {id} are taken until {}", until(&first.grant)))
        .found(format!("{mode} service, held by {}", names.join(", ")))
        .wanted(format!("fewer than {} holders", holders.len()))
        .next(format!("acquire it after that time, ask one of them to release it, or ask an admin of {owner}"))
}
