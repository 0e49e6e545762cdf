//! `acquire` and `take`: who gets a grant.

use super::contest::{self, Contest, OVERRIDING};
use super::describe::LEASE_MS_MIN;
use super::hold::until;
use super::{confirm, emergency, end, publish, queue, renew, task_turns};
use crate::arguments::Arguments;
use crate::policy::Permit;
use crate::policy::decider::{self, Decider};
use crate::policy::texts;
use crate::records::grant::{self, Giver, HOLDERS_MAX, Holding};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::{line, store};
use crate::rules::Decision;
use crate::rules::terms::Terms;
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Acquired, Grant, Limits, Reason};

/// The position of a contender that has no grant.
pub(crate) enum Room {
    /// The contender has a grant already.
    Own(Box<Holding>),
    /// These grants, which end for it.
    After { ended: Vec<Holding>, priority: i64 },
    /// The line, until that time at least (block time, microseconds).
    InLine { again: Option<u64>, priority: i64 },
}

/// The terms of a grant that is given.
pub(crate) struct Award {
    pub(crate) principal: Principal,
    pub(crate) lease_ms: u64,
    pub(crate) priority: i64,
    /// Its limits, by the policies.
    pub(crate) permit: Permit,
    /// Why it is taken whatever the rule says.
    pub(crate) taken: Option<String>,
    /// The part that stays, if it was passed on or taken back.
    pub(crate) passed: Passed,
    /// The task that it serves.
    pub(crate) task: Option<u64>,
}

