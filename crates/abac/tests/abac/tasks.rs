//! Tasks: points for a robot, which wait in line as contenders do and run one after the other.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, admin1, camera, farhad, identity, owner, salma};
use ledger_abac::{
    Acquired, Declaration, Grant, LineState, Reason, Released, Submitted, Task, TaskSpec, TaskState, TaskTold,
};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

pub(crate) const TWO: &str =
    r#"{"points":[{"x_um":1000000,"y_um":0},{"x_um":1000000,"y_um":-2000000,"yaw_urad":1570796}]}"#;

pub(crate) fn with(sharing: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, sharing]);
    fleet
}

pub(crate) fn queued() -> Fleet {
    with(r#"{"sharing":{"on_conflict":"queue"}}"#)
}

/// A task of two points with these other settings.
pub(crate) fn two(more: &str) -> String {
    TWO.replacen('{', &format!("{{{more},"), 1)
}

#[track_caller]
pub(crate) fn submit(fleet: &mut Fleet, who: &Identity, task: &str) -> Submitted {
    fleet.get(who, "submit", &[TURTLEBOT, task])
}

#[track_caller]
pub(crate) fn task(fleet: &Fleet, id: u64) -> Task {
    let answer = fleet.simulate(&owner(), "task", &[id.to_string().into()]).unwrap();
    serde_json::from_slice(&answer).unwrap()
}

#[track_caller]
pub(crate) fn is(fleet: &Fleet, id: u64, state: TaskState) -> String {
    let task = task(fleet, id);
    assert_eq!(task.state, state, "task {id}: {}", task.reason);
    task.reason
}

#[track_caller]
pub(crate) fn done(fleet: &mut Fleet, who: &Identity, id: u64) {
    let done: Task = fleet.get(who, "progress", &[&id.to_string(), "2"]);
    assert_eq!(done.state, TaskState::Done);
}

pub(crate) fn line(fleet: &Fleet) -> LineState {
    serde_json::from_slice(&fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap()).unwrap()
}

fn robot_itself() -> Identity {
    identity("Org2", "Turtlebot4", Role::Robot, &[], 40)
}

pub(crate) fn ranked(name: &str, rank: &str, serial: u8) -> Identity {
    let mut person = identity("Org1", name, Role::Member, &["Turtlebot4"], serial);
    person.attributes.insert("rank".to_owned(), rank.to_owned());
    person
}

/// Nothing in the state but what stands there for ever: no place, no time, no open task.
pub(crate) fn is_quiet(fleet: &Fleet) {
    assert_eq!(fleet.next_deadline(), None);
    assert!(line(fleet).line.is_empty() && line(fleet).holders.is_empty());
}

#[test]
fn tasks_of_two_users_run_in_the_order_of_their_submission() {
    let mut fleet = queued();
    let first = submit(&mut fleet, &salma(), TWO);
    assert_eq!(first.task.state, TaskState::Running);
    assert_eq!((first.task.id, first.task.total, first.task.points.len()), (1, 2, 2));
    let grant = first.grant.unwrap();
    assert_eq!((grant.holder.as_str(), grant.task), ("Org1/Salma", Some(1)));
    let second = submit(&mut fleet, &salma(), TWO);
    assert_eq!((second.task.state.word(), second.queued.unwrap().position), ("waiting", 1));
    let third = submit(&mut fleet, &farhad(), TWO);
    assert_eq!(third.queued.unwrap().position, 2);

    done(&mut fleet, &salma(), 1);
    let released: Released = fleet.newest("released");
    assert_eq!(released.reason, Reason::TaskEnded);
    fleet.tick();
    is(&fleet, 2, TaskState::Running);
    is(&fleet, 3, TaskState::Waiting);
    done(&mut fleet, &salma(), 2);
    fleet.tick();
    is(&fleet, 3, TaskState::Running);
    let grant: Grant = fleet.newest("granted");
    assert_eq!((grant.holder.as_str(), grant.task), ("Org1/Farhad", Some(3)));
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 3, 1);
    done(&mut fleet, &farhad(), 3);
    is_quiet(&fleet);
    let words: Vec<String> = fleet.events.iter().filter(|event| event.name == "task").map(told).collect();
    let wanted =
        ["1 running 0", "2 waiting 0", "3 waiting 0", "1 done 2", "2 running 0", "2 done 2", "3 running 0", "3 done 2"];
    assert_eq!(words, wanted);
}

