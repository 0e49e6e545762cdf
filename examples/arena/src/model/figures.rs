//! The numbers of a run.

mod error;
mod percentiles;

pub(crate) use error::PathError;
pub(crate) use percentiles::Percentiles;

use crate::model::course::{User, Waypoint};
use crate::model::geometry::wrapped;
use crate::model::record::{Emergency, Record};
use crate::model::robot::{ACCELERATION_MAX, SPEED_MAX};
use serde::Serialize;
use std::collections::BTreeMap;

/// The time (seconds) in which a robot that obeys stands, from its highest speed, with a tenth for the clocks of the simulation.
const BRAKED_WITHIN: f64 = SPEED_MAX / ACCELERATION_MAX + 0.1;

/// A waypoint that was reached.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Arrival {
    /// Which.
    pub waypoint: Waypoint,
    /// When (seconds).
    pub at_s: f64,
    /// How far from it the robot really was, when its user took it for reached (metres).
    pub off_m: f64,
}

/// Turns of the robot.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Yaw {
    /// All turns, either way (radians).
    pub turned_rad: f64,
    /// Those that the planned order of waypoints needs (radians).
    pub needed_rad: f64,
    /// Those beyond it (radians).
    pub extra_rad: f64,
}

/// Commands.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Commands {
    /// Published, by user.
    pub published: BTreeMap<&'static str, usize>,
    /// Received by the robot, by user.
    pub received: BTreeMap<&'static str, usize>,
    /// Received by the robot, a second.
    pub received_hz: f64,
    /// Refused by the ledger, by user and code.
    pub refused: BTreeMap<String, BTreeMap<String, u64>>,
    /// How often the driver changed, as the robot felt it.
    pub changes_of_driver: usize,
    /// Received from somebody whose turn it was not.
    pub strays: usize,
    /// Received after the next driver's first command, or after a stop, and published before it.
    pub late: usize,
}

/// An emergency stop.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Stop {
    /// From asking for it to the stop message at the robot (milliseconds); none if none came.
    pub to_robot_ms: Option<f64>,
    /// How long it lasted (seconds).
    pub seconds: f64,
    /// Commands that the robot received meanwhile.
    pub commands: usize,
    /// How far the robot moved once it had braked (metres).
    pub moved_m: f64,
    /// Its highest speed once it had braked (m/s).
    pub speed_max: f64,
}

/// The numbers of a run.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Figures {
    /// The waypoints in the order in which they were reached.
    pub order: Vec<Waypoint>,
    /// The order that was planned.
    pub planned: Vec<Waypoint>,
    /// When each was reached, and how well.
    pub arrivals: Vec<Arrival>,
    /// Its length (seconds).
    pub seconds: f64,
    /// The way of the robot (metres).
    pub path_m: f64,
    /// Its distance from the references that were active.
    pub path_error_m: PathError,
    /// Its turns.
    pub yaw: Yaw,
    /// The commands.
    pub commands: Commands,
    /// From a command's publication to the robot (milliseconds).
    pub latency_ms: Percentiles,
    /// From the cameras to a controller (milliseconds).
    pub feedback_ms: Percentiles,
    /// The emergency stop, if there was one.
    pub stop: Option<Stop>,
}

impl Figures {
    /// Of a run.
    pub(crate) fn of(record: &Record) -> Self {
        let arrivals = record.reached.iter().map(|reached| Arrival {
            waypoint: reached.waypoint,
            at_s: reached.at,
            off_m: reached.pose.at.distance(record.course.place(reached.waypoint)),
        });
        let way = record.seen.iter().zip(record.seen.iter().skip(1));
        Self {
            order: record.reached.iter().map(|reached| reached.waypoint).collect(),
            planned: record.planned.clone(),
            arrivals: arrivals.collect(),
            seconds: record.seconds(),
            path_m: way.map(|(from, to)| from.pose.at.distance(to.pose.at)).sum(),
            path_error_m: PathError::of(record),
            yaw: yaw(record),
            commands: commands(record),
            latency_ms: Percentiles::of(record.latencies().into_iter().map(|(_, latency)| latency * 1000.0)),
            feedback_ms: Percentiles::of(record.feedback.iter().map(|age| age * 1000.0)),
            stop: record.emergency.map(|emergency| stop(record, emergency)),
        }
    }

    /// Were all waypoints reached in the planned order?
    pub(crate) fn is_in_order(&self) -> bool {
        self.order == self.planned
    }

    /// The order of waypoints in words.
    pub(crate) fn order_in_words(&self) -> String {
        let names: Vec<_> = self.order.iter().map(|waypoint| waypoint.name()).collect();
        if names.is_empty() { "no waypoint".into() } else { names.join(" ") }
    }

