//! Decides whether a route is silent, and why.

use std::time::{Duration, Instant};

use crate::{
    graph::dds::UNREACHABLE,
    routes::{
        kind::Kind,
        silence::{Cause, Facts, Silence, fault},
    },
};

/// An event that is not older counts as present.
const RECENT: Duration = Duration::from_secs(2);

/// Why nothing passes; none if something does, or if there is just nothing to carry now.
pub(super) fn silence(kind: &Kind, facts: &Facts<'_>, now: Instant) -> Option<Silence> {
    let Facts { topic, other_end, live, .. } = facts;
    let is_recent = |moment: Option<Instant>| moment.is_some_and(|at| now.saturating_duration_since(at) <= RECENT);
    if is_recent(live.passed) {
        return None;
    }
    if let Some(reason) = &live.waiting {
        return Some(fault("waiting", reason.clone()));
    }
    if other_end.usable == 0 && other_end.in_memory == 0 {
        let role = kind.other_end.name();
        return Some(if other_end.unreachable > 0 {
            fault("unreachable", format!("the {role} on {topic} {UNREACHABLE}"))
        } else if let Some(found) = &other_end.other_type {
            fault("other_type", format!("the {role} on {topic} has another type: {found}"))
        } else if let Some(policy) = &other_end.other_qos {
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
    use super::*;
    use crate::routes::{counters::Live, kinds::KINDS, silence::OtherEnd};

    fn name(kind: &'static Kind, other_end: OtherEnd, live: &Live, now: Instant) -> &'static str {
        let facts = Facts { service: "T/cmd_vel", topic: "/cmd_vel", other_end, live };
        silence(kind, &facts, now).map_or("", |silence| silence.name)
    }

    #[test]
    fn each_state_of_a_route_has_its_reason() {
        let now = Instant::now();
        let [up, down, ..] = KINDS;
        let some = || OtherEnd { usable: 1, ..OtherEnd::default() };
        let none = OtherEnd::default;
        let held = || Live { needs_grant: true, held: true, ..Live::default() };
        let not_held = || Live { needs_grant: true, ..Live::default() };
        let refused = |name| Live { refused: Some((name, "why".to_owned(), now)), ..not_held() };
        assert_eq!(name(up, none(), &held(), now), "no_publisher");
        assert_eq!(name(down, none(), &held(), now), "no_subscriber");
        assert_eq!(name(up, OtherEnd { in_memory: 1, ..none() }, &not_held(), now), "no_grant");
        assert_eq!(name(down, some(), &not_held(), now), "no_holder");
        assert_eq!(name(up, OtherEnd { bridges: 1, ..none() }, &held(), now), "only_bridges");
        assert_eq!(name(down, OtherEnd { bridges: 1, ..none() }, &held(), now), "no_subscriber");
        assert_eq!(name(down, OtherEnd { unreachable: 1, ..none() }, &held(), now), "unreachable");
        let other = OtherEnd { other_type: Some("T".to_owned()), ..none() };
        assert_eq!(name(up, other, &held(), now), "other_type");
        let other = OtherEnd { other_qos: Some("Reliability".to_owned()), ..none() };
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
        let some = || OtherEnd { usable: 1, ..OtherEnd::default() };
        let passed = Live { passed: Some(now), refused: Some(("X", "why".to_owned(), now)), ..Live::default() };
        assert_eq!(name(up, OtherEnd::default(), &passed, now), "");
        let came = Live { came: Some(now), ..Live::default() };
        assert_eq!(name(down, some(), &came, now), "");
    }
}
