//! Grants: giving, ending and renewing one. A change returns what follows from it.

use super::follow_up::{Ending, FollowUp};
use super::{holders, looks};
use crate::policy::decider::Decider;
use crate::policy::{Permit, decider, texts};
use crate::records::grant::{Giver, Holding};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, line, reader, store, used};
use crate::rules::terms::Terms;
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, Limits, Released, read_from};

/// The terms of a grant that is given.
pub(crate) struct GrantTerms {
    pub(crate) principal: Principal,
    pub(crate) lease_ms: u64,
    pub(crate) priority: i64,
    /// Its limits, by the policies.
    pub(crate) permit: Permit,
    /// Why it is taken whatever the rule says.
    pub(crate) taken: Option<String>,
    /// The part that stays, if it was passed on or taken back.
    pub(crate) inherited: Inheritance,
    /// The task that it serves.
    pub(crate) task: Option<u64>,
}

/// The part of a grant that comes from those who had the service before.
#[derive(Default)]
pub(crate) struct Inheritance {
    pub(crate) givers: Vec<Giver>,
    pub(crate) may_delegate: bool,
    /// When it ends in any case (block time, microseconds).
    pub(crate) ends_by: Option<u64>,
    /// Since when the service is held without a break (block time, microseconds).
    pub(crate) since: Option<u64>,
    /// The epoch that it follows without a stop between.
    pub(crate) follows: Option<u64>,
    /// Somebody else's grant ended for it.
    pub(crate) preempts: bool,
}

impl Inheritance {
    /// As it was passed to that grant, for another certificate of its holder. It is held as long as before.
    pub(crate) fn on(holding: &Holding) -> Self {
        Self {
            givers: holding.givers.clone(),
            may_delegate: holding.grant.may_delegate,
            ends_by: holding.ends_by,
            since: Some(holding.held_since()),
            follows: None,
            preempts: false,
        }
    }
}

/// The ends of grants of a service that have expired and are not swept up yet.
pub(crate) fn expired(ctx: &Context<'_>, service: &str) -> Result<Vec<FollowUp>, Rejection> {
    let now = ctx.block_time();
    let stored = grant::stored(ctx, service)?;
    Ok(stored.iter().filter(|holding| !holding.is_live(now)).map(|dead| Ending::of(dead, dead.reason())).collect())
}

/// Creates a grant for one for whom there is room. Answers with its JSON, and with what follows.
pub(crate) fn create(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    terms: GrantTerms,
) -> Result<(Bytes, Option<FollowUp>), Rejection> {
    let now = ctx.block_time();
    let GrantTerms { principal, lease_ms, priority, permit, taken, inherited, task } = terms;
    let Inheritance { givers, may_delegate, ends_by, since, follows, preempts } = inherited;
    let newest = grant::newest_epoch(ctx, &target.id)?;
    let reuses = active(Mutation::ReuseAnEpoch)
        || preempts && active(Mutation::PreemptWithoutANewEpoch)
        || since.is_some() && active(Mutation::PassOnWithoutANewEpoch);
    let epoch = newest
        .checked_add(u64::from(newest == 0 || !reuses))
        .ok_or_else(|| Rejection::new(Code::LimitExceeded, format!("{} has no epochs left", target.id)))?;
    store::write(ctx, &store::epoch_key(&target.id), &epoch)?;
    let mut holding = Holding {
        grant: Grant {
            service: target.id.clone(),
            holder: principal.id(),
            epoch,
            expires: 0,
            mode: target.service.mode.clone(),
            acquired_at: now,
            lease_ms,
            next_seq: holders::next_sequence(ctx, decider, target, epoch, &principal.id())?,
            taken,
            limits: Limits::default(),
            givers: givers.iter().map(|giver| giver.principal.id()).collect(),
            may_delegate,
            follows,
            task,
            policy_version: 0,
            policies: Vec::new(),
        },
        principal,
        priority,
        ending: None,
        closes: None,
        ends_by,
        since,
        counted: decider.rules.of(target)?.remembers_use(),
        givers,
    };
    holding.bind(&target.service, &permit.limits, permit.closes);
    holding.decided_by(texts::version(ctx, &target.robot.organisation)?.number, &permit.policies);
    holding.extend(now);
    grant::put(ctx, &holding)?;
    if let Some(idle) = Terms::of(&target.service.sharing).idle_release_us {
        line::look_by(ctx, &target.id, now.saturating_add(idle))?;
    }
    let granted = store::json(&holding.grant)?;
    ctx.emit("granted", &target.id, granted.clone());
    Ok((granted, task.map(FollowUp::TaskRuns)))
}

