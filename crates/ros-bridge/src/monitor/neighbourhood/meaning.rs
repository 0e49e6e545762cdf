//! The meaning of other endpoints for a route.

use crate::{
    graph::{
        dds::{Neighbour, UNREACHABLE, accepting},
        endpoint::Role,
        mark::Mark,
    },
    routes::{kind::NearbyEndpoint, table::OpenRoute},
};

/// The line to write.
pub(super) enum Line {
    Note(String),
    Warning(String),
}

/// The meaning of an arrival or a departure on its topic for a route.
pub(super) fn meaning(open: &OpenRoute, neighbour: &Neighbour, came: bool) -> Option<Line> {
    let (service, topic, role) = (&open.slot.route.service, open.topic().as_str(), neighbour.role.name());
    let is_same_service = neighbour.mark == Some(open.slot.mark);
    let kind = open.slot.route.kind;
    if neighbour.role != kind.other_end {
        let nearby = NearbyEndpoint { service, topic, is_same_service, is_command: open.is_command() };
        return (kind.nearby)(&nearby).filter(|_| came).map(Line::Warning);
    }
    if !came {
        return Some(Line::Note(format!("a {role} on {topic} has left")));
    }
    Some(if neighbour.type_name != open.dds_type() {
        Line::Warning(format!(
            "a {role} on {topic} has another type: nothing passes until it has the `type` of this route"
        ))
    } else if neighbour.role == Role::Publisher && is_bridge(neighbour, open.slot.mark) {
        Line::Warning(format!(
            "another bridge publishes on {topic} what came from the ledger, and this route takes {topic} to {service}: \
             this would be a circle, so what the bridge publishes is not taken in; give one of both another topic or domain"
        ))
    } else if is_same_service {
        Line::Warning(format!(
            "another bridge takes {topic} to {service}, and this route delivers {service} on {topic}: this would be a \
             circle, so it does not take that in; give one of both another topic or domain"
        ))
    } else if !neighbour.is_reachable {
        Line::Warning(format!("a {role} on {topic} {UNREACHABLE}"))
    } else if let Some(policy) = misfit(open, neighbour) {
        Line::Warning(format!("the qos of a {role} on {topic} does not fit ({policy}): nothing passes"))
    } else {
        Line::Note(format!("a {role} on {topic} has come"))
    })
}

/// The reason for which DDS keeps both apart: a policy, or that one of them alone has keys.
pub(super) fn misfit(open: &OpenRoute, neighbour: &Neighbour) -> Option<String> {
    let qos = *open.slot.qos.borrow();
    if qos.keyed != neighbour.is_keyed() {
        return Some("keys".to_owned());
    }
    if !neighbour.is_strict {
        return None;
    }
    let ours = qos.policies();
    let accepts = accepting(ours.clone());
    let mismatches = match neighbour.role {
        Role::Publisher => neighbour.qos.mismatches(&accepts),
        Role::Subscriber => ours.mismatches(&neighbour.qos),
    };
    mismatches.first().map(|policy| policy.name().to_owned())
}

/// Is it an endpoint of a bridge of this network?
pub(super) fn is_bridge(neighbour: &Neighbour, own: Mark) -> bool {
    neighbour.mark.is_some_and(|mark| mark.is_of_network_of(own))
}
