//! The words for two endpoints that DDS keeps apart because of their quality of service.

use rtps::qos::Policy;

use super::ros_discovery::Role;

/// The change that brings a route's reader together with a writer: a setting of the route, where one decides about the policy.
pub(super) fn for_reader(policy: Policy) -> &'static str {
    remedy(Role::Reads, policy)
}

/// The same for a route's writer and a reader.
pub(super) fn for_writer(policy: Policy) -> &'static str {
    remedy(Role::Writes, policy)
}

fn remedy(ours: Role, policy: Policy) -> &'static str {
    match (policy, ours) {
        (Policy::Reliability, Role::Reads) => "set `qos = { reliability = \"best_effort\" }`",
        (Policy::Durability, Role::Reads) => "set `qos = { durability = \"volatile\" }`",
        (Policy::Reliability, Role::Writes) => "set `qos = { reliability = \"reliable\" }`",
        (Policy::Durability, Role::Writes) => "set `qos = { durability = \"transient_local\" }`",
        _ => "no setting of the route decides about it, so change the other node",
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::config::Config;
    use std::path::Path;

    #[test]
    fn a_route_accepts_the_setting_that_brings_it_together_with_another_node() {
        let route = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\ndirection = 'to_ledger'";
        for policy in [Policy::Reliability, Policy::Durability] {
            for ours in [Role::Reads, Role::Writes] {
                let words = remedy(ours, policy);
                let setting = words.split('`').nth(1).unwrap();
                let config = Config::parse(&format!("{route}\n{setting}"), Path::new(""), |_| ());
                assert!(config.is_ok(), "{setting}: {:?}", config.err());
            }
        }
        assert!(!remedy(Role::Reads, Policy::Deadline).contains('`'), "routes have no deadline");
    }
}