/// Removes a grant, and emits why. Answers with what follows.
pub(crate) fn end(ctx: &mut Context<'_>, ending: Ending) -> Result<(Released, Option<FollowUp>), Rejection> {
    let Ending { holding, reason, by, goes_on, may_wait: _ } = ending;
    grant::remove(ctx, &holding);
    if holding.counted {
        let Grant { service, holder, acquired_at, expires, .. } = &holding.grant;
        used::add(ctx, service, holder, (*acquired_at, ctx.block_time().min(*expires)))?;
    }
    let Grant { service, holder, epoch, .. } = holding.grant.clone();
    looks::look_now(ctx, &service)?;
    if let Some(read) = read_from(&service) {
        reader::place_ended(ctx, read, reason)?;
    }
    let released = Released { service, holder, epoch, reason: reason.into(), by, goes_on };
    ctx.emit("released", &released.service, store::json(&released)?);
    Ok((released, holding.grant.task.map(|id| FollowUp::TaskGrantEnded { id, reason })))
}

/// Ends a grant that a later block reports: no check overlooks the mark, and it is due at once.
pub(crate) fn mark_ended(ctx: &mut Context<'_>, ending: &Ending) -> Result<(), Rejection> {
    let Ending { holding, reason, .. } = ending;
    let mut marked = holding.clone();
    marked.ending = Some(*reason);
    marked.grant.expires = ctx.block_time().min(holding.grant.expires);
    grant::replace(ctx, holding, &marked)
}

/// Renews a grant and tells so.
pub(crate) fn renewed(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    before: Holding,
    permit: &Permit,
    lease_ms: Option<u64>,
) -> Result<Bytes, Rejection> {
    let mut after = before.clone();
    after.grant.lease_ms = lease_ms.unwrap_or(before.grant.lease_ms).min(target.service.lease_ms_max);
    after.grant.next_seq = holders::next_sequence(ctx, decider, target, before.grant.epoch, &before.grant.holder)?;
    after.bind(&target.service, &permit.limits, permit.closes);
    after.decided_by(texts::version(ctx, &target.robot.organisation)?.number, &permit.policies);
    after.extend(ctx.block_time());
    grant::replace(ctx, &before, &after)?;
    let told = store::json(&after.grant)?;
    ctx.emit("renewed", &target.id, told.clone());
    Ok(told)
}

/// Renews a grant because it is used. It writes only when more than a quarter of the lease is used up. It asks only
/// policies that look at the time; all others ended the grant when they changed.
pub(crate) fn renew_by_use(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    before: &Holding,
) -> Result<(), Rejection> {
    let now = ctx.block_time();
    let quarter = before.grant.lease_ms.saturating_mul(250);
    if before.extended(now).saturating_sub(before.grant.expires) <= quarter {
        return Ok(());
    }
    let Ok(permit) = decider::may_keep(ctx, decider, before, target) else { return Ok(()) };
    let mut after = before.clone();
    after.bind(&target.service, &permit.limits, permit.closes);
    after.decided_by(texts::version(ctx, &target.robot.organisation)?.number, &permit.policies);
    after.extend(now);
    grant::replace(ctx, before, &after)
}
