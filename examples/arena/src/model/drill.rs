//! Whole runs in simulated time, for tests: robot, controllers and delays, and somebody who decides whose commands pass.

use crate::model::controller::{Controller, HZ};
use crate::model::course::{Course, User, WAYPOINTS, Waypoint, interrupted, one_after_the_other};
use crate::model::link::{Direction, Link};
use crate::model::noise::Noise;
use crate::model::record::{Driving, Emergency, Heard, Reached, Record, Seen};
use crate::model::robot::{Command, Turtlebot};
use crate::model::{claims::Runs, course};
use std::collections::VecDeque;

const CAMERA_HZ: u32 = 120;
const FAST: Link = Link { delay: 0.001, jitter: 0.0, loss: 0.0 };

/// A message under way.
struct Sent<T> {
    due: f64,
    sent: f64,
    what: T,
}

/// Takes what has arrived.
fn arrived<T>(way: &mut VecDeque<Sent<T>>, now: f64) -> Vec<Sent<T>> {
    let mut arrived = Vec::new();
    while way.front().is_some_and(|sent| sent.due <= now) {
        arrived.extend(way.pop_front());
    }
    arrived
}

/// How a run goes: who may drive, by what was reached and the time.
pub(crate) struct Plan {
    pub(crate) planned: Vec<Waypoint>,
    pub(crate) drivers: Vec<User>,
    pub(crate) link: Link,
    pub(crate) scale: f64,
    pub(crate) seconds_max: f64,
    pub(crate) stop_after: Option<Waypoint>,
    pub(crate) driving: fn(&[Reached]) -> Driving,
}

pub(crate) fn in_turns(reached: &[Reached]) -> Driving {
    Driving::One(if reached.len() < WAYPOINTS { User::Salma } else { User::Farhad })
}

pub(crate) fn run(plan: &Plan) -> Record {
    let course = Course::new(plan.scale);
    let mut record = Record::new(course, plan.planned.clone(), plan.drivers.clone());
    let mut robot = Turtlebot::new(course.start()).with_tyres(1.004, 0.997);
    let mut controllers = User::ALL.map(|user| (user, Controller::new(course.waypoints(user))));
    let direction = |name: &str| Direction::new(plan.link, Noise::named(1, name));
    let mut feedback_ways = [direction("poses to Salma"), direction("poses to Farhad")];
    let mut command_ways = [direction("Salma"), direction("Farhad")];
    let mut camera_way = direction("camera");
    let mut robot_way = direction("robot");
    let mut poses = [VecDeque::new(), VecDeque::new()];
    let mut commands = VecDeque::new();
    let mut driving = Driving::Nobody;
    let mut stop_at = None;
    for tick in 0..(plan.seconds_max * 600.0) as u32 {
        let now = f64::from(tick) / 600.0;
        if tick % (600 / CAMERA_HZ) == 0 {
            robot.advance(now);
            record.seen.push(Seen { at: now, pose: robot.pose(), speed: robot.speed() });
            let at_ledger = camera_way.deliver(now);
            for (way, poses) in feedback_ways.iter_mut().zip(&mut poses) {
                poses.push_back(Sent { due: way.deliver(at_ledger), sent: now, what: robot.pose() });
            }
        }
        for ((user, controller), poses) in controllers.iter_mut().zip(&mut poses) {
            for pose in arrived(poses, now) {
                record.feedback.push(now - pose.sent);
                if let Some(index) = controller.hear(now, pose.sent, pose.what) {
                    let waypoint = Waypoint { user: *user, index };
                    record.reached.push(Reached { at: now, waypoint, pose: robot.pose() });
                    if plan.stop_after == Some(waypoint) {
                        stop_at = Some(now + 1.0);
                    }
                }
            }
        }
        // The emergency lasts three seconds.
        let stopped = stop_at.is_some_and(|at| (at..at + 3.0).contains(&now));
        if let Some(at) = stop_at.filter(|at| now >= *at && record.emergency.is_none()) {
            record.emergency = Some(Emergency { asked: at, resumed: at + 3.0 });
            record.heard.push(Heard { at: now, user: None, published: None, command: Command::STOP });
            robot.command(now, Command::STOP);
        }
        let may = if stopped { Driving::Nobody } else { (plan.driving)(&record.reached) };
        if may != driving {
            record.driving.push((now, may));
            driving = may;
        }
        // The second task is given when the first waypoint is reached.
        let second = !record.reached.is_empty();
        for (((user, controller), way), beat) in controllers.iter().zip(&mut command_ways).zip([0, 5]) {
            if tick % (600 / HZ) == beat && !controller.is_done() && (*user == User::Salma || second) {
                *record.published.entry(user.name()).or_default() += 1;
                let due = robot_way.deliver(way.deliver(now));
                commands.push_back(Sent { due, sent: now, what: (*user, controller.command(now)) });
            }
        }
        for command in arrived(&mut commands, now) {
            let (user, what) = command.what;
            if driving.includes(user) {
                record.heard.push(Heard { at: now, user: Some(user), published: Some(command.sent), command: what });
                robot.command(now, what);
            }
        }
        if controllers.iter().all(|(_, controller)| controller.is_done()) {
            break;
        }
    }
    record.driving.push((record.seconds(), Driving::Nobody));
    record
}

/// With access control over a link.
pub(crate) fn controlled(link: Link, scale: f64) -> Record {
    run(&Plan {
        planned: one_after_the_other(),
        drivers: vec![User::Salma, User::Farhad],
        link,
        scale,
        seconds_max: 90.0,
        stop_after: None,
        driving: in_turns,
    })
}

/// All runs.
pub(crate) fn runs() -> Runs<Record> {
    let in_order = one_after_the_other();
    let open = Plan {
        planned: in_order,
        drivers: vec![],
        link: FAST,
        scale: 1.0,
        seconds_max: 40.0,
        stop_after: None,
        driving: |_| Driving::Both,
    };
    let b1 = Waypoint { user: User::Farhad, index: 0 };
    let preempted = Plan {
        planned: interrupted(),
        drivers: vec![User::Salma, User::Farhad, User::Salma],
        link: FAST,
        scale: 1.0,
        seconds_max: 90.0,
        stop_after: Some(b1),
        driving: |reached| match reached.len() {
            1..4 => Driving::One(User::Farhad),
            _ => Driving::One(User::Salma),
        },
    };
    Runs {
        controlled: controlled(FAST, 1.0),
        open: run(&open),
        preempted: run(&preempted),
        delayed: controlled(Link::PAPER, 1.0),
    }
}

#[test]
fn with_access_control_all_waypoints_are_reached_in_order_at_every_scale_and_over_every_link() {
    for (link, scale) in [
        (FAST, 1.0),
        (FAST, course::SCALE_MIN),
        (Link::WIFI, 1.0),
        (Link::PAPER, 1.0),
        (Link::PAPER, course::SCALE_MIN),
    ] {
        let record = controlled(link, scale);
        let order: Vec<_> = record.reached.iter().map(|reached| reached.waypoint).collect();
        assert_eq!(order, one_after_the_other(), "{link:?} at scale {scale}, after {:.1} s", record.seconds());
    }
}
