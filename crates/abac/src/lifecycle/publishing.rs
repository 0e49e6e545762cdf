//! The right to publish on a service.

use crate::lifecycle::{holders, stops, undecided};
use crate::policy::action::Action;
use crate::policy::decider::Decider;
use crate::policy::{Permit, decider};
use crate::records::grant;
use crate::records::grant::Holding;
use crate::records::principal::Principal;
use crate::records::target::Target;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Publishing;
use ledger_identity::Identity;
use std::sync::Arc;

/// The right to publish.
pub(crate) enum Right {
    /// A grant.
    Grant(Arc<Holding>),
    /// Policies, without a grant.
    Policies(Permit),
}

/// May they publish now? With an epoch, that epoch must be the one of their grant; epoch 0 asks the policies alone,
/// where the service's rule allows it.
///
/// The usual case, a holder who publishes, reads three values of the state and asks no policy.
///
/// # Errors
/// [`Code::StaleEpoch`], [`Code::NotHolder`], [`Code::UnknownService`] for places of subscribers, or what [`Decider::decide`] says.
pub(crate) fn may_publish(
    ctx: &Context<'_>,
    decider: &Decider,
    submitter: &Identity,
    target: &Target,
    epoch: Option<u64>,
) -> Result<Right, Rejection> {
    if target.is_for_readers() {
        return Err(for_readers(target));
    }
    let is_without_grant = epoch.is_none_or(|epoch| epoch == 0);
    let by_policy = is_without_grant && decider.rules.capabilities(target)?.publishing == Publishing::Policy;
    if !by_policy
        && let Some(own) = decider.records.held(ctx, &target.id, submitter)?
        && epoch.is_none_or(|epoch| epoch == own.grant.epoch)
    {
        // A change of policies ends grants, but may not have come to this one yet.
        if undecided::is_marked(ctx, target) {
            decider::may_keep(ctx, decider, &own, target)?;
        }
        return Ok(Right::Grant(own));
    }
    let principal = &Principal::of(submitter);
    if by_policy {
        let permit = decider.decide(ctx, principal, target, Action::Publish)?;
        stops::check_goes(ctx, target)?;
        return if permit.limits.is_none() {
            Ok(Right::Policies(permit))
        } else {
            Err(limited(target, &principal.id()))
        };
    }
    stops::check_goes(ctx, target)?;
    let newest = grant::newest_epoch(ctx, &target.id)?;
    let refused = match holders::own(ctx, principal, target) {
        Ok(own) if epoch.is_none_or(|epoch| epoch == own.grant.epoch) => return Ok(Right::Grant(Arc::new(own))),
        Ok(own) => stale(target, epoch, own.grant.epoch),
        // Who has lost the grant to a newer one hears that; who never had one hears what is missing.
        Err(_) if epoch.is_some_and(|epoch| epoch > 0 && epoch < newest) => stale(target, epoch, newest),
        Err(not_holder) => decider.decide(ctx, principal, target, Action::Publish).err().unwrap_or(not_holder),
    };
    Err(refused)
}

/// Places of subscribers are for reading.
fn for_readers(target: &Target) -> Rejection {
    let id = target.service_id();
    Rejection::new(
        Code::UnknownService,
        format!(
            "{} cannot be published on: it stands for the subscriber slots of a \
                                                  service",
            target.id
        ),
    )
    .found("subscriber slots")
    .wanted(id)
    .next(format!("publish on {id}"))
}

/// Limits are part of a grant, from which the robot learns them.
fn limited(target: &Target, who: &str) -> Rejection {
    Rejection::new(Code::NotHolder, format!("policies limit the use of {} by {who}, so a grant is needed", target.id))
        .found("no grant")
        .wanted("a grant, whose limits the robot enforces")
        .next(format!("ledgerctl acquire {}", target.id))
}

fn stale(target: &Target, epoch: Option<u64>, wanted: u64) -> Rejection {
    Rejection::new(Code::StaleEpoch, format!("{} is held in another epoch", target.id))
        .found(format!("epoch {}", epoch.unwrap_or(0)))
        .wanted(format!("epoch {wanted}, held by its holder"))
        .next(format!("ledgerctl acquire {}", target.id))
}
