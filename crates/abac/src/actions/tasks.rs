//! `submit`, `progress`, `fail`, `cancel`: what users and robots do with tasks.
//!
//! To submit a task is to acquire the service with it: its submitter holds the service while it runs.

use super::acquire::{self, Award, Passed, Room};
use super::contest::{self, Contest};
use super::{emergency, end, queue, renew, task_list, task_turns};
use crate::arguments::{Arguments, shown};
use crate::policy::Permit;
use crate::policy::decider::{self, Decider};
use crate::records::principal::Principal;
use crate::records::robot::{self, Robot};
use crate::records::service::{self, Target};
use crate::records::task::{self, Kept};
use crate::records::{line, store};
use crate::rules::terms::QUEUE_MAX;
use bytes::Bytes;
use ledger::Context;
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
    let lease_ms = spec.lease_ms.map(|lease_ms| acquire::check_lease(&target, args, 1, lease_ms).map(|()| lease_ms));
    let lease_ms = lease_ms.transpose()?;
    let permit = decider::may_hold(ctx, decider, &principal, &target)?;
    emergency::check_goes(ctx, &target)?;
    check_unconfirmed(&target)?;
    let priority = contest::priority(&target, &principal, &permit, spec.priority)?;
    check_open(ctx, &target, &principal)?;
    let now = ctx.block_time();
    let joins = spec.not_before.filter(|time| *time > now);
    let room = if joins.is_some() { None } else { Some(room(ctx, decider, &target, &principal, priority)?) };
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
    match room {
        None => task_turns::tell(ctx, &kept)?,
        Some(room) => enter(ctx, decider, &target, &kept, permit, room)?,
    }
    answer(ctx, decider, &target, kept.task.id)
}

/// The service of an id. A robot stands for its command service, if that is one.
fn commanded(ctx: &Context<'_>, id: &str) -> Result<Target, Rejection> {
    if let (name, "") = service::split(id) {
        let robot = robot::find(ctx, name)?;
        let mut commands = robot.services.iter().filter(|service| service.direction == Direction::Command);
        if let (Some(only), None) = (commands.next(), commands.next()) {
            return Ok(Target::of(&robot, only));
        }
    }
    let target = service::resolve(ctx, id)?;
    if target.service.direction == Direction::Command && !target.is_for_readers() {
        return Ok(target);
    }
    Err(Rejection::new(Code::BadArgument, format!("{} takes no tasks", target.id))
        .found(if target.is_for_readers() { "places of subscribers" } else { "a feed: the robot publishes there" })
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
        return Err(bad(format!("deadline {deadline} µs"), &format!("a deadline after {earliest} µs")));
    }
    if let Some(time) = spec.not_before.filter(|time| *time >= principal.not_after) {
        let wanted = format!("a time before {} µs, when the certificate runs out", principal.not_after);
        return Err(bad(format!("not_before {time} µs"), &wanted));
    }
    Ok(spec)
}

/// Refuses tasks for a service whose contenders others must confirm: nobody has confirmed this one.
fn check_unconfirmed(target: &Target) -> Result<(), Rejection> {
    let Some(wanted) = target.service.sharing.confirm else { return Ok(()) };
    let id = &target.id;
    Err(Rejection::new(Code::BadArgument, format!("{id} takes no tasks: others must confirm who uses it"))
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
fn room(
    ctx: &Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    priority: i64,
) -> Result<Room, Rejection> {
    let contest = Contest::of(ctx, target)?;
    let rule = decider.rules.of(target)?;
    let lined = rule.line_max(&target.service.sharing);
    let room = match contest.holds(&principal.id()) {
        true if lined == 0 => Err(acquire::held(target, &contest.holders)),
        true => Ok(Room::InLine { again: None, priority }),
        false if active(Mutation::RunBesideAHolder) => Ok(Room::After { ended: Vec::new(), priority }),
        false => {
            let contender = contest::newcomer(ctx, principal.id(), priority);
            acquire::room(target, &contest, contest.decide(rule, &contender), priority)
        }
    }?;
    if matches!(room, Room::InLine { .. }) {
        queue::check_room(ctx, target, principal, &contest, lined)?;
    }
    Ok(room)
}

/// Starts a new task, or puts it in line.
fn enter(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    kept: &Kept,
    permit: Permit,
    room: Room,
) -> Result<(), Rejection> {
    let Kept { task, principal, .. } = kept;
    match room {
        Room::InLine { again, .. } => {
            task_turns::join(ctx, target, kept)?;
            if let Some(again) = again {
                line::look_by(ctx, &target.id, again)?;
            }
            task_turns::tell(ctx, kept)?;
            queue::tell(ctx, decider, target)
        }
        Room::After { ended, priority } => {
            let preempts = !ended.is_empty();
            for holding in ended {
                end::end_for(ctx, &holding, Reason::Preempted, principal)?;
            }
            let lease_ms = kept.lease_ms.unwrap_or(target.service.lease_ms);
            let (principal, passed) = (principal.clone(), Passed { preempts, ..Passed::default() });
            let award = Award { principal, lease_ms, priority, permit, taken: None, passed, task: Some(task.id) };
            acquire::give(ctx, decider, target, award).map(drop)
        }
        Room::Own(_) => Ok(()),
    }
}

fn answer(ctx: &Context<'_>, decider: &Decider, target: &Target, id: u64) -> Result<Bytes, Rejection> {
    let kept = find(ctx, id)?;
    let grant = task_turns::grant_of(ctx, &kept)?.map(|holding| holding.grant);
    let places: Vec<Place> = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    let queued = places.into_iter().find(|place| place.task == Some(id));
    store::json(&Submitted { task: task_list::whole(ctx, kept)?, grant, queued })
}

/// A task that is kept.
///
/// # Errors
/// [`Code::NotFound`].
pub(crate) fn find(ctx: &Context<'_>, id: u64) -> Result<Kept, Rejection> {
    task::find(ctx, id)?.ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("there is no task {id}"))
            .found("no task with this number, or one that ended long ago")
            .wanted("the number of a task")
            .next("ledgerctl task list tells the numbers; the event task tells how older ones ended")
    })
}

