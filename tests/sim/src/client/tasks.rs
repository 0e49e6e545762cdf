//! The wishes of those who have robots go to some points, and of a robot that reports how far it is.

use super::contest::CONTESTED;
use super::{Call, Client};
use crate::clock::SECOND;
use crate::world::{Event, World};
use bytes::Bytes;
use ledger_base::rejection::Code;
use serde::Deserialize;
use serde_json::json;

/// The robot that reports about its tasks.
pub(super) const ROBOT: &str = "Org2/Turtlebot4";
/// How many tasks clients remember.
const REMEMBERED: usize = 12;

/// A task, as clients have heard of it.
#[derive(Clone, Debug, Deserialize)]
pub struct Heard {
    id: u64,
    submitter: String,
    reached: u64,
    total: u64,
}

/// The answer to `submit`.
#[derive(Deserialize)]
struct Submitted {
    task: Heard,
}

impl Call {
    /// Is a task its subject?
    pub(super) fn is_about_tasks(&self) -> bool {
        matches!(self, Self::Submit { .. } | Self::Progress { .. } | Self::Fail { .. } | Self::Cancel { .. })
    }
}

impl World {
    /// A robot reports about its tasks, where there are some.
    pub(super) fn employ_a_robot(&mut self) {
        if self.plan.tasks {
            let number = self.clients.len();
            let gateway = self.random.contests.between(1, self.plan.voters + self.plan.learners);
            self.clients.push(Client::new(ROBOT, gateway));
            self.schedule(SECOND, Event::Client { client: number, attempt: 0 });
        }
    }

    /// The wish of a user about tasks, if it has one.
    pub(super) fn toil(&mut self, number: usize) -> Option<Call> {
        if !self.plan.tasks || !self.random.contests.percent(55) {
            return None;
        }
        let (me, block_time) = (&self.clients[number].person, self.clients[number].ahead + self.now);
        let any: Vec<&Heard> = self.tasks.values().collect();
        let own: Vec<&Heard> = any.iter().copied().filter(|task| task.submitter == *me).collect();
        let random = &mut self.random.contests;
        let chosen = if random.percent(85) { &own } else { &any };
        let task = random.pick(chosen).copied();
        Some(match (random.below(100), task) {
            (0..=69, Some(Heard { id, reached, total, .. })) => {
                // Mostly one more than before; now and then as many, fewer, or more than there are.
                let next = match random.below(12) {
                    0 => *reached,
                    1 => reached.saturating_sub(1),
                    2 => total + random.below(2),
                    _ => reached + 1,
                };
                Call::Progress { id: *id, reached: next }
            }
            (70..=72, Some(Heard { id, .. })) => Call::Fail { id: *id },
            (73..=77, Some(Heard { id, .. })) => Call::Cancel { id: *id },
            (78, _) => Call::Cancel { id: random.below(200) },
            _ => {
                let service = random.pick(&CONTESTED).copied().unwrap_or(CONTESTED[0]).to_owned();
                let points: Vec<_> =
                    (0..=random.below(4)).map(|at| json!({"x_um": at * 1_000_000, "y_um": 0})).collect();
                let not_before = random.percent(25).then(|| block_time + random.below(5 * SECOND));
                let deadline = random.percent(25).then(|| block_time + random.below(12 * SECOND));
                let lease_ms = random.percent(20).then(|| random.between(50, 25_000));
                let priority = random.percent(20).then(|| random.below(4) as i64 - 1);
                let mut task = json!({"points": points, "requeue": random.percent(50)});
                let mut set = |key: &str, value: Option<serde_json::Value>| {
                    value.into_iter().for_each(|value| task[key] = value);
                };
                set("not_before", not_before.map(Into::into));
                set("deadline", deadline.map(Into::into));
                set("lease_ms", lease_ms.map(Into::into));
                set("priority", priority.map(Into::into));
                Call::Submit { service, task: task.to_string() }
            }
        })
    }

    /// The report of the robot about one of its tasks, or of another's.
    pub(super) fn report(&mut self) -> Option<Call> {
        if !self.contends(60) {
            return None;
        }
        let random = &mut self.random.contests;
        if random.percent(2) {
            return Some(Call::Stop { robot: "Turtlebot4" });
        }
        let heard: Vec<&Heard> = self.tasks.values().collect();
        let Heard { id, reached, .. } = random.pick(&heard)?;
        Some(match random.below(20) {
            0 => Call::Fail { id: *id },
            1 => Call::Progress { id: *id, reached: *reached },
            _ => Call::Progress { id: *id, reached: reached + 1 },
        })
    }

    /// A client hears about tasks, and all of them know it.
    pub(super) fn hear_of_tasks(&mut self, code: Code, call: &Call, response: &Bytes) {
        let told: Option<Heard> = match (code, call) {
            (Code::Ok, Call::Submit { .. }) => serde_json::from_slice(response).ok().map(|Submitted { task }| task),
            (Code::Ok, _) => serde_json::from_slice(response).ok(),
            _ => None,
        };
        let is_over =
            |told: &Heard| told.reached == told.total || matches!(call, Call::Fail { .. } | Call::Cancel { .. });
        match (told, call) {
            (Some(told), _) if is_over(&told) => drop(self.tasks.remove(&told.id)),
            (Some(told), _) => drop(self.tasks.insert(told.id, told)),
            (None, Call::Progress { id, .. } | Call::Fail { id } | Call::Cancel { id }) if code == Code::NotFound => {
                self.tasks.remove(id);
            }
            _ => {}
        }
        while self.tasks.len() > REMEMBERED {
            self.tasks.pop_first();
        }
    }
}
