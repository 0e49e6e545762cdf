//! The wishes of holders who pass a service on, and of those who take it back.

use super::Call;
use super::contest::{CONTENDERS, CONTESTED};
use crate::world::World;

impl World {
    /// To pass on a service that a client believes to hold, or to take one back.
    pub(super) fn pass_on(&mut self, number: usize) -> Call {
        let held = &self.clients[number].grants;
        let held: Vec<&str> = CONTESTED.into_iter().filter(|service| held.contains_key(*service)).collect();
        let random = &mut self.random.contests;
        let any = random.pick(&CONTESTED).copied().unwrap_or(CONTESTED[0]);
        let service = random.pick(&held).copied().unwrap_or(any).to_owned();
        // Mallory has no attributes: only some policies permit it. Trudy is trusted by nobody, and has not enrolled.
        let to = match random.below(10) {
            0 => "Org2/Mallory",
            1 => "Org3/Trudy",
            _ => random.pick(&CONTENDERS).copied().unwrap_or(CONTENDERS[0]),
        };
        match random.below(10) {
            0..=5 if !held.is_empty() => {
                let for_ms = random.percent(40).then(|| random.between(50, 6_000));
                Call::Delegate { service, to, for_ms, may_delegate: random.percent(70) }
            }
            6 if !held.is_empty() => Call::HandOver { service, to },
            7..=8 => Call::Recall { service, stop: random.percent(20) },
            _ => Call::Acquire { service, lease_ms: None },
        }
    }
}
