//! `submit`: to submit a task is to acquire the service with it. Its submitter holds the service while it runs.

use crate::arguments::{Arguments, shown};
use crate::calls::reported_task;
use crate::lifecycle::acquisition::Outcome;
use crate::lifecycle::contest::Contest;
use crate::lifecycle::follow_up::Ending;
use crate::lifecycle::grants::{GrantTerms, Inheritance};
use crate::lifecycle::settle::settle;
use crate::lifecycle::{acquisition, contest, holders, lease_bounds, queue, stops, tasks};
use crate::policy::decider::Decider;
use crate::policy::{Permit, decider};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::task::Kept;
use crate::records::{line, robot, store, target, task};
use crate::rules::terms::QUEUE_MAX;
use bytes::Bytes;
use ledger::Context;
use ledger_base::moment::rfc3339;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{
    COORDINATE_UM_MAX, Direction, POINTS_MAX, Place, Reason, Submitted, Task, TaskSpec, TaskState, YAW_URAD_MAX,
};

/// Longest JSON of a task, in bytes: enough to count the points of one that has far too many.
const TASK_BYTES_MAX: usize = 1024 * 1024;

/// Longest name of a frame, in bytes.
const FRAME_BYTES_MAX: usize = 128;

/// Most open tasks of one certificate.
pub(crate) const OPEN_MAX: usize = 64;

/// `submit SERVICE TASK_JSON`: the task runs at once, waits in line, or is scheduled.
pub(crate) fn submit(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("submit SERVICE TASK_JSON", args, 2, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = commanded(ctx, args.text(0, "SERVICE")?)?;
    let spec = read(ctx, &principal, args)?;
    let lease_ms =
        spec.lease_ms.map(|lease_ms| lease_bounds::check_lease(&target, args, 1, lease_ms).map(|()| lease_ms));
    let lease_ms = lease_ms.transpose()?;
    let permit = decider::may_hold(ctx, decider, &principal, &target)?;
    stops::check_goes(ctx, &target)?;
    check_unconfirmed(&target)?;
    let priority = contest::priority(&target, &principal, &permit, spec.priority)?;
    check_open(ctx, &target, &principal)?;
    let now = ctx.block_time();
    let joins = spec.not_before.filter(|time| *time > now);
    let outcome = if joins.is_some() { None } else { Some(outcome(ctx, decider, &target, &principal, priority)?) };
    let state = if joins.is_some() { TaskState::Scheduled } else { TaskState::Waiting };
    let kept = Kept {
        task: Task {
            id: task::next_id(ctx)?,
            service: target.id.clone(),
            submitter: principal.id(),
            state: state.into(),
            reached: 0,
            total: spec.points.len() as u64,
            frame: spec.frame,
            points: Vec::new(),
            priority,
            requeue: spec.requeue,
            not_before: spec.not_before,
            deadline: spec.deadline,
            submitted: now,
            started: None,
            ended: None,
            reason: String::new(),
        },
        principal,
        joins,
        lease_ms,
    };
    task::add(ctx, &kept, &spec.points)?;
    match outcome {
        None => tasks::tell(ctx, &kept)?,
        Some(outcome) => enter(ctx, decider, &target, &kept, permit, outcome)?,
    }
    answer(ctx, decider, &target, kept.task.id)
}

/// The service of an id. A robot stands for its command service, if that is one.
fn commanded(ctx: &Context<'_>, id: &str) -> Result<Target, Rejection> {
    if let (name, "") = target::split(id) {
        let robot = robot::find(ctx, name)?;
        let mut commands = robot.services.iter().filter(|service| service.direction == Direction::Command);
        if let (Some(only), None) = (commands.next(), commands.next()) {
            return Ok(Target::of(&robot, only));
        }
    }
    let target = target::resolve(ctx, id)?;
    if target.service.direction == Direction::Command && !target.is_for_readers() {
        return Ok(target);
    }
    Err(Rejection::new(Code::BadArgument, format!("{} does not accept tasks", target.id))
        .found(if target.is_for_readers() { "subscriber slots" } else { "a feed: the robot publishes there" })
        .wanted("a command service")
        .next(format!("choose a command service: ledgerctl robot show {}", target.robot.name)))
}

/// The task that the caller describes.
fn read(ctx: &Context<'_>, principal: &Principal, args: Arguments<'_>) -> Result<TaskSpec, Rejection> {
    let wanted = "JSON of a task: points, each with x_um, y_um and yaw_urad as whole numbers; frame, priority, \
                  not_before, deadline, lease_ms, requeue";
    let bad = |found: String, wanted: &str| args.bad(1, "TASK_JSON", found, wanted);
    let spec: TaskSpec = serde_json::from_str(args.document(1, "TASK_JSON", TASK_BYTES_MAX)?)
        .map_err(|fault| bad(fault.to_string(), wanted))?;
    if !(1..=POINTS_MAX).contains(&spec.points.len()) {
        return Err(bad(format!("{} points", spec.points.len()), &format!("1 to {POINTS_MAX} points")));
    }
    if let Some(index) = spec.points.iter().position(|point| !point.is_usable()) {
        let wanted = format!(
            "x_um and y_um from -{COORDINATE_UM_MAX} to {COORDINATE_UM_MAX}, yaw_urad from -{YAW_URAD_MAX} to {YAW_URAD_MAX}"
        );
        return Err(bad(format!("point {} out of range", index + 1), &wanted));
    }
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-' | b'.' | b'/');
    if !(1..=FRAME_BYTES_MAX).contains(&spec.frame.len()) || !spec.frame.bytes().all(allowed) {
        let wanted = format!("a frame of 1 to {FRAME_BYTES_MAX} letters, digits, \"_\", \"-\", \".\" and \"/\"");
        return Err(bad(shown(&spec.frame), &wanted));
    }
    let now = ctx.block_time();
    let earliest = spec.not_before.unwrap_or(now).max(now);
    if let Some(deadline) = spec.deadline.filter(|deadline| *deadline <= earliest) {
        return Err(bad(format!("deadline {}", rfc3339(deadline)), &format!("a deadline after {}", rfc3339(earliest))));
    }
    if let Some(time) = spec.not_before.filter(|time| *time >= principal.not_after) {
        let wanted = format!("a time before {}, when the certificate expires", rfc3339(principal.not_after));
        return Err(bad(format!("not_before {}", rfc3339(time)), &wanted));
    }
    Ok(spec)
}

/// Refuses tasks for a service whose contenders others must confirm: nobody has confirmed this one.
fn check_unconfirmed(target: &Target) -> Result<(), Rejection> {
    let Some(wanted) = target.service.sharing.confirm else { return Ok(()) };
    let id = &target.id;
    Err(Rejection::new(Code::BadArgument, format!("{id} does not accept tasks: it requires confirmations"))
        .found(format!("confirm={wanted}"))
        .wanted("a service without confirm")
        .next(format!("acquire it and command the robot without a task: ledgerctl acquire {id}")))
}

/// Refuses more open tasks than one certificate or one service may have.
fn check_open(ctx: &Context<'_>, target: &Target, principal: &Principal) -> Result<(), Rejection> {
    let own = task::count_of(ctx, principal);
    if own >= OPEN_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} has too many open tasks", principal.id()))
            .found(format!("{own} tasks that have not ended"))
            .wanted(format!("fewer than {OPEN_MAX}"))
            .next("wait for one to end, or cancel one: ledgerctl task cancel ID"));
    }
    let most = usize::try_from(QUEUE_MAX).unwrap_or(usize::MAX);
    if task::open(ctx, &target.id, most).len() >= most {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} has too many open tasks", target.id))
            .found(format!("{most} tasks that have not ended"))
            .wanted(format!("fewer than {most}"))
            .next("try again later; to see them: ledgerctl task list"));
    }
    Ok(())
}