    /// All refused commands.
    pub(crate) fn refused(&self) -> u64 {
        self.commands.refused.values().flat_map(BTreeMap::values).sum()
    }
}

fn yaw(record: &Record) -> Yaw {
    let unwrapped = record.unwrapped_yaw();
    let turned = unwrapped.iter().zip(unwrapped.iter().skip(1)).map(|((_, from), (_, to))| (to - from).abs()).sum();
    let start = record.course.start();
    let (mut at, mut yaw, mut needed) = (start.at, start.yaw, 0.0);
    for waypoint in &record.planned {
        let next = record.course.place(*waypoint);
        let heading = at.heading(next);
        needed += wrapped(heading - yaw).abs();
        (at, yaw) = (next, heading);
    }
    Yaw { turned_rad: turned, needed_rad: needed, extra_rad: (turned - needed).max(0.0) }
}

fn commands(record: &Record) -> Commands {
    let of_users: Vec<(User, f64)> =
        record.heard.iter().filter_map(|heard| heard.user.map(|user| (user, heard.at))).collect();
    let mut received = BTreeMap::new();
    for user in User::ALL {
        received.insert(user.name(), of_users.iter().filter(|(of, _)| *of == user).count());
    }
    let between = of_users.first().zip(of_users.last()).map_or(0.0, |((_, first), (_, last))| last - first);
    Commands {
        published: record.published.clone(),
        received,
        received_hz: if between > 0.0 { of_users.len().saturating_sub(1) as f64 / between } else { 0.0 },
        refused: record.refused.clone(),
        changes_of_driver: of_users.iter().zip(of_users.iter().skip(1)).filter(|(a, b)| a.0 != b.0).count(),
        strays: strays(&of_users, &record.drivers),
        late: late(record),
    }
}

/// Commands of somebody whose turn it was not. A turn begins with the next driver's first command. Where nobody decides,
/// everybody has a turn.
fn strays(heard: &[(User, f64)], drivers: &[User]) -> usize {
    let mut turns = drivers.iter().peekable();
    let Some(mut turn) = turns.next() else { return 0 };
    let mut strays = 0;
    for (user, _) in heard {
        if user == turn {
            continue;
        }
        match turns.next_if_eq(&user) {
            Some(next) => turn = next,
            None => strays += 1,
        }
    }
    strays
}

/// Commands that came after the next driver's first one, or after a stop message, and were published before it.
fn late(record: &Record) -> usize {
    if record.drivers.is_empty() {
        return 0;
    }
    let mut late = 0;
    let mut driver = None;
    // From when on nothing older may come, by user.
    let mut ended: BTreeMap<User, f64> = BTreeMap::new();
    let mut emergency = record.emergency;
    for heard in &record.heard {
        let Some(user) = heard.user else {
            // The stop message of the emergency ends everybody's commands. Others come when a driver lets go.
            if emergency.take_if(|emergency| heard.at >= emergency.asked).is_some() {
                ended = User::ALL.into_iter().map(|user| (user, heard.at)).collect();
            }
            continue;
        };
        if driver.is_some_and(|driver| driver != user)
            && let Some(before) = driver
        {
            ended.insert(before, heard.at);
        }
        driver = Some(user);
        let is_late = |published: f64| ended.get(&user).is_some_and(|end| published < *end);
        late += usize::from(heard.published.is_some_and(is_late));
    }
    late
}

fn stop(record: &Record, emergency: Emergency) -> Stop {
    let during = |at: f64| at < emergency.resumed;
    let told =
        record.heard.iter().find(|heard| heard.user.is_none() && heard.at >= emergency.asked && during(heard.at));
    let from = told.map_or(emergency.asked, |heard| heard.at);
    let commands = record.heard.iter().filter(|heard| heard.user.is_some() && heard.at > from && during(heard.at));
    let braked = record.seen.iter().filter(|seen| seen.at >= from + BRAKED_WITHIN && during(seen.at));
    let place = braked.clone().next().map(|seen| seen.pose.at).unwrap_or_default();
    Stop {
        to_robot_ms: told.map(|heard| (heard.at - emergency.asked) * 1000.0),
        seconds: emergency.resumed - emergency.asked,
        commands: commands.count(),
        moved_m: braked.clone().map(|seen| seen.pose.at.distance(place)).fold(0.0, f64::max),
        speed_max: braked.map(|seen| seen.speed).fold(0.0, f64::max),
    }
}

#[cfg(test)]
mod tests;
