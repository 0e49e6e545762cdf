//! The grants that are kept: what to renew, and when. Without IO.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

/// A grant is renewed when this part of its lease is over.
const RENEW_AT: u32 = 3;
/// Between two tries to renew one.
const AGAIN: Duration = Duration::from_secs(1);

/// The services that were acquired here.
#[derive(Debug, Default)]
pub(super) struct KeptGrants(BTreeMap<String, State>);

/// A service whose grant is to be renewed.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Due(pub(super) String);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// In line.
    Waiting,
    /// Held, and to be renewed then.
    Held(Instant),
}

impl KeptGrants {
    /// A service was granted.
    pub(super) fn hold(&mut self, service: &str, lease: Duration, now: Instant) {
        self.0.insert(service.to_owned(), State::Held(now + lease / RENEW_AT));
    }

    /// A grant was renewed. If it was given back meanwhile, that changes nothing.
    pub(super) fn renewed(&mut self, service: &str, lease: Duration, now: Instant) {
        if let Some(state) = self.0.get_mut(service) {
            *state = State::Held(now + lease / RENEW_AT);
        }
    }

    /// The turn for a service will come.
    pub(super) fn wait(&mut self, service: &str) {
        self.0.insert(service.to_owned(), State::Waiting);
    }

    /// A grant could not be renewed; does it exist no longer? True if it was kept, and is no longer.
    pub(super) fn failed(&mut self, service: &str, is_gone: bool) -> bool {
        is_gone && self.0.remove(service).is_some()
    }

    /// Nothing is kept any more.
    pub(super) fn forget(&mut self) {
        self.0.clear();
    }

    /// The services that are to be renewed now; `held` are those that the bridge's identity holds.
    pub(super) fn due(&mut self, held: &BTreeSet<String>, now: Instant) -> Vec<Due> {
        let mut due = Vec::new();
        for (service, state) in &mut self.0 {
            let is_due = match state {
                State::Waiting => held.contains(service),
                State::Held(at) => *at <= now,
            };
            if is_due {
                *state = State::Held(now + AGAIN);
                due.push(Due(service.clone()));
            }
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEASE: Duration = Duration::from_secs(9);

    fn due(keeping: &mut KeptGrants, held: &[&str], now: Instant) -> usize {
        keeping.due(&held.iter().map(|service| (*service).to_owned()).collect(), now).len()
    }

    #[test]
    fn a_grant_is_renewed_after_a_third_of_its_lease_until_it_is_given_back() {
        let (mut keeping, start) = (KeptGrants::default(), Instant::now());
        keeping.hold("T/a", LEASE, start);
        assert_eq!(due(&mut keeping, &[], start + Duration::from_millis(2999)), 0);
        assert_eq!(due(&mut keeping, &[], start + Duration::from_secs(3)), 1);
        assert_eq!(due(&mut keeping, &[], start + Duration::from_millis(3500)), 0, "one try at a time");
        keeping.renewed("T/a", LEASE, start + Duration::from_secs(3));
        assert_eq!(due(&mut keeping, &[], start + Duration::from_secs(5)), 0);
        keeping.forget();
        keeping.renewed("T/a", LEASE, start + Duration::from_secs(6));
        assert_eq!(due(&mut keeping, &["T/a"], start + Duration::from_secs(60)), 0);
    }

    #[test]
    fn who_waits_in_line_renews_when_the_turn_has_come() {
        let (mut keeping, start) = (KeptGrants::default(), Instant::now());
        keeping.wait("T/a");
        assert_eq!(due(&mut keeping, &["T/b"], start + Duration::from_secs(60)), 0);
        assert_eq!(due(&mut keeping, &["T/a"], start + Duration::from_secs(61)), 1);
    }

    #[test]
    fn a_grant_that_has_ended_is_not_renewed_again_and_one_that_may_stand_is() {
        let (mut keeping, start) = (KeptGrants::default(), Instant::now());
        keeping.hold("T/a", LEASE, start);
        assert_eq!(due(&mut keeping, &[], start + LEASE), 1);
        assert!(!keeping.failed("T/a", false));
        assert_eq!(due(&mut keeping, &[], start + LEASE + AGAIN), 1);
        assert!(keeping.failed("T/a", true) && !keeping.failed("T/a", true));
        assert_eq!(due(&mut keeping, &[], start + LEASE * 2), 0);
    }
}
