use super::*;
use crate::model::course::User;
use crate::model::drill;
use crate::model::record::Heard;
use crate::model::robot::Command;

/// The claims that do not hold, once something was made wrong.
fn broken(spoil: impl FnOnce(&mut Runs<Record>)) -> Vec<&'static str> {
    let mut runs = drill::runs();
    spoil(&mut runs);
    judge(&runs.figures()).into_iter().filter(|claim| !claim.held).map(|claim| claim.claim).collect()
}

/// A command of a user in the middle of a run.
fn slip_in(record: &mut Record, user: User, at: f64) {
    let index = record.heard.iter().position(|heard| heard.at > at).unwrap();
    let command = Command { linear: 0.2, angular: 0.0 };
    record.heard.insert(index, Heard { at, user: Some(user), published: Some(at - 0.01), command });
}

#[test]
fn every_claim_holds_of_runs_as_they_should_be() {
    let claims = judge(&drill::runs().figures());
    assert!(claims.iter().all(|claim| claim.held), "{claims:#?}");
}

#[test]
fn a_waypoint_out_of_order_breaks_the_first_claim() {
    let broken = broken(|runs| runs.controlled.reached.swap(1, 2));
    assert_eq!(broken, ["with access control the waypoints are reached in the order of the tasks"]);
}

#[test]
fn one_command_of_the_other_user_breaks_the_second_claim() {
    let broken = broken(|runs| slip_in(&mut runs.controlled, User::Farhad, 3.0));
    assert_eq!(broken, ["with access control no command of another user reaches the robot"]);
}

#[test]
fn a_calm_run_without_access_control_breaks_the_third_claim() {
    let broken = broken(|runs| runs.open = runs.controlled.clone());
    assert_eq!(broken, ["without access control the order breaks, or the robot turns clearly more"]);
}

#[test]
fn a_preemption_that_never_comes_breaks_its_claim() {
    let broken = broken(|runs| runs.preempted.reached.sort_by_key(|reached| reached.waypoint));
    assert_eq!(broken, ["with more priority a task goes first, and the other task resumes after it"]);
}

#[test]
fn an_old_command_of_who_was_preempted_breaks_its_claim() {
    let broken = broken(|runs| {
        let at = runs.preempted.reached[1].at;
        slip_in(&mut runs.preempted, User::Salma, at);
    });
    assert_eq!(broken, ["after a preemption or a stop no older command reaches the robot"]);
}

#[test]
fn a_command_during_the_stop_breaks_its_claim() {
    let broken = broken(|runs| {
        let at = runs.preempted.emergency.unwrap().asked + 2.0;
        slip_in(&mut runs.preempted, User::Farhad, at);
    });
    assert_eq!(broken, ["after a preemption or a stop no older command reaches the robot"]);
}

#[test]
fn a_robot_that_rolls_on_or_a_stop_that_never_came_breaks_its_claim() {
    let stands = ["the robot stands during the emergency stop"];
    let rolls = broken(|runs| {
        let resumed = runs.preempted.emergency.unwrap().resumed;
        let last = runs.preempted.seen.iter_mut().rev().find(|seen| seen.at < resumed).unwrap();
        last.pose.at.x += 0.01;
    });
    assert_eq!(rolls, stands);
    assert_eq!(broken(|runs| runs.preempted.heard.retain(|heard| heard.user.is_some())), stands);
}

#[test]
fn a_waypoint_that_the_delayed_run_misses_breaks_the_last_claim() {
    let broken = broken(|runs| runs.delayed.reached.truncate(5));
    assert_eq!(broken, ["over the delayed link all waypoints are still reached, in order"]);
}
