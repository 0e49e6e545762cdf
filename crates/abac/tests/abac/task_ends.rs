//! Ends of tasks: preemption, deadlines, and whatever takes a submitter, a robot or a grant away.

use crate::fleet::{SECOND, TURTLEBOT, farhad, identity, owner, salma};
use crate::tasks::{TWO, done, is, is_quiet, line, queued, ranked, submit, task, two, with};
use ledger_abac::TaskState;
use ledger_base::rejection::Code;
use ledger_identity::Role;

#[test]
fn a_preempted_task_ends_or_waits_again_and_keeps_its_points() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"preempt","queue_max":8,"priority":"attribute:rank"}}"#);
    let boss = ranked("Boss", "5", 51);
    submit(&mut fleet, &farhad(), TWO);
    fleet.ok(&boss, "acquire", &[TURTLEBOT]);
    assert!(is(&fleet, 1, TaskState::Preempted).contains("higher priority"));
    fleet.ok(&boss, "release", &[TURTLEBOT]);

    submit(&mut fleet, &farhad(), &two(r#""requeue":true"#));
    fleet.ok(&farhad(), "progress", &["2", "1"]);
    let urgent = submit(&mut fleet, &boss, TWO);
    assert_eq!(urgent.task.state, TaskState::Running);
    is(&fleet, 2, TaskState::Waiting);
    fleet.tick();
    assert_eq!(line(&fleet).line[0].task, Some(2));
    done(&mut fleet, &boss, 3);
    fleet.tick();
    is(&fleet, 2, TaskState::Running);
    assert_eq!(task(&fleet, 2).reached, 1);
    done(&mut fleet, &farhad(), 2);
    is_quiet(&fleet);
}

#[test]
fn a_stop_or_a_take_interrupts_a_task_that_waits_again_until_the_robot_is_free() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), &two(r#""requeue":true"#));
    submit(&mut fleet, &farhad(), TWO);
    fleet.ok(&owner(), "stop", &["Turtlebot4", "smoke"]);
    is(&fleet, 1, TaskState::Waiting);
    fleet.refused(&salma(), Code::Stopped, "submit", &[TURTLEBOT, TWO]);
    fleet.tick();
    assert!(line(&fleet).holders.is_empty());
    fleet.ok(&owner(), "resume", &["Turtlebot4"]);
    fleet.tick();
    is(&fleet, 2, TaskState::Running);
    fleet.ok(&owner(), "take", &[TURTLEBOT, "person in the cell"]);
    assert!(is(&fleet, 2, TaskState::Preempted).contains("emergency operator"));
    fleet.ok(&owner(), "release", &[TURTLEBOT]);
    fleet.tick();
    is(&fleet, 1, TaskState::Running);
}

