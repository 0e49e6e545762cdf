//! The endpoints that an own one matches.

use crate::guid::Guid;
use crate::qos::Policy;
use std::collections::{BTreeMap, BTreeSet};

/// The findings of discovery for an own reader or writer. No endpoint both matches and is incompatible.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Matches {
    /// The endpoints that match now.
    pub endpoints: BTreeSet<Guid>,
    /// Those of `endpoints` that are writers whose liveliness has ended: they have not asserted it within their lease.
    pub not_alive: BTreeSet<Guid>,
    /// Endpoints of the topic that are there now and do not match, with the policy that does not fit.
    pub incompatible: BTreeMap<Guid, Policy>,
    /// How many endpoints did not fit so far.
    pub rejected: u64,
}

impl Matches {
    pub(super) fn add(&mut self, other: Guid) {
        self.incompatible.remove(&other);
        self.endpoints.insert(other);
    }

    pub(super) fn reject(&mut self, other: Guid, policy: Policy) {
        self.endpoints.remove(&other);
        self.not_alive.remove(&other);
        if self.incompatible.insert(other, policy).is_none() {
            self.rejected = self.rejected.saturating_add(1);
        }
    }

    pub(super) fn remove(&mut self, other: Guid) {
        self.endpoints.remove(&other);
        self.not_alive.remove(&other);
        self.incompatible.remove(&other);
    }

    /// The liveliness of a writer has ended or begun again.
    pub(super) fn set_alive(&mut self, writer: Guid, is_alive: bool) {
        if is_alive {
            self.not_alive.remove(&writer);
        } else if self.endpoints.contains(&writer) {
            self.not_alive.insert(writer);
        }
    }

    /// An endpoint has gone. Returns whether it was one that did not fit.
    pub(super) fn forget_rejected(&mut self, other: Guid) -> bool {
        self.incompatible.remove(&other).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guid::{EntityId, GuidPrefix};

    #[test]
    fn a_writer_that_is_not_alive_is_one_that_matches() {
        let [writer, other] = [1, 2].map(|key| Guid::new(GuidPrefix([1; 12]), EntityId::writer(key, false)));
        let mut matches = Matches::default();
        matches.add(writer);
        for writer in [writer, other] {
            matches.set_alive(writer, false);
        }
        assert_eq!(matches.not_alive, [writer].into());
        matches.set_alive(writer, true);
        assert!(matches.not_alive.is_empty());
        matches.set_alive(writer, false);
        matches.remove(writer);
        assert_eq!(matches, Matches::default());
    }

    #[test]
    fn an_endpoint_that_did_not_fit_is_counted_once_until_it_goes_or_matches() {
        let other = Guid::new(GuidPrefix([1; 12]), EntityId::reader(1, false));
        let mut matches = Matches::default();
        matches.reject(other, Policy::Durability);
        matches.reject(other, Policy::Reliability);
        assert_eq!((matches.rejected, matches.incompatible.get(&other)), (1, Some(&Policy::Reliability)));
        matches.add(other);
        assert_eq!((matches.incompatible.len(), matches.endpoints.len()), (0, 1));
        matches.reject(other, Policy::Reliability);
        assert!(matches.endpoints.is_empty() && matches.forget_rejected(other) && !matches.forget_rejected(other));
        assert_eq!(matches.rejected, 2);
    }
}