/// The running task that the caller reports about, with its service.
fn reported(ctx: &Context<'_>, id: u64) -> Result<Kept, Rejection> {
    let (kept, submitter) = (find(ctx, id)?, ctx.submitter()?);
    let name = service::split(&kept.task.service).0;
    let robot: Option<Robot> = store::read(ctx, &store::robot_key(name))?;
    if submitter.id() != kept.task.submitter && !robot.as_ref().is_some_and(|robot| robot.is(submitter)) {
        return Err(Rejection::new(Code::NotOwner, format!("{} may not report about task {id}", submitter.id()))
            .found(format!("role {} of {}", submitter.role, submitter.organisation))
            .wanted(format!("its submitter {}, or the robot {name} itself", kept.task.submitter))
            .next(format!("ask {}", kept.task.submitter)));
    }
    if task_turns::grant_of(ctx, &kept)?.is_none() {
        return Err(not(&kept, "running", "only a running task makes progress or fails; cancel another one"));
    }
    Ok(kept)
}

fn not(kept: &Kept, wanted: &str, next: &str) -> Rejection {
    let Task { id, state, reason, .. } = &kept.task;
    let why = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    Rejection::new(Code::BadArgument, format!("task {id} is not {wanted}"))
        .found(format!("{state}{why}"))
        .wanted(format!("a task that is {wanted}"))
        .next(next)
}

/// `progress ID REACHED`: so many points of a running task were reached. It uses the grant. With the last point the task is
/// done.
pub(crate) fn progress(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("progress ID REACHED", args, 2, 2)?;
    let before = reported(ctx, args.number(0, "ID")?)?;
    let reached = args.number(1, "REACHED")?;
    let Task { reached: least, total, .. } = before.task;
    if !(least..=total).contains(&reached) {
        return Err(args.bad(1, "REACHED", format!("{reached} of {total} points"), &format!("{least} to {total}")));
    }
    let mut after = before.clone();
    after.task.reached = reached;
    if reached == total {
        task::replace(ctx, &before, &after)?;
        let done = task_turns::conclude(ctx, &after, TaskState::Done, "")?;
        return store::json(&task_list::whole(ctx, done)?);
    }
    if reached > least {
        task::replace(ctx, &before, &after)?;
        task_turns::tell(ctx, &after)?;
    }
    if let Some(holding) = task_turns::grant_of(ctx, &after)? {
        let target = service::resolve(ctx, &after.task.service)?;
        renew::used(ctx, decider, &target, &holding)?;
    }
    store::json(&task_list::whole(ctx, after)?)
}

/// `fail ID REASON`: a running task cannot go on.
pub(crate) fn fail(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("fail ID REASON", args, 2, 2)?;
    let before = reported(ctx, args.number(0, "ID")?)?;
    let failed = task_turns::conclude(ctx, &before, TaskState::Failed, args.text(1, "REASON")?)?;
    store::json(&task_list::whole(ctx, failed)?)
}

/// `cancel ID`: by the submitter, or by an admin of the robot's owner.
pub(crate) fn cancel(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("cancel ID", args, 1, 1)?;
    let before = find(ctx, args.number(0, "ID")?)?;
    let principal = Principal::of(ctx.submitter()?);
    let (id, who) = (before.task.id, principal.id());
    let robot: Option<Robot> = store::read(ctx, &store::robot_key(service::split(&before.task.service).0))?;
    if who != before.task.submitter && !robot.as_ref().is_some_and(|robot| principal.governs(robot)) {
        return Err(Rejection::new(Code::NotOwner, format!("{who} may not cancel task {id}"))
            .found(format!("role {} of {}", principal.role, principal.organisation))
            .wanted(format!("its submitter {}, or an admin of the robot's owner", before.task.submitter))
            .next(format!("ask {}", before.task.submitter)));
    }
    if !before.task.state.known().is_some_and(TaskState::is_open) {
        return Err(not(&before, "open", "nothing needs to be done"));
    }
    let waits = line::of(ctx, &before.task.service, &before.place())?.is_some();
    let cancelled = task_turns::conclude(ctx, &before, TaskState::Cancelled, &format!("by {who}"))?;
    if waits && let Ok(target) = service::resolve(ctx, &before.task.service) {
        line::look_by(ctx, &target.id, ctx.block_time())?;
        queue::tell(ctx, decider, &target)?;
    }
    store::json(&task_list::whole(ctx, cancelled)?)
}