#[test]
fn a_task_whose_grant_ends_ends_with_it() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    is(&fleet, 1, TaskState::Cancelled);
    submit(&mut fleet, &salma(), TWO);
    fleet.ok(&owner(), "release", &[TURTLEBOT]);
    assert!(is(&fleet, 2, TaskState::Failed).contains("revoked the grant"));
    submit(&mut fleet, &salma(), &two(r#""lease_ms":20000"#));
    fleet.time += 19 * SECOND;
    fleet.tick();
    is(&fleet, 3, TaskState::Running);
    fleet.time += SECOND;
    fleet.tick();
    assert_eq!(is(&fleet, 3, TaskState::Failed), "its lease expired");
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    let forbid = r#"permit (principal, action, resource) unless { principal.name == "Salma" };"#;
    fleet.ok(&owner(), "policy", &["put", "p", forbid]);
    assert!(is(&fleet, 4, TaskState::Failed).contains("policies"));
    fleet.tick();
    is(&fleet, 5, TaskState::Running);
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    assert!(is(&fleet, 5, TaskState::Failed).contains("was removed"));
}

#[test]
fn a_deadline_ends_a_task_that_waits_and_one_that_runs() {
    let mut fleet = queued();
    let deadline = fleet.time + 8 * SECOND;
    let soon = two(&format!(r#""deadline":{deadline}"#));
    submit(&mut fleet, &salma(), &soon);
    submit(&mut fleet, &farhad(), &soon);
    submit(&mut fleet, &farhad(), TWO);
    assert_eq!(fleet.next_deadline(), Some(deadline));
    fleet.time = deadline - 2000;
    fleet.tick();
    is(&fleet, 1, TaskState::Running);
    fleet.tick();
    for id in [1, 2] {
        assert_eq!(is(&fleet, id, TaskState::Expired), "its deadline passed");
    }
    is(&fleet, 3, TaskState::Running);
    for bad in [format!(r#""deadline":{}"#, fleet.time), format!(r#""deadline":{0},"not_before":{0}"#, fleet.time * 2)]
    {
        fleet.refused(&salma(), Code::BadArgument, "submit", &[TURTLEBOT, &two(&bad)]);
    }
}

#[test]
fn a_task_that_waits_as_long_as_the_service_allows_expires() {
    let mut fleet = with(r#"{"sharing":{"on_conflict":"queue","queue_wait_max_ms":3000}}"#);
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    fleet.time += 3 * SECOND;
    fleet.tick();
    assert_eq!(is(&fleet, 2, TaskState::Expired), "its waiting time reached the limit of the service");
}

#[test]
fn a_scheduled_task_joins_the_line_at_its_time() {
    let mut fleet = queued();
    let start = fleet.time + 5 * SECOND;
    let later = two(&format!(r#""not_before":{start}"#));
    let scheduled = submit(&mut fleet, &salma(), &later);
    assert_eq!((scheduled.task.state.word(), scheduled.queued, scheduled.grant), ("scheduled", None, None));
    submit(&mut fleet, &farhad(), TWO);
    fleet.tick();
    is(&fleet, 1, TaskState::Scheduled);
    assert_eq!(fleet.next_deadline(), Some(start));
    fleet.time = start;
    fleet.tick();
    is(&fleet, 1, TaskState::Waiting);
    done(&mut fleet, &farhad(), 2);
    fleet.tick();
    is(&fleet, 1, TaskState::Running);
    let never = two(&format!(r#""not_before":{}"#, salma().not_after));
    fleet.refused(&salma(), Code::BadArgument, "submit", &[TURTLEBOT, &never]);
    let past = submit(&mut fleet, &farhad(), &two(r#""not_before":1"#));
    assert_eq!(past.task.state, TaskState::Waiting);
}

#[test]
fn the_tasks_of_a_revoked_certificate_fail() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &salma(), TWO);
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 60 * SECOND));
    submit(&mut fleet, &salma(), &later);
    submit(&mut fleet, &farhad(), TWO);
    fleet.revoke(&salma());
    for id in 1..=3 {
        assert!(is(&fleet, id, TaskState::Failed).contains("revoked"), "{id}");
    }
    fleet.tick();
    is(&fleet, 4, TaskState::Running);
    done(&mut fleet, &farhad(), 4);
    is_quiet(&fleet);
}

#[test]
fn the_tasks_of_an_organisation_that_left_fail() {
    let mut fleet = queued();
    let guest = identity("Org3", "Gast", Role::Member, &[], 70);
    fleet.ok(&owner(), "policy", &["put", "p", "permit (principal, action, resource);"]);
    submit(&mut fleet, &guest, TWO);
    submit(&mut fleet, &guest, TWO);
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 60 * SECOND));
    submit(&mut fleet, &guest, &later);
    submit(&mut fleet, &farhad(), TWO);
    fleet.remove_organisation("Org3");
    for id in 1..=3 {
        is(&fleet, id, TaskState::Failed);
    }
    fleet.tick();
    is(&fleet, 4, TaskState::Running);
}

#[test]
fn the_tasks_of_a_robot_that_was_removed_fail() {
    let mut fleet = queued();
    submit(&mut fleet, &salma(), TWO);
    submit(&mut fleet, &farhad(), TWO);
    let later = two(&format!(r#""not_before":{}"#, fleet.time + 60 * SECOND));
    submit(&mut fleet, &farhad(), &later);
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    fleet.tick();
    for id in 1..=3 {
        assert!(is(&fleet, id, TaskState::Failed).contains("was removed"), "{id}");
    }
    assert_eq!(fleet.next_deadline(), None);
}
