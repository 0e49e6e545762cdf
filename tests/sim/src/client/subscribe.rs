//! The wishes of those who read what robots are told, where as many do so as the owner says; and of the owner about that.

use super::Call;
use super::contest::{CONTENDERS, Terms, contender, limited};
use super::fleet::SERVICES;
use crate::history::Asks;
use crate::policy::Policy;
use crate::world::World;

/// The end of the id of the places of a service's readers.
pub(crate) const READERS: &str = ":subscribe";
/// The service whose readers are limited, and their places.
const READ: &str = "Turtlebot4/cmd_vel";
const PLACES: &str = "Turtlebot4/cmd_vel:subscribe";

/// The collection.
const TERMS: [Terms; 6] = [
    limited(r#"{"subscribers":1}"#),
    limited(r#"{"subscribers":2,"publishers":1}"#),
    limited(r#"{"subscribers":1,"publishers":2,"on_conflict":"queue","queue_max":3,"priority":"attribute:rank"}"#),
    limited(r#"{"subscribers":2,"publishers":1,"on_conflict":"queue","queue_max":2,"queue_wait_max_ms":4000}"#),
    limited(r#"{"subscribers":1,"publishers":1,"on_conflict":"preempt","queue_max":3,"priority":"attribute:rank"}"#),
    limited(r#"{"subscribers":2,"publishers":2,"on_conflict":"preempt","priority":"attribute:rank","delegable":true}"#),
];

impl World {
    /// The act of the owner about readers, if there is one.
    pub(super) fn rule_readers(&mut self) -> Option<Call> {
        if !self.plan.tasks || !self.random.contests.percent(40) {
            return None;
        }
        let random = &mut self.random.contests;
        Some(match random.below(12) {
            0 => Call::Put(Policy::Viewers),
            1 => Call::Put(Policy::Blind),
            2 => Call::Remove(Policy::Viewers),
            3 => Call::Remove(Policy::Blind),
            4 => Call::Release { service: PLACES.to_owned() },
            _ => {
                let terms = random.pick(&TERMS).copied().unwrap_or(TERMS[0]);
                Call::Configure { service: READ.to_owned(), terms }
            }
        })
    }

    /// The wish of a user to read, if it has one.
    pub(super) fn subscribe(&mut self, number: usize) -> Option<Call> {
        if !self.plan.tasks || !self.random.contests.percent(60) {
            return None;
        }
        let holds = self.clients[number].grants.get(PLACES).copied();
        let random = &mut self.random.contests;
        let service = PLACES.to_owned();
        Some(match (random.below(100), holds) {
            (0..=44, None) => contender(random, service),
            (45..=49, None) => Call::Acquire { service, lease_ms: None },
            (50..=51, None) => contender(random, format!("Husky/arm{READERS}")),
            (0..=19, Some(_)) => Call::Renew { service },
            (20..=39, Some(_)) => Call::Release { service },
            (40..=44, Some((epoch, seq))) => Call::Set { service, epoch, seq },
            (45..=51, Some(_)) => {
                let to = random.pick(&CONTENDERS).copied().unwrap_or(CONTENDERS[0]);
                Call::Delegate { service, to, for_ms: None, may_delegate: true }
            }
            (52..=55, _) => Call::Recall { service, stop: false },
            (56..=57, _) => Call::Take { service },
            (58..=64, _) => Call::Release { service },
            (65..=69, _) => Call::Read { asks: Asks::Holders, service, linearizable: random.percent(50) },
            (70..=73, _) => {
                let services = vec![service, random.pick(&SERVICES).copied().unwrap_or(READ).to_owned()];
                Call::AcquireAll { services, lease_ms: None, priority: None }
            }
            (74..=91, _) => {
                Call::Read { asks: Asks::MayRead, service: READ.to_owned(), linearizable: random.percent(50) }
            }
            _ => {
                let service = random.pick(&SERVICES).copied().unwrap_or(READ).to_owned();
                Call::Read { asks: Asks::MayRead, service, linearizable: random.percent(50) }
            }
        })
    }
}
