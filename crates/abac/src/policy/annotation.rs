//! Annotations of policies: what a `permit` says besides that it permits.
//!
//! Known ones only: a misspelt limit that nobody enforces would be worse than none.

use crate::arguments::shown;
use crate::rules::priority;
use cedar_policy::{PolicyId, PolicySet};
use nearest::did_you_mean;

/// The priority of whom the policy permits, `@priority("7")`: for services with `priority=policy`.
const PRIORITY: &str = "priority";
/// Annotations for people.
const FOR_PEOPLE: [&str; 2] = ["id", "description"];

/// Does the set use known annotations only, and these with values that they can have?
pub(super) fn check(policies: &PolicySet) -> Result<(), Vec<String>> {
    let mut faults = Vec::new();
    for (name, value) in policies.policies().flat_map(|policy| policy.annotations()) {
        if name == PRIORITY {
            if priority::parse(value).is_none() {
                let most = priority::PRIORITY_MAX;
                faults.push(format!("@priority({}): wanted a whole number from -{most} to {most}", shown(value)));
            }
        } else if !FOR_PEOPLE.contains(&name) {
            let known = [PRIORITY, FOR_PEOPLE[0], FOR_PEOPLE[1]];
            let near = did_you_mean(name, known, "");
            let near = if near.is_empty() { near } else { format!(" ({near})") };
            faults.push(format!("unknown annotation @{name}{near}; wanted one of @{}", known.join(", @")));
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

/// The priority that a policy gives.
pub(super) fn priority(policies: &PolicySet, id: &PolicyId) -> Option<i64> {
    policies.annotation(id, PRIORITY).and_then(priority::parse)
}
