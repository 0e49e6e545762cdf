//! The word of policies on something that they permit.

use ledger_contract::Limits;
use std::collections::BTreeSet;

/// The annotations of policies on something that they permit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Permit {
    /// The highest `@priority` of those that permit it.
    pub(crate) priority: Option<i64>,
    /// Its limits: of each the strictest. The windows are those of policies that permit it now.
    pub(crate) limits: Limits,
    /// When the last of these windows closes (block time, microseconds); never, if a policy without one permits it.
    pub(crate) closes: Option<u64>,
    /// The ids of the policies that permit it, in order; none under rules that do not tell them.
    pub(crate) policies: Vec<String>,
}

impl Permit {
    /// Another policy permits the same.
    pub(super) fn or(self, other: Self) -> Self {
        let closes = self.closes.zip(other.closes).map(|(one, two)| one.max(two));
        let mut limits = self.limits.and(other.limits);
        if closes.is_none() {
            limits.between.clear();
        }
        let policies = both(self.policies, other.policies);
        Self { priority: self.priority.max(other.priority), limits, closes, policies }
    }

    /// Another use must be permitted as well.
    pub(crate) fn and(self, other: Self) -> Self {
        let closes = self.closes.into_iter().chain(other.closes).min();
        let policies = both(self.policies, other.policies);
        Self { priority: self.priority, limits: self.limits.and(other.limits), closes, policies }
    }
}

/// The ids of two lists, each once and in order.
fn both(one: Vec<String>, other: Vec<String>) -> Vec<String> {
    BTreeSet::from_iter(one.into_iter().chain(other)).into_iter().collect()
}