fn told(event: &ledger_storage::result::Event) -> String {
    assert_eq!(event.subject, TURTLEBOT);
    let told: TaskTold = serde_json::from_slice(&event.payload).unwrap();
    format!("{} {} {}", told.id, told.state, told.reached)
}

#[test]
fn a_higher_priority_goes_first_and_a_task_asks_for_a_lower_one_only() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue","priority":"attribute:rank"}}"#);
    let (low, high) = (ranked("Low", "1", 50), ranked("High", "5", 51));
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &low, &two(r#""priority":9"#));
    submit(&mut fleet, &high, &two(r#""priority":1"#));
    let first = submit(&mut fleet, &high, TWO);
    assert_eq!((first.task.priority, first.queued.unwrap().position), (5, 1));
    assert_eq!(line(&fleet).line.iter().map(|place| place.task).collect::<Vec<_>>(), [Some(4), Some(2), Some(3)]);
    done(&mut fleet, &salma(), 1);
    fleet.tick();
    is(&fleet, 4, TaskState::Running);
}

#[test]
fn a_task_waits_beside_contenders_and_its_submitter_does_not_wait_for_itself() {
    let mut fleet = queued();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    submit(&mut fleet, &salma(), TWO);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    is(&fleet, 1, TaskState::Running);
    let waiting: Vec<_> = line(&fleet).line.into_iter().map(|place| (place.contender, place.task)).collect();
    assert_eq!(waiting, [("Org1/Salma".to_owned(), None), ("Org1/Farhad".to_owned(), None)]);
    done(&mut fleet, &salma(), 1);
    fleet.tick();
    let holders: Vec<_> = line(&fleet).holders.into_iter().map(|grant| (grant.holder, grant.task)).collect();
    assert_eq!(holders, [("Org1/Salma".to_owned(), None)]);

    // She holds the service for herself now: her next task is passed over, and nobody else is.
    let own = submit(&mut fleet, &salma(), TWO);
    assert_eq!(own.task.state, TaskState::Waiting);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(line(&fleet).holders[0].holder, "Org1/Farhad");
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.tick();
    is(&fleet, own.task.id, TaskState::Running);
}

#[test]
fn of_two_places_a_submitter_has_one_and_the_other_goes_to_somebody_else() {
    let mut fleet = with(r#"{"mode":"limited","sharing":{"publishers":2,"on_conflict":"queue"}}"#);
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &salma(), TWO);
    is(&fleet, 2, TaskState::Waiting);
    submit(&mut fleet, &farhad(), TWO);
    is(&fleet, 3, TaskState::Running);
    done(&mut fleet, &salma(), 1);
    fleet.tick();
    is(&fleet, 2, TaskState::Running);
}

#[test]
fn where_nobody_waits_a_task_is_refused_while_the_service_is_held() {
    let mut fleet = Fleet::of_the_paper();
    submit(&mut fleet, &salma(), TWO);
    let refused = fleet.refused(&farhad(), Code::Held, "submit", &[TURTLEBOT, TWO]);
    assert!(refused.message.contains("Org1/Salma"), "{refused}");
    fleet.refused(&salma(), Code::Held, "submit", &[TURTLEBOT, TWO]);
    let soon = two(&format!(r#""not_before":{}"#, fleet.time + SECOND));
    let scheduled = submit(&mut fleet, &farhad(), &soon);
    assert_eq!(scheduled.task.id, 2, "refused tasks use up no number");
    fleet.time += SECOND;
    fleet.tick();
    assert!(is(&fleet, 2, TaskState::Failed).contains("others hold the service"));
    let soon = two(&format!(r#""not_before":{}"#, fleet.time + SECOND));
    let free = submit(&mut fleet, &salma(), &soon);
    done(&mut fleet, &salma(), 1);
    fleet.time += SECOND;
    fleet.tick();
    is(&fleet, free.task.id, TaskState::Running);
}

#[test]
fn submitter_and_robot_report_progress_and_nobody_else_does() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    for other in [farhad(), owner(), admin1(), camera(), identity("Org1", "Turtlebot4", Role::Robot, &[], 41)] {
        fleet.refused(&other, Code::NotOwner, "progress", &["1", "1"]);
        fleet.refused(&other, Code::NotOwner, "fail", &["1", "no"]);
    }
    let before = line(&fleet).holders[0].expires;
    fleet.time += 5 * SECOND;
    let on: Task = fleet.get(&robot_itself(), "progress", &["1", "1"]);
    assert_eq!((on.state.word(), on.reached), ("running", 1));
    assert!(line(&fleet).holders[0].expires > before, "progress uses the grant");
    fleet.refused(&salma(), Code::BadArgument, "progress", &["1", "0"]);
    fleet.refused(&salma(), Code::BadArgument, "progress", &["1", "3"]);
    let events = fleet.events.len();
    fleet.ok(&salma(), "progress", &["1", "1"]);
    assert_eq!(fleet.events.len(), events, "the same progress is told once");
    fleet.ok(&robot_itself(), "fail", &["1", "a wheel is stuck"]);
    assert_eq!(is(&fleet, 1, TaskState::Failed), "a wheel is stuck");
    is_quiet(&fleet);
    fleet.refused(&salma(), Code::BadArgument, "progress", &["1", "2"]);
    fleet.refused(&salma(), Code::NotFound, "progress", &["9", "2"]);
}

#[test]
fn a_waiting_task_makes_no_progress() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    fleet.refused(&farhad(), Code::BadArgument, "progress", &["2", "1"]);
    fleet.refused(&farhad(), Code::BadArgument, "fail", &["2", "no"]);
}

#[test]
fn submitter_and_owner_cancel_a_task_in_every_state() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 60 * SECOND));
    assert_eq!(submit(&mut fleet, &farhad(), &later).task.state, TaskState::Scheduled);
    for other in [salma(), admin1(), robot_itself()] {
        fleet.refused(&other, Code::NotOwner, "cancel", &["2"]);
    }
    fleet.ok(&farhad(), "cancel", &["3"]);
    fleet.ok(&owner(), "cancel", &["2"]);
    fleet.ok(&salma(), "cancel", &["1"]);
    for (id, by) in [(1, "by Org1/Salma"), (2, "by Org2/admin"), (3, "by Org1/Farhad")] {
        assert_eq!(is(&fleet, id, TaskState::Cancelled), by);
    }
    fleet.tick();
    is_quiet(&fleet);
    fleet.refused(&salma(), Code::BadArgument, "cancel", &["1"]);
}

#[test]
fn bad_tasks_are_refused_with_what_was_found_and_wanted() {
    let mut fleet = queued();
    let points = |count: usize| format!(r#"{{"points":[{}]}}"#, vec![r#"{"x_um":1,"y_um":2}"#; count].join(","));
    let one = |point: &str| format!(r#"{{"points":[{point}]}}"#);
    for (task, found, wanted) in [
        (points(0), "0 points", "1 to 1024"),
        (points(1025), "1025 points", "1 to 1024"),
        (points(10_000), "10000 points", "1 to 1024"),
        (one(r#"{"x_um":NaN,"y_um":0}"#), "expected value", "whole numbers"),
        (one(r#"{"x_um":1.5,"y_um":0}"#), "floating point", "whole numbers"),
        (one(r#"{"x_um":1e999,"y_um":0}"#), "out of range", "whole numbers"),
        (one(r#"{"x_um":1000000000001,"y_um":0}"#), "point 1", "1000000000000"),
        (one(r#"{"x_um":0,"y_um":-9223372036854775808}"#), "point 1", "1000000000000"),
        (one(r#"{"x_um":0,"y_um":0,"yaw_urad":6283187}"#), "point 1", "6283186"),
        (one(r#"{"x_um":0,"y_um":0,"z_um":1}"#), "z_um", "x_um"),
        (two(r#""frame":"""#), "\"\"", "a frame of 1 to 128"),
        (two(r#""frame":"my map""#), "my map", "a frame of 1 to 128"),
        (two(r#""lease_ms":1"#), "1 ms", "ms for"),
        ("[]".to_owned(), "invalid", "points"),
        ("{}".to_owned(), "points", "points"),
    ] {
        let refused = fleet.refused(&salma(), Code::BadArgument, "submit", &[TURTLEBOT, &task]);
        assert!(
            refused.found.contains(found) && refused.wanted.contains(wanted),
            "{}: {refused}",
            &task[..60.min(task.len())]
        );
        assert!(!refused.advice().is_empty());
    }
    fleet.refused(&salma(), Code::BadArgument, "submit", &["OptiTrack/poses", TWO]);
    fleet.refused(&farhad(), Code::MissingAttribute, "submit", &[HUSKY, TWO]);
    fleet.refused(&salma(), Code::UnknownRobot, "submit", &["Turtlebot", TWO]);
    assert_eq!(submit(&mut fleet, &salma(), &points(1024)).task.total, 1024);
}

#[test]
fn a_robot_stands_for_its_only_command_service() {
    let mut fleet = queued();
    let first: Submitted = fleet.get(&salma(), "submit", &["Turtlebot4", TWO]);
    assert_eq!(first.task.service, TURTLEBOT);
}

#[test]
fn open_tasks_of_a_certificate_and_places_in_line_are_bounded() {
    let mut fleet = queued();
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 600 * SECOND));
    for _ in 0..64 {
        submit(&mut fleet, &salma(), &later);
    }
    let refused = fleet.refused(&salma(), Code::LimitExceeded, "submit", &[TURTLEBOT, &later]);
    assert!(refused.found.contains("64") && refused.advice().contains("ledgerctl task cancel"), "{refused}");
    fleet.ok(&salma(), "cancel", &["1"]);
    submit(&mut fleet, &salma(), &later);

    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue","queue_max":1}}"#);
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    fleet.refused(&farhad(), Code::LineFull, "submit", &[TURTLEBOT, TWO]);
}

#[test]
fn of_the_tasks_that_ended_the_newest_sixteen_are_kept() {
    let mut fleet = queued();
    for id in 1..=20_u64 {
        submit(&mut fleet, &salma(), TWO);
        done(&mut fleet, &salma(), id);
    }
    fleet.tick();
    fleet.refused(&salma(), Code::NotFound, "task", &["4"]);
    is(&fleet, 5, TaskState::Done);
    let all: Vec<Task> = serde_json::from_slice(&fleet.simulate(&salma(), "tasks", &[]).unwrap()).unwrap();
    assert_eq!(all.iter().map(|task| task.id).collect::<Vec<_>>(), (5..=20).collect::<Vec<_>>());
    assert!(all.iter().all(|task| task.points.is_empty() && task.total == 2));
    let page = fleet.simulate(&salma(), "tasks", &[r#"{"most":2}"#.into()]).unwrap();
    let page: ledger::Page<Task> = serde_json::from_slice(&page).unwrap();
    assert_eq!((page.items.len(), page.next.is_some()), (2, true));
}

#[test]
fn a_declaration_tells_the_next_points_of_the_running_task() {
    let mut fleet = queued();
    fleet.transaction = ledger_base::hash::Hash([1; 32]);
    submit(&mut fleet, &salma(), &two(r#""frame":"odom""#));
    submit(&mut fleet, &farhad(), TWO);
    fleet.ok(&salma(), "progress", &["1", "1"]);
    let declared: Declaration = fleet.get(&camera(), "declare", &["Turtlebot4"]);
    assert_eq!(declared.tasks.len(), 1);
    let running = &declared.tasks[0];
    assert_eq!(
        (running.id, running.service.as_str(), running.frame.as_str(), running.reached),
        (1, TURTLEBOT, "odom", 1)
    );
    let spec: TaskSpec = serde_json::from_str(TWO).unwrap();
    assert_eq!(running.next, spec.points[1..]);
    assert_eq!(spec.frame, "map");
}

#[test]
fn an_interrupted_contender_of_a_task_is_told_by_the_event_task_alone() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    let waits = fleet.get::<Acquired>(&farhad(), "acquire", &[TURTLEBOT]);
    assert!(matches!(waits, Acquired::Queued { queued } if queued.position == 2 && queued.task.is_none()));
    let since = fleet.events.len();
    fleet.ok(&farhad(), "cancel", &["2"]);
    assert_eq!(fleet.told(since), [("task", TURTLEBOT), ("line", TURTLEBOT)]);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    assert!(line(&fleet).line.is_empty());
}

#[test]
fn a_service_whose_contenders_are_confirmed_takes_no_tasks() {
    let mut fleet = queued();
    let later = two(&format!(r#""not_before":{}"#, fleet.time + SECOND));
    submit(&mut fleet, &salma(), &later);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"confirm":1}}"#]);
    let refused = fleet.refused(&salma(), Code::BadArgument, "submit", &[TURTLEBOT, TWO]);
    assert!(refused.found.contains("confirm=1"), "{refused}");
    fleet.time += SECOND;
    fleet.tick();
    assert!(is(&fleet, 1, TaskState::Failed).contains("confirm"));
}
