//! The sentences that must be true of the runs. The demo fails if one of these does not hold.

use crate::model::figures::Figures;
use crate::model::record::Record;
use serde::Serialize;
use std::f64::consts::PI;

/// The turning (radians) beyond what access control needs that is called clearly more: half a turn, and half as much again.
const MORE_TURNS: (f64, f64) = (PI, 1.5);
/// A robot that stands moves less than this (metres): the noise of arithmetic.
const STANDS_WITHIN: f64 = 0.001;

/// The runs of the experiment.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Runs<T> {
    /// With access control, tasks one after the other.
    pub controlled: T,
    /// Without: both drive.
    pub open: T,
    /// With preemption by priority, and an emergency stop.
    pub preempted: T,
    /// As the first, over a link with delay, jitter and loss.
    pub delayed: T,
}

impl<T> Runs<T> {
    /// The runs with their names, in order.
    pub(crate) fn named(&self) -> [(&'static str, &T); 4] {
        [
            ("controlled", &self.controlled),
            ("open", &self.open),
            ("preempted", &self.preempted),
            ("delayed", &self.delayed),
        ]
    }
}

impl Runs<Record> {
    /// The numbers of the runs.
    pub(crate) fn figures(&self) -> Runs<Figures> {
        Runs {
            controlled: Figures::of(&self.controlled),
            open: Figures::of(&self.open),
            preempted: Figures::of(&self.preempted),
            delayed: Figures::of(&self.delayed),
        }
    }
}

/// A sentence about the runs, and whether it holds.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Claim {
    /// The sentence.
    pub claim: &'static str,
    /// Does it hold?
    pub held: bool,
    /// The findings behind it.
    pub found: String,
}

/// Judges the runs.
pub(crate) fn judge(runs: &Runs<Figures>) -> Vec<Claim> {
    let Runs { controlled, open, preempted, delayed } = runs;
    let in_order = |run: &Figures| run.is_in_order();
    vec![
        Claim {
            claim: "with access control the waypoints are reached in the order of the tasks",
            held: in_order(controlled),
            found: controlled.order_in_words(),
        },
        Claim {
            claim: "with access control no command of another user reaches the robot",
            held: drives_alone(controlled),
            found: commands_in_words(controlled),
        },
        Claim {
            claim: "without access control the order breaks, or the robot turns clearly more",
            held: !in_order(open)
                || open.yaw.extra_rad > controlled.yaw.extra_rad + MORE_TURNS.0
                    && open.yaw.turned_rad > controlled.yaw.turned_rad * MORE_TURNS.1,
            found: format!(
                "{}; {:.1} rad of extra turns, and {:.1} with access control",
                open.order_in_words(),
                open.yaw.extra_rad,
                controlled.yaw.extra_rad
            ),
        },
        Claim {
            claim: "with more priority a task goes first, and the other task resumes after it",
            held: in_order(preempted),
            found: preempted.order_in_words(),
        },
        Claim {
            claim: "after a preemption or a stop no older command reaches the robot",
            held: drives_alone(preempted) && preempted.stop.is_some_and(|stop| stop.commands == 0),
            found: format!(
                "{}; {} during the stop",
                commands_in_words(preempted),
                preempted.stop.map_or(0, |stop| stop.commands)
            ),
        },
        Claim {
            claim: "the robot stands during the emergency stop",
            held: preempted.stop.is_some_and(|stop| {
                stop.to_robot_ms.is_some() && stop.moved_m < STANDS_WITHIN && stop.speed_max < STANDS_WITHIN
            }),
            found: match preempted.stop {
                None => "no stop".into(),
                Some(stop) => format!(
                    "{} after it was asked for; moved {:.4} m once it had braked",
                    stop.to_robot_ms.map_or("no stop message".into(), |ms| format!("the stop message {ms:.1} ms")),
                    stop.moved_m
                ),
            },
        },
        Claim {
            claim: "over the delayed link all waypoints are still reached, in order",
            held: in_order(delayed) && drives_alone(delayed),
            found: format!("{}; {}", delayed.order_in_words(), commands_in_words(delayed)),
        },
    ]
}

/// Did every command come from whose turn it was, and both had one?
fn drives_alone(run: &Figures) -> bool {
    run.commands.strays == 0 && run.commands.late == 0 && run.commands.received.values().all(|count| *count > 0)
}

fn commands_in_words(run: &Figures) -> String {
    let received: Vec<_> = run.commands.received.iter().map(|(user, count)| format!("{count} of {user}")).collect();
    let received = received.join(", ");
    format!("received {received}; {} out of turn, {} late", run.commands.strays, run.commands.late)
}

#[cfg(test)]
mod tests;
