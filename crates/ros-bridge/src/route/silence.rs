//! Why a route is silent, in words for who looks at it.

use std::time::{Duration, Instant};

use crate::{
    config::Direction,
    count::Live,
    dds::{Neighbour, Role},
    names::quoted,
};

/// An event that is not older counts as present.
const RECENT: Duration = Duration::from_secs(2);

/// The known state of a route.
pub(crate) struct Facts<'a> {
    pub(crate) service: &'a str,
    pub(crate) direction: Direction,
    /// The local topic, `/cmd_vel`.
    pub(crate) topic: &'a str,
    pub(crate) surroundings: Surroundings,
    pub(crate) live: &'a Live,
}

/// The other end of a route, in the local graph.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(crate) struct Surroundings {
    /// Publishers or subscribers that this route is, or will be, connected with. Not counting bridges of this network.
    pub(crate) usable: usize,
    /// Bridges of this network at the other end: they take nothing in.
    pub(crate) bridges: usize,
    /// The type of one that has another.
    pub(crate) other_type: Option<String>,
    /// The policy of one with which ours do not fit together.
    pub(crate) other_qos: Option<String>,
    /// Those in shared memory, without our own.
    pub(crate) in_memory: usize,
}

/// A reason for silence.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Silence {
    /// For programs; the same reason has the same name.
    pub(crate) name: &'static str,
    /// For people.
    pub(crate) reason: String,
    /// Must somebody repair something?
    pub(crate) is_fault: bool,
}

impl Surroundings {
    /// Counts an endpoint on the topic of a route.
    pub(crate) fn add(&mut self, neighbour: &Neighbour, wanted_type: &str, misfit: Option<String>, is_bridge: bool) {
        if neighbour.type_name != wanted_type {
            self.other_type = Some(quoted(&neighbour.type_name));
        } else if is_bridge {
            self.bridges += 1;
        } else if let Some(policy) = misfit {
            self.other_qos = Some(policy);
        } else {
            self.usable += 1;
        }
    }
}

fn fault(name: &'static str, reason: String) -> Option<Silence> {
    Some(Silence { name, reason, is_fault: true })
}

fn pause(name: &'static str, reason: String) -> Option<Silence> {
    Some(Silence { name, reason, is_fault: false })
}

/// Why nothing passes; none if something does, or if there is just nothing to carry now.
pub(crate) fn silence(facts: &Facts<'_>, now: Instant) -> Option<Silence> {
    let Facts { service, direction, topic, surroundings, live } = facts;
    let is_recent = |moment: Option<Instant>| moment.is_some_and(|at| now.saturating_duration_since(at) <= RECENT);
    if is_recent(live.passed) {
        return None;
    }
    if let Some(reason) = &live.waiting {
        return fault("waiting", reason.clone());
    }
    let to_ledger = *direction == Direction::ToLedger;
    if surroundings.usable == 0 && surroundings.in_memory == 0 {
        let role = if to_ledger { Role::Publisher } else { Role::Subscriber }.name();
        if let Some(found) = &surroundings.other_type {
            return fault("other_type", format!("the {role} on {topic} has another type: {found}"));
        }
        if let Some(policy) = &surroundings.other_qos {
            let reason = format!("the qos of this route and of the {role} on {topic} do not fit together: {policy}");
            return fault("other_qos", reason);
        }
        if to_ledger && surroundings.bridges > 0 {
            let reason = format!("only a bridge publishes on {topic}, and what came from the ledger is not taken in");
            return fault("only_bridges", reason);
        }
        return if to_ledger {
            pause("no_publisher", format!("nobody publishes on {topic}"))
        } else {
            pause("no_subscriber", format!("nobody subscribes to {topic}"))
        };
    }
    let no_grant = live.needs_grant && !live.held;
    if let Some((name, line, _)) = live.refused.as_ref().filter(|(_, _, at)| is_recent(Some(*at))) {
        return if !to_ledger {
            fault("gate", format!("the gate lets nothing pass: {line}"))
        } else if no_grant && *name == ledger_rejection::Code::NotHolder.name() {
            fault("no_grant", format!("refused, because you do not hold it: ledgerctl acquire {service}"))
        } else {
            fault("refused", format!("the ledger refuses: {line}"))
        };
    }
    if no_grant {
        return if to_ledger {
            pause("no_grant", format!("you do not hold it: ledgerctl acquire {service}"))
        } else {
            pause("no_holder", format!("nobody holds {service}"))
        };
    }
    match (live.came, to_ledger) {
        (Some(_), _) => None,
        (None, true) => pause("no_message", format!("the publisher on {topic} has sent nothing yet")),
        (None, false) => pause("no_message", "nothing has come from the ledger yet".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(direction: Direction, surroundings: Surroundings, live: &Live, now: Instant) -> &'static str {
        let facts = Facts { service: "T/cmd_vel", direction, topic: "/cmd_vel", surroundings, live };
        silence(&facts, now).map_or("", |silence| silence.name)
    }

    #[test]
    fn each_state_of_a_route_has_its_reason() {
        let now = Instant::now();
        let (up, down) = (Direction::ToLedger, Direction::FromLedger);
        let some = || Surroundings { usable: 1, ..Surroundings::default() };
        let none = Surroundings::default;
        let held = || Live { needs_grant: true, held: true, ..Live::default() };
        let not_held = || Live { needs_grant: true, ..Live::default() };
        let refused = |name| Live { refused: Some((name, "why".to_owned(), now)), ..not_held() };
        assert_eq!(name(up, none(), &held(), now), "no_publisher");
        assert_eq!(name(down, none(), &held(), now), "no_subscriber");
        assert_eq!(name(up, Surroundings { in_memory: 1, ..none() }, &not_held(), now), "no_grant");
        assert_eq!(name(down, some(), &not_held(), now), "no_holder");
        assert_eq!(name(up, Surroundings { bridges: 1, ..none() }, &held(), now), "only_bridges");
        assert_eq!(name(down, Surroundings { bridges: 1, ..none() }, &held(), now), "no_subscriber");
        let other = Surroundings { other_type: Some("T".to_owned()), ..none() };
        assert_eq!(name(up, other, &held(), now), "other_type");
        let other = Surroundings { other_qos: Some("Reliability".to_owned()), ..none() };
        assert_eq!(name(down, other, &held(), now), "other_qos");
        assert_eq!(name(up, some(), &refused("NOT_HOLDER"), now), "no_grant");
        assert_eq!(name(up, some(), &refused("OVERLOADED"), now), "refused");
        assert_eq!(name(down, some(), &refused("too_old"), now), "gate");
        assert_eq!(name(up, some(), &held(), now), "no_message");
        assert_eq!(name(down, none(), &Live { waiting: Some("x".to_owned()), ..held() }, now), "waiting");
    }

    #[test]
    fn who_carries_messages_or_has_carried_some_and_has_none_now_is_not_silent() {
        let now = Instant::now();
        let some = || Surroundings { usable: 1, ..Surroundings::default() };
        let passed = Live { passed: Some(now), refused: Some(("X", "why".to_owned(), now)), ..Live::default() };
        assert_eq!(name(Direction::ToLedger, Surroundings::default(), &passed, now), "");
        let came = Live { came: Some(now), ..Live::default() };
        assert_eq!(name(Direction::FromLedger, some(), &came, now), "");
    }
}
