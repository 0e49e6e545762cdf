//! How far the robot was from the reference that was active at that time.

use crate::model::course::{User, WAYPOINTS, Waypoint};
use crate::model::geometry::Point;
use crate::model::record::Record;
use serde::Serialize;

/// Distances from the active reference (metres).
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct PathError {
    /// Root of the mean of the squares.
    pub rms: f64,
    /// The largest.
    pub max: f64,
}

/// The straight line that a driver has to follow for a while.
#[derive(Clone, Copy, Debug)]
struct Reference {
    from_time: f64,
    to_time: f64,
    from: Point,
    to: Point,
}

/// A change of a user's reference.
#[derive(Clone, Copy, Debug)]
enum Change {
    Begins,
    Ends,
    Reached,
}

impl PathError {
    /// Of a run. A driver's reference begins where the robot is when the driver gets it, and then goes from waypoint to
    /// waypoint. Where both drive, the nearer reference counts. While nobody drives nothing counts.
    pub(crate) fn of(record: &Record) -> Self {
        let references: Vec<_> = User::ALL.into_iter().flat_map(|user| references(record, user)).collect();
        let (mut squares, mut count, mut max) = (0.0, 0_usize, 0.0_f64);
        for seen in &record.seen {
            let active = references.iter().filter(|line| (line.from_time..line.to_time).contains(&seen.at));
            let nearest =
                active.map(|line| seen.pose.at.distance_to_line(line.from, line.to)).fold(f64::INFINITY, f64::min);
            if nearest.is_finite() {
                squares += nearest * nearest;
                count += 1;
                max = max.max(nearest);
            }
        }
        Self { rms: if count > 0 { (squares / count as f64).sqrt() } else { 0.0 }, max }
    }
}

fn references(record: &Record, user: User) -> Vec<Reference> {
    let mut driven = false;
    let turns = record.driving.iter().filter_map(|(at, driving)| {
        let drives = driving.includes(user);
        let changed = drives != driven;
        driven = drives;
        changed.then_some((*at, if drives { Change::Begins } else { Change::Ends }))
    });
    let mut changes: Vec<(f64, Change)> = turns.collect();
    let own = record.reached.iter().filter(|reached| reached.waypoint.user == user);
    changes.extend(own.map(|reached| (reached.at, Change::Reached)));
    changes.sort_by(|a, b| a.0.total_cmp(&b.0));

    let mut references: Vec<Reference> = Vec::new();
    let (mut next, mut active) = (0, false);
    for (at, change) in changes {
        if active && let Some(last) = references.last_mut() {
            last.to_time = at;
        }
        let from = match change {
            Change::Begins => {
                active = true;
                place(record, at)
            }
            Change::Ends => {
                active = false;
                continue;
            }
            Change::Reached => {
                next += 1;
                record.course.place(Waypoint { user, index: next - 1 })
            }
        };
        if next >= WAYPOINTS {
            active = false;
        }
        if active {
            let to = record.course.place(Waypoint { user, index: next });
            references.push(Reference { from_time: at, to_time: f64::INFINITY, from, to });
        }
    }
    references
}

/// Where the robot was.
fn place(record: &Record, at: f64) -> Point {
    let after = record.seen.iter().find(|seen| seen.at >= at).or(record.seen.last());
    after.map_or(record.course.start().at, |seen| seen.pose.at)
}
