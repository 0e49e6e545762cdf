//! The wishes of clients where there are rules for who wins: lines, priorities, limits, emergencies.

use super::Call;
use super::fleet::SERVICES;
use crate::world::World;
use testkit::Random;

/// Every setting of a service's rule.
const KEYS: &str = r#"["publishers","subscribers","on_conflict","queue_max","queue_wait_max_ms","priority","aging_ms","min_hold_ms","idle_release_ms","delegable","confirm","confirm_within_ms"]"#;

/// A choice of an owner for a service: the mode, and the settings of its rule as JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// The mode.
    pub mode: &'static str,
    /// The settings.
    pub sharing: &'static str,
}

const fn exclusive(sharing: &'static str) -> Terms {
    Terms { mode: "exclusive", sharing }
}

pub(super) const fn limited(sharing: &'static str) -> Terms {
    Terms { mode: "limited", sharing }
}

/// The collection.
const TERMS: [Terms; 18] = [
    exclusive("{}"),
    exclusive(r#"{"on_conflict":"queue"}"#),
    exclusive(r#"{"on_conflict":"queue","queue_max":1,"queue_wait_max_ms":4000,"priority":"attribute:rank"}"#),
    exclusive(r#"{"on_conflict":"queue","queue_max":4,"priority":"fixed:5"}"#),
    exclusive(r#"{"on_conflict":"preempt","priority":"attribute:rank"}"#),
    exclusive(r#"{"on_conflict":"preempt","priority":"attribute:rank","queue_max":3,"min_hold_ms":1500}"#),
    exclusive(r#"{"on_conflict":"preempt","priority":"attribute:rank","queue_max":4,"aging_ms":1000}"#),
    exclusive(r#"{"confirm":1}"#),
    exclusive(r#"{"confirm":2,"confirm_within_ms":8000,"on_conflict":"queue","queue_max":2}"#),
    exclusive(r#"{"confirm":1,"on_conflict":"preempt","queue_max":3,"priority":"attribute:rank"}"#),
    exclusive(r#"{"delegable":true}"#),
    exclusive(r#"{"delegable":true,"on_conflict":"queue","queue_max":3}"#),
    exclusive(
        r#"{"delegable":true,"on_conflict":"preempt","priority":"attribute:rank","queue_max":3,"min_hold_ms":1500}"#,
    ),
    limited(r#"{"publishers":2,"delegable":true}"#),
    limited(r#"{"publishers":2,"delegable":true,"on_conflict":"queue","queue_max":2,"priority":"attribute:rank"}"#),
    limited(r#"{"publishers":2}"#),
    limited(r#"{"publishers":2,"on_conflict":"queue","queue_max":2,"priority":"attribute:rank"}"#),
    limited(r#"{"publishers":2,"on_conflict":"preempt","queue_max":2,"priority":"attribute:rank"}"#),
];

/// How many of them, from the first on, are for one holder.
const EXCLUSIVE: usize = 13;

/// The services whose rules change. The arm of the Husky is mostly for everybody.
pub(super) const CONTESTED: [&str; 2] = ["Turtlebot4/cmd_vel", "Husky/cmd_vel"];
/// Those whom others try to confirm.
pub(super) const CONTENDERS: [&str; 4] = ["Org1/Salma", "Org1/Farhad", "Org1/Nina", "Org2/Owen"];
/// The robots, and all of them.
const STOPPED: [&str; 3] = ["Turtlebot4", "Husky", "*"];

impl Terms {
    /// The argument of `configure`: these settings, and no others.
    pub fn json(&self) -> String {
        format!(r#"{{"mode":"{}","sharing":{},"clear":{KEYS}}}"#, self.mode, self.sharing)
    }
}

impl World {
    /// Does a client want something of this kind now?
    pub(super) fn contends(&mut self, percent: u64) -> bool {
        self.plan.contests && self.random.contests.percent(percent)
    }

    /// The act of the owner of the robots about who wins, if there is one.
    pub(super) fn rule_contests(&mut self) -> Option<Call> {
        if !self.contends(if self.plan.tasks { 60 } else { 30 }) {
            return None;
        }
        if let Some(call) = self.rule_readers() {
            return Some(call);
        }
        let random = &mut self.random.contests;
        let robot = random.pick(&STOPPED).copied().unwrap_or("*");
        let service = random.pick(&SERVICES).copied().unwrap_or(SERVICES[0]).to_owned();
        Some(match random.below(20) {
            0..=7 => {
                // At most two hold anything of the Husky but its arm.
                let service = random.pick(&CONTESTED).copied().unwrap_or(CONTESTED[0]);
                let offered = if service == CONTESTED[0] { &TERMS[..] } else { &TERMS[..EXCLUSIVE] };
                let terms = random.pick(offered).copied().unwrap_or(TERMS[0]);
                Call::Configure { service: service.to_owned(), terms }
            }
            8..=9 => Call::Stop { robot },
            10..=15 => Call::Resume { robot: "*" },
            16 => Call::Resume { robot },
            17 => Call::Take { service },
            18 => confirm(random),
            _ => contender(random, service),
        })
    }

    /// The wish of a user for a service where there may be a line, if it has one.
    pub(super) fn contend(&mut self, number: usize) -> Option<Call> {
        if !self.contends(if self.plan.tasks { 75 } else { 35 }) {
            return None;
        }
        if let Some(call) = self.toil(number).or_else(|| self.subscribe(number)) {
            return Some(call);
        }
        if self.random.contests.percent(30) {
            return Some(self.pass_on(number));
        }
        let random = &mut self.random.contests;
        let robot = random.pick(&STOPPED).copied().unwrap_or("*");
        let service = random.pick(&CONTESTED).copied().unwrap_or(CONTESTED[0]).to_owned();
        Some(match random.below(100) {
            0..=1 => Call::Stop { robot },
            2..=3 => Call::Resume { robot },
            4..=5 => Call::Take { service },
            6..=20 => Call::Release { service },
            21..=30 => confirm(random),
            31..=34 => several(random),
            _ => contender(random, service),
        })
    }
}

/// Agrees that somebody may have a service, who perhaps never asked.
fn confirm(random: &mut Random) -> Call {
    let service = random.pick(&CONTESTED).copied().unwrap_or(CONTESTED[0]).to_owned();
    Call::Confirm { service, contender: random.pick(&CONTENDERS).copied().unwrap_or(CONTENDERS[0]) }
}

/// Wants two services at once, or none of them; sometimes one of them twice.
fn several(random: &mut Random) -> Call {
    let mut pick = || random.pick(&SERVICES).copied().unwrap_or(SERVICES[0]).to_owned();
    let services = vec![pick(), pick()];
    let lease_ms = random.percent(20).then(|| random.between(50, 25_000));
    let priority = random.percent(20).then(|| random.below(4) as i64 - 1);
    Call::AcquireAll { services, lease_ms, priority }
}

/// A contender that says how long it waits, and perhaps that it is less urgent.
pub(super) fn contender(random: &mut Random, service: String) -> Call {
    let lease_ms = random.percent(20).then(|| random.between(50, 25_000));
    let wait_ms = random.percent(40).then(|| random.below(6) * 1_000);
    let priority = random.percent(20).then(|| random.below(4) as i64 - 1);
    Call::Contend { service, lease_ms, wait_ms, priority }
}