/// The part of a grant that comes from those who had the service before.
#[derive(Default)]
pub(crate) struct Passed {
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

impl Passed {
    /// As it was passed to that grant, for another certificate of its holder. It is held as long as before.
    fn on(holding: &Holding) -> Self {
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

const USAGE: &str = "acquire SERVICE [LEASE_MS|OPTIONS_JSON]";

/// `acquire SERVICE [LEASE_MS|OPTIONS_JSON]`
pub(crate) fn acquire(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let options = options(&target, args)?;
    let (room, permit) = may_acquire(ctx, decider, &principal, &target, options.priority)?;
    let waits = match &room {
        Room::Own(_) => false,
        Room::InLine { .. } => options.wait_ms != Some(0),
        Room::After { .. } => true,
    };
    if waits && let Some(pending) = confirm::first(ctx, decider, &target, &principal, &options)? {
        return store::json(&Acquired::Pending { pending });
    }
    settle(ctx, decider, &target, principal, &options, room, permit)
}

/// Gives one who may the room that there is for it: a grant, or a place in line.
pub(crate) fn settle(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: Principal,
    options: &AcquireOptions,
    room: Room,
    permit: Permit,
) -> Result<Bytes, Rejection> {
    let (ending, priority, passed) = match room {
        Room::Own(own) if own.principal.same_certificate(&principal) => {
            return renew::renewed(ctx, decider, target, *own, &permit, options.lease_ms);
        }
        // Another certificate of the same person: whoever holds the old one must be fenced off.
        Room::Own(own) => (vec![(own.as_ref().clone(), Reason::Released)], own.priority, Passed::on(&own)),
        Room::After { ended, priority } => {
            (ended.into_iter().map(|holding| (holding, Reason::Preempted)).collect(), priority, Passed::default())
        }
        Room::InLine { again, priority } => {
            let queued = queue::join(ctx, decider, target, &principal, options, priority)?;
            if let Some(again) = again {
                line::look_by(ctx, &target.id, again)?;
            }
            return store::json(&Acquired::Queued { queued });
        }
    };
    let preempts = ending.iter().any(|(_, reason)| *reason == Reason::Preempted);
    for (holding, reason) in ending {
        end::end_for(ctx, &holding, reason, &principal)?;
    }
    queue::granted(ctx, decider, target, &principal.id())?;
    let lease_ms = options.lease_ms.unwrap_or(target.service.lease_ms);
    let passed = Passed { preempts, ..passed };
    give(ctx, decider, target, Award { principal, lease_ms, priority, permit, taken: None, passed, task: None })
}

/// `take SERVICE REASON [LEASE_MS]`: the service, whatever its rule says; by an admin of the owner, or whom policies permit
/// `override`.
pub(crate) fn take(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("take SERVICE REASON [LEASE_MS]", args, 2, 3)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let reason = args.text(1, "REASON")?.to_owned();
    let lease_ms = if args.has(2) { lease(&target, args, 2)? } else { target.service.lease_ms };
    let permit = decider::may_override(ctx, decider, &principal, &target)?;
    emergency::check_goes(ctx, &target)?;
    for holding in grant::live(ctx, &target.id)? {
        end::end_for(ctx, &holding, Reason::Overridden, &principal)?;
    }
    queue::granted(ctx, decider, &target, &principal.id())?;
    let (taken, passed) = (Some(reason), Passed::default());
    give(ctx, decider, &target, Award { principal, lease_ms, priority: OVERRIDING, permit, taken, passed, task: None })
}

/// Algorithm 1 of the paper: may this principal have a grant now, by the policies and beside those who hold one?
///
/// # Errors
/// The answer of the policies, [`Code::Stopped`], [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn may_acquire(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
    asked: Option<i64>,
) -> Result<(Room, Permit), Rejection> {
    let own = grant::held_by(ctx, &target.id, &principal.id())?;
    let givers = own.iter().flat_map(|own| &own.givers).map(|giver| &giver.principal);
    let permit = decider::may_hold_after(ctx, decider, givers, principal, target)?;
    emergency::check_goes(ctx, target)?;
    if let Some(own) = own {
        return Ok((Room::Own(Box::new(own)), permit));
    }
    let priority = contest::priority(target, principal, &permit, asked)?;
    let contest = Contest::of(ctx, target)?;
    let waits = contest.line.iter().find(|waiting| waiting.place() == principal.id());
    let contender = match waits {
        Some(waiting) => contest::claim(waiting),
        None => contest::newcomer(ctx, principal.id(), priority),
    };
    let room = room(target, &contest, contest.decide(decider.rules.of(target)?, &contender), priority)?;
    Ok((room, permit))
}

/// The position of a contender that holds nothing of the service, as the rule has decided.
///
/// # Errors
/// [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn room(
    target: &Target,
    contest: &Contest<'_>,
    decision: Decision,
    priority: i64,
) -> Result<Room, Rejection> {
    match decision {
        Decision::Refuse => Err(held(target, &contest.holders)),
        Decision::Wait { again } => Ok(Room::InLine { again, priority }),
        Decision::Grant { ends } => {
            let ended: Vec<Holding> = ends.iter().filter_map(|index| contest.holders.get(*index)).cloned().collect();
            match contest.holders.len() - ended.len() {
                beside if beside >= HOLDERS_MAX => Err(full(target, beside)),
                _ => Ok(Room::After { ended, priority }),
            }
        }
    }
}

/// Gives a grant to one for whom there is room.
pub(crate) fn give(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    award: Award,
) -> Result<Bytes, Rejection> {
    let now = ctx.block_time();
    for dead in grant::stored(ctx, &target.id)?.iter().filter(|holding| !holding.is_live(now)) {
        end::end(ctx, dead, dead.reason())?;
    }
    let Award { principal, lease_ms, priority, permit, taken, passed, task } = award;
    let Passed { givers, may_delegate, ends_by, since, follows, preempts } = passed;
    let newest = grant::newest_epoch(ctx, &target.id)?;
    let reuses = active(Mutation::ReuseAnEpoch)
        || preempts && active(Mutation::PreemptWithoutANewEpoch)
        || since.is_some() && active(Mutation::PassOnWithoutANewEpoch);
    let epoch = newest
        .checked_add(u64::from(newest == 0 || !reuses))
        .ok_or_else(|| Rejection::new(Code::LimitExceeded, format!("{} has used up its epochs", target.id)))?;
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
            next_seq: publish::next_sequence(ctx, decider, target, epoch, &principal.id())?,
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
    if let Some(id) = task {
        task_turns::runs(ctx, id)?;
    }
    Ok(granted)
}

/// The wishes of the caller besides the service.
fn options(target: &Target, args: Arguments<'_>) -> Result<AcquireOptions, Rejection> {
    if !args.has(1) {
        return Ok(AcquireOptions::default());
    }
    let text = args.text(1, "LEASE_MS|OPTIONS_JSON")?;
    if !text.starts_with('{') {
        return Ok(AcquireOptions { lease_ms: Some(lease(target, args, 1)?), ..AcquireOptions::default() });
    }
    let options: AcquireOptions = serde_json::from_str(text).map_err(|fault| {
        args.bad(1, "OPTIONS_JSON", fault.to_string(), "JSON with some of lease_ms, wait_ms and priority")
    })?;
    if let Some(lease_ms) = options.lease_ms {
        check_lease(target, args, 1, lease_ms)?;
    }
    Ok(options)
}

/// The lease that the caller asks for.
pub(crate) fn lease(target: &Target, args: Arguments<'_>, index: usize) -> Result<u64, Rejection> {
    let lease_ms = args.number(index, "LEASE_MS")?;
    check_lease(target, args, index, lease_ms)?;
    Ok(lease_ms)
}

/// Refuses a lease that the service does not allow.
pub(crate) fn check_lease(target: &Target, args: Arguments<'_>, index: usize, lease_ms: u64) -> Result<(), Rejection> {
    let max = target.service.lease_ms_max;
    if (LEASE_MS_MIN..=max).contains(&lease_ms) {
        return Ok(());
    }
    let wanted = format!("{LEASE_MS_MIN} to {max} ms for {}", target.id);
    Err(args.bad(index, "LEASE_MS", format!("{lease_ms} ms"), &wanted))
}

/// The refusal that names who stands before the caller.
pub(crate) fn held(target: &Target, holders: &[Holding]) -> Rejection {
    let (id, mode, owner) = (&target.id, &target.service.mode, &target.robot.organisation);
    // Whoever ends first; no rule refuses while nobody holds the service.
    let Some(first) = holders.iter().min_by_key(|holding| holding.grant.expires) else {
        return Rejection::new(Code::Held, format!("{id} cannot be had now")).found(format!("{mode} service"));
    };
    let Grant { holder, epoch, .. } = &first.grant;
    if let [_] = holders {
        return Rejection::new(Code::Held, format!("{id} is held by {holder} until {}", until(&first.grant)))
            .found(format!("{mode} service, held by {holder} with epoch {epoch}"))
            .wanted("no other holder")
            .next(format!(
                "acquire it after that time, ask {holder} to release it, or ask an admin of {owner} to take it back"
            ));
    }
    let names: Vec<&str> = holders.iter().map(|holding| holding.grant.holder.as_str()).collect();
    Rejection::new(Code::Held, format!("every place of {id} is taken until {}", until(&first.grant)))
        .found(format!("{mode} service, held by {}", names.join(", ")))
        .wanted(format!("fewer than {} holders", holders.len()))
        .next(format!("acquire it after that time, ask one of them to release it, or ask an admin of {owner}"))
}

fn full(target: &Target, holders: usize) -> Rejection {
    Rejection::new(Code::LimitExceeded, format!("{} has no room for another holder", target.id))
        .found(format!("{holders} holders"))
        .wanted(format!("at most {HOLDERS_MAX}"))
}