/// The position of a new task beside holders and line. Its submitter never competes with itself.
fn outcome(
    ctx: &Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    priority: i64,
) -> Result<Outcome, Rejection> {
    let contest = Contest::of(ctx, target)?;
    let rule = decider.rules.of(target)?;
    let lined = rule.line_max(&target.service.sharing);
    let outcome = match contest.holds(&principal.id()) {
        true if lined == 0 => Err(holders::held(target, &contest.holders)),
        true => Ok(Outcome::InLine { again: None, priority }),
        false if active(Mutation::RunBesideAHolder) => Ok(Outcome::After { ended: Vec::new(), priority }),
        false => {
            let contender = contest::newcomer(ctx, principal.id(), priority);
            acquisition::outcome(target, &contest, contest.decide(rule, &contender), priority)
        }
    }?;
    if matches!(outcome, Outcome::InLine { .. }) {
        queue::check_room(ctx, target, principal, &contest, lined)?;
    }
    Ok(outcome)
}

/// Starts a new task, or puts it in line.
fn enter(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    kept: &Kept,
    permit: Permit,
    outcome: Outcome,
) -> Result<(), Rejection> {
    let Kept { task, principal, .. } = kept;
    match outcome {
        Outcome::InLine { again, .. } => {
            tasks::join(ctx, target, kept)?;
            if let Some(again) = again {
                line::look_by(ctx, &target.id, again)?;
            }
            tasks::tell(ctx, kept)?;
            queue::tell(ctx, decider, target)
        }
        Outcome::After { ended, priority } => {
            let preempts = !ended.is_empty();
            settle(ctx, ended.iter().map(|holding| Ending::for_other(holding, Reason::Preempted, principal)))?;
            let lease_ms = kept.lease_ms.unwrap_or(target.service.lease_ms);
            let (principal, inherited) = (principal.clone(), Inheritance { preempts, ..Inheritance::default() });
            let task = Some(task.id);
            let terms = GrantTerms { principal, lease_ms, priority, permit, taken: None, inherited, task };
            acquisition::give(ctx, decider, target, terms).map(drop)
        }
        Outcome::Own(_) => Ok(()),
    }
}

fn answer(ctx: &Context<'_>, decider: &Decider, target: &Target, id: u64) -> Result<Bytes, Rejection> {
    let kept = reported_task::find(ctx, id)?;
    let grant = tasks::grant_of(ctx, &kept)?.map(|holding| holding.grant);
    let places: Vec<Place> = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    let queued = places.into_iter().find(|place| place.task == Some(id));
    store::json(&Submitted { task: tasks::whole(ctx, kept)?, grant, queued })
}
