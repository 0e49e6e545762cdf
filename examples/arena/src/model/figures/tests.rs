use super::*;
use crate::model::course::{Course, one_after_the_other};
use crate::model::drill;
use crate::model::geometry::{Point, Pose};
use crate::model::record::{Driving, Heard, Reached, Seen};
use crate::model::robot::Command;

fn empty() -> Record {
    Record::new(Course::new(1.0), one_after_the_other(), vec![User::Salma, User::Farhad])
}

fn heard(at: f64, user: Option<User>, published: f64) -> Heard {
    let published = user.map(|_| published);
    Heard { at, user, published, command: Command { linear: 0.1, angular: 0.0 } }
}

#[test]
fn the_distance_is_from_the_line_that_the_driver_has_to_follow_at_that_time() {
    let mut record = empty();
    let salma = Waypoint { user: User::Salma, index: 0 };
    let (start, a1) = (record.course.start().at, record.course.place(salma));
    let a2 = record.course.place(Waypoint { index: 1, ..salma });
    let middle = |a: Point, b: Point| Point { x: (a.x + b.x) / 2.0, y: (a.y + b.y) / 2.0 };
    let at = |at: f64, place: Point| Seen { at, pose: Pose { at: place, yaw: 0.0 }, speed: 0.0 };
    record.seen = vec![at(0.0, start), at(1.0, middle(start, a1)), at(2.0, a1), at(3.0, middle(a1, a2))];
    record.driving = vec![(0.0, Driving::One(User::Salma))];
    record.reached = vec![Reached { at: 2.0, waypoint: salma, pose: Pose { at: a1, yaw: 0.0 } }];
    assert!(Figures::of(&record).path_error_m.max < 1e-9, "on its line all the time");
    // The same places, when the first waypoint was not reached: the last one is beside the line.
    record.reached.clear();
    let error = Figures::of(&record).path_error_m;
    assert!(error.max > 0.5 && error.rms < error.max, "{error:?}");
    // Nobody drives: nothing counts.
    record.driving.clear();
    assert_eq!(Figures::of(&record).path_error_m.max, 0.0);
}

#[test]
fn a_command_out_of_turn_is_a_stray_and_an_old_one_is_late() {
    let (salma, farhad) = (Some(User::Salma), Some(User::Farhad));
    let mut record = empty();
    record.heard =
        vec![heard(1.0, salma, 0.9), heard(2.0, None, 0.0), heard(3.0, farhad, 2.9), heard(4.0, farhad, 3.9)];
    let commands = Figures::of(&record).commands;
    assert_eq!((commands.strays, commands.late, commands.changes_of_driver), (0, 0, 1));
    record.heard.push(heard(5.0, salma, 2.5));
    let commands = Figures::of(&record).commands;
    assert_eq!((commands.strays, commands.late), (1, 1), "published before Farhad drove, and came after it");
    assert_eq!(commands.received["Salma"], 2);
}

#[test]
fn a_command_from_before_the_stop_that_comes_after_it_is_late() {
    let salma = Some(User::Salma);
    let mut record = empty();
    record.emergency = Some(Emergency { asked: 1.5, resumed: 4.0 });
    record.heard = vec![heard(1.0, salma, 0.9), heard(1.6, None, 0.0), heard(5.0, salma, 4.5)];
    assert_eq!(Figures::of(&record).commands.late, 0);
    record.heard.push(heard(5.1, salma, 1.4));
    assert_eq!(Figures::of(&record).commands.late, 1);
    record.heard.insert(2, heard(2.0, salma, 1.9));
    let stop = Figures::of(&record).stop.unwrap();
    assert_eq!(stop.commands, 1, "one came during the stop");
    assert!((stop.to_robot_ms.unwrap() - 100.0).abs() < 1e-6);
}

#[test]
fn turns_beyond_what_the_waypoints_need_are_extra() {
    let drilled = drill::runs();
    let (calm, wild) = (Figures::of(&drilled.controlled).yaw, Figures::of(&drilled.open).yaw);
    assert_eq!(calm.needed_rad, wild.needed_rad);
    assert!((calm.turned_rad - calm.needed_rad).abs() < 1.5, "{calm:?}");
}

#[test]
fn rates_count_commands_of_users_in_each_window() {
    let mut record = drill::runs().controlled;
    let rates = record.received_hz(0.5);
    let steady = rates.iter().filter(|(_, hz)| (hz - 50.0).abs() <= 2.0).count();
    assert!(steady + 3 >= rates.len(), "{rates:?}");
    record.heard.iter_mut().for_each(|heard| heard.user = None);
    assert!(record.received_hz(0.5).iter().all(|(_, hz)| *hz == 0.0), "stop messages are no commands");
}
