//! Robots: who owns them, their quota, and taking one out of service.

use super::follow_up::{Ending, FollowUp};
use crate::lifecycle::looks;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{grant, reader, robot, side_door, store};
use bytes::Bytes;
use ledger::Context;
use ledger::msp::{Quotas, quota_reached};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Reason, RobotEvent};
use ledger_identity::{Identity, Role};

/// Takes a robot out of service; answers with the grants that end by that.
pub(crate) fn take_out(ctx: &mut Context<'_>, robot: &Robot) -> Result<Vec<FollowUp>, Rejection> {
    let mut ending = Vec::new();
    for Target { id, .. } in Target::all_of(robot) {
        looks::look_now(ctx, &id)?;
        ending.extend(grant::live(ctx, &id)?.into_iter().map(|holding| Ending::of_many(holding, Reason::RobotRemoved)));
    }
    robot::remove(ctx, robot);
    side_door::forget(ctx, robot, None);
    reader::forget(ctx, robot, None)?;
    Ok(ending)
}

/// Refuses one more robot of an organisation beyond its quota.
pub(crate) fn check_quota(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let most = quotas(ctx, organisation)?.robots;
    if (robot::names_of(ctx, organisation).len() as u64) < most {
        return Ok(());
    }
    Err(quota_reached(organisation, "robots", most, "remove an unused robot: ledgerctl robot remove NAME"))
}

/// Refuses a budget of a service that is larger than its owner's quota. The owner lowers it alone; with a larger quota, which
/// other organisations approve, it may be larger.
pub(crate) fn check_budgets(ctx: &mut Context<'_>, robot: &Robot) -> Result<(), Rejection> {
    let sharing = || robot.services.iter().map(|service| &service.sharing);
    if sharing().all(|sharing| sharing.bytes_per_s.is_none() && sharing.messages_per_s.is_none()) {
        return Ok(());
    }
    let quotas = quotas(ctx, &robot.organisation)?;
    for service in &robot.services {
        let kinds = [
            ("service_bytes_per_s", service.sharing.bytes_per_s, quotas.service_bytes_per_s),
            ("service_messages_per_s", service.sharing.messages_per_s, quotas.service_messages_per_s),
        ];
        for (kind, wanted, quota) in kinds {
            if let Some(wanted) = wanted.filter(|wanted| *wanted > quota) {
                let organisation = &robot.organisation;
                return Err(Rejection::new(
                    Code::QuotaReached,
                    format!("the budget of {} exceeds the quota of {organisation}", robot.service_id(service)),
                )
                .found(wanted.to_string())
                .wanted(format!("at most {quota}: the quota {kind} of {organisation}"))
                .next(format!(
                    "set a smaller budget; or propose a larger quota: ledgerctl network propose msp set_quota \
                     '{{\"organisation\":\"{organisation}\",\"{kind}\":{wanted}}}'"
                )));
            }
        }
    }
    Ok(())
}

/// The quotas of an organisation.
pub(crate) fn quotas(ctx: &mut Context<'_>, organisation: &str) -> Result<Quotas, Rejection> {
    let quotas = ctx.call("msp", "quotas", &[Bytes::copy_from_slice(organisation.as_bytes())])?;
    store::parse(b"msp quotas", &quotas)
}

/// Tells that a robot was registered, updated or removed.
pub(crate) fn tell(ctx: &mut Context<'_>, robot: &Robot, change: &str) -> Result<(), Rejection> {
    let event =
        RobotEvent { robot: robot.name.clone(), organisation: robot.organisation.clone(), change: change.to_owned() };
    ctx.emit("robot", &robot.name, store::json(&event)?);
    Ok(())
}

/// The submitter, if they are an admin of their organisation.
///
/// # Errors
/// [`Code::NotAdmin`].
pub(crate) fn admin<'a>(ctx: &Context<'a>, what: &str) -> Result<&'a Identity, Rejection> {
    let submitter = ctx.submitter()?;
    if submitter.role == Role::Admin {
        return Ok(submitter);
    }
    Err(Rejection::new(Code::NotAdmin, format!("{} may not {what}", submitter.id()))
        .found(format!("role {}", submitter.role))
        .wanted(format!("an admin of {}", submitter.organisation)))
}

/// Refuses who is no admin of the robot's owner.
///
/// # Errors
/// [`Code::NotOwner`].
pub(crate) fn check_owner(robot: &Robot, admin: &Identity) -> Result<(), Rejection> {
    if robot.organisation == admin.organisation {
        return Ok(());
    }
    Err(Rejection::new(Code::NotOwner, format!("robot {} belongs to {}", robot.name, robot.organisation))
        .found(format!("{}, an admin of {}", admin.id(), admin.organisation))
        .wanted(format!("an admin of {}", robot.organisation))
        .next(format!("ask an admin of {}", robot.organisation)))
}
