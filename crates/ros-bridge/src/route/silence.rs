//! Why a route is silent, in words for who looks at it.

use std::time::{Duration, Instant};

use ledger_base::rejection::Code;

use super::kind::Kind;
use crate::{count::Live, dds::Neighbour, names::quoted};

/// An event that is not older counts as present.
const RECENT: Duration = Duration::from_secs(2);

/// The known state of a route.
pub(crate) struct Facts<'a> {
    pub(crate) service: &'a str,
    pub(crate) kind: &'static Kind,
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

/// A cause of silence for which each kind of route has its words.
#[derive(Clone, Copy)]
pub(crate) enum Cause<'a> {
    /// Nobody is at the other end in the local graph.
    Alone,
    /// The last message was refused, by this code or rule and in these words.
    Refused {
        name: &'a str,
        line: &'a str,
        /// Is there a grant, or is none needed?
        is_held: bool,
    },
    /// The grant is missing.
    NotHeld,
    /// No message has come yet.
    NothingCame,
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

/// Somebody must repair something.
pub(super) fn fault(name: &'static str, reason: String) -> Silence {
    Silence { name, reason, is_fault: true }
}

/// All is in order.
pub(super) fn pause(name: &'static str, reason: String) -> Silence {
    Silence { name, reason, is_fault: false }
}

/// The words of a route to the ledger: where nobody is there, the beginning of the line of a refusal, and where nothing came.
pub(super) fn of_sending(
    facts: &Facts<'_>,
    cause: Cause<'_>,
    (alone, refused, nothing): (Silence, &str, String),
) -> Silence {
    let acquire = format!("ledgerctl acquire {}", facts.service);
    match cause {
        Cause::Alone => alone,
        Cause::Refused { name, is_held: false, .. } if name == Code::NotHolder.name() => {
            fault("no_grant", format!("refused, because you do not hold it: {acquire}"))
        }
        Cause::Refused { line, .. } => fault("refused", format!("{refused}: {line}")),
        Cause::NotHeld => pause("no_grant", format!("you do not hold it: {acquire}")),
        Cause::NothingCame => pause("no_message", nothing),
    }
}

/// Why nothing passes; none if something does, or if there is just nothing to carry now.
pub(crate) fn silence(facts: &Facts<'_>, now: Instant) -> Option<Silence> {
    let Facts { kind, topic, surroundings, live, .. } = facts;
    let is_recent = |moment: Option<Instant>| moment.is_some_and(|at| now.saturating_duration_since(at) <= RECENT);
    if is_recent(live.passed) {
        return None;
    }
    if let Some(reason) = &live.waiting {
        return Some(fault("waiting", reason.clone()));
    }
    if surroundings.usable == 0 && surroundings.in_memory == 0 {
        let role = kind.other_end.name();
        return Some(if let Some(found) = &surroundings.other_type {
            fault("other_type", format!("the {role} on {topic} has another type: {found}"))
        } else if let Some(policy) = &surroundings.other_qos {
            let reason = format!("the qos of this route and of the {role} on {topic} do not fit together: {policy}");
            fault("other_qos", reason)
        } else {
            (kind.silence)(facts, Cause::Alone)
        });
    }
    let is_held = live.held || !live.needs_grant;
    let cause = if let Some((name, line, _)) = live.refused.as_ref().filter(|(_, _, at)| is_recent(Some(*at))) {
        Cause::Refused { name, line, is_held }
    } else if !is_held {
        Cause::NotHeld
    } else if live.came.is_none() {
        Cause::NothingCame
    } else {
        return None;
    };
    Some((kind.silence)(facts, cause))
}

#[cfg(test)]
mod tests {
    use super::{super::kind::KINDS, *};

    fn name(kind: &'static Kind, surroundings: Surroundings, live: &Live, now: Instant) -> &'static str {
        let facts = Facts { service: "T/cmd_vel", kind, topic: "/cmd_vel", surroundings, live };
        silence(&facts, now).map_or("", |silence| silence.name)
    }

    #[test]
    fn each_state_of_a_route_has_its_reason() {
        let now = Instant::now();
        let [up, down, ..] = KINDS;
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
        let [up, down, ..] = KINDS;
        let some = || Surroundings { usable: 1, ..Surroundings::default() };
        let passed = Live { passed: Some(now), refused: Some(("X", "why".to_owned(), now)), ..Live::default() };
        assert_eq!(name(up, Surroundings::default(), &passed, now), "");
        let came = Live { came: Some(now), ..Live::default() };
        assert_eq!(name(down, some(), &came, now), "");
    }
}
