//! Which routes there are to be for the robots on the ledger. Without IO.
//!
//! Names on the ledger may be ones that ROS 2 does not allow: `-` and `.` become `_`. A robot whose name needs no change
//! is never displaced by one whose name does. Of two that only become equal neither is offered: commands for one must
//! not go to the other.
//!
//! Organisations take turns, so that one with many robots leaves room for the others.

use std::collections::{BTreeMap, VecDeque};

use ledger_contract::{Direction, Publishing, RobotAsset, ServiceState};

use super::{
    pattern::PatternLimit,
    settings::{Settings, kinds},
};
use crate::{
    graph::{
        names::{Interface, TopicName, TypeName},
        qos::{AdoptedQos, Qos},
        queue::Limits,
    },
    routes::kind::{DiscoveryTerms, Kind, RouteConfig},
};

/// A service that is to have a route, if its rights permit that.
#[derive(Debug)]
pub(super) struct Candidate {
    organisation: String,
    /// Is the local topic the one that its names say, unchanged?
    is_exact: bool,
    topic: TopicName,
    pub(super) route: RouteConfig,
}

/// A service without a route, and why.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct NotOffered {
    pub(super) service: String,
    pub(super) reason: String,
}

/// The routes that there are to be for these robots, if all rights permit them.
pub(crate) fn offered(settings: &Settings, robots: &[RobotAsset]) -> Vec<RouteConfig> {
    let (found, _) = candidates(settings, robots);
    found.into_iter().map(|candidate| candidate.route).collect()
}

/// The services that are to have routes, in the order in which they get room; and those that cannot.
pub(super) fn candidates(settings: &Settings, robots: &[RobotAsset]) -> (Vec<Candidate>, Vec<NotOffered>) {
    let (mut found, mut left) = (Vec::new(), Vec::new());
    if let Some(own) = settings.robot.as_ref().filter(|own| robots.iter().all(|robot| robot.name != **own)) {
        left.push(NotOffered { service: own.clone(), reason: "no robot of this name is registered".to_owned() });
    }
    let meant = robots.iter().filter(|robot| settings.robot.as_ref().is_none_or(|own| *own == robot.name));
    for service in meant.flat_map(|robot| &robot.services) {
        let Some(kind) = kind_for(settings, service) else { continue };
        match candidate(settings, service, kind) {
            Ok(candidate) => found.push(candidate),
            Err(reason) => left.push(NotOffered { service: service.service.clone(), reason }),
        }
    }
    let (found, displaced) = apart(found);
    left.extend(displaced);
    left.sort();
    (in_turns(found), left)
}

/// The kind of its route; none if there is not to be one.
fn kind_for(settings: &Settings, service: &ServiceState) -> Option<&'static Kind> {
    // A direction that came after this version is not guessed.
    let users_publish = service.direction.known()? == Direction::Command;
    let takes_in = users_publish == settings.robot.is_none();
    let carries = TypeName::parse(&service.type_name).map_or(Interface::Message, |of| of.interface());
    // Replies go with the route of their calls.
    if carries != Interface::Message && !users_publish {
        return None;
    }
    kinds()
        .find(|kind| kind.carries == carries && kind.takes_in() == takes_in && settings.permits(kind, &service.service))
}

fn candidate(settings: &Settings, service: &ServiceState, kind: &'static Kind) -> Result<Candidate, String> {
    let ServiceState { service: id, robot, organisation, topic, type_name, .. } = service;
    let message = TypeName::parse(type_name).map_err(|_| format!("{type_name:?} is no type of ROS 2"))?;
    let (is_exact, topic) = match settings.remap.get(id) {
        Some(topic) => (true, topic.clone()),
        None => {
            let namespace = settings.namespace.as_ref().map_or("", TopicName::as_str);
            let robot = if settings.robot.is_none() { format!("/{robot}") } else { String::new() };
            let text = format!("{namespace}{robot}{topic}");
            let near = TopicName::near(&text)
                .ok_or_else(|| format!("{text:?} is no topic name of ROS 2; give it one in [discover] remap"))?;
            (near.as_str() == text, near)
        }
    };
    let max_rate_hz = PatternLimit::of(&settings.max_rate_hz, id).and_then(|hz| u32::try_from(hz).ok());
    // Without knowing the rule nothing is submitted; and the route says that it does not know it.
    let needs_grant = service.capabilities().map_or(true, |known| known.publishing != Publishing::Policy);
    let is_command = service.direction.known() == Some(Direction::Command);
    let terms = DiscoveryTerms { max_rate_hz, needs_grant, is_command };
    let plan = kind.discovered.map(|plan| plan(&terms)).ok_or("it cannot be discovered")?;
    let bytes = PatternLimit::of(&settings.sample_bytes_max, id).and_then(|bytes| usize::try_from(bytes).ok());
    let route = RouteConfig {
        service: id.clone(),
        kind,
        plan,
        topic: Some(topic.clone()),
        message,
        qos: Qos::default(),
        copied: AdoptedQos::default(),
        sample_bytes_max: bytes.unwrap_or(Limits::default().sample_bytes_max),
    };
    Ok(Candidate { organisation: organisation.clone(), is_exact, topic, route })
}

/// Takes out those that would share a topic with another.
fn apart(found: Vec<Candidate>) -> (Vec<Candidate>, Vec<NotOffered>) {
    let mut by_topic: BTreeMap<TopicName, Vec<Candidate>> = BTreeMap::new();
    for candidate in found {
        by_topic.entry(candidate.topic.clone()).or_default().push(candidate);
    }
    let (mut kept, mut left) = (Vec::new(), Vec::new());
    for (topic, same) in by_topic {
        let names: Vec<String> = same.iter().map(|candidate| candidate.route.service.clone()).collect();
        let exact = same.iter().filter(|candidate| candidate.is_exact).count();
        let only = same.len() == 1;
        for candidate in same {
            if only || (candidate.is_exact && exact == 1) {
                kept.push(candidate);
            } else {
                let reason = format!("{} would share the topic {topic}; use [discover] remap", names.join(" and "));
                left.push(NotOffered { service: candidate.route.service, reason });
            }
        }
    }
    (kept, left)
}

/// One of each organisation in turn, each in the order of its services' ids.
fn in_turns(found: Vec<Candidate>) -> Vec<Candidate> {
    let mut by_organisation: BTreeMap<String, Vec<Candidate>> = BTreeMap::new();
    for candidate in found {
        by_organisation.entry(candidate.organisation.clone()).or_default().push(candidate);
    }
    let mut lines: VecDeque<VecDeque<Candidate>> = VecDeque::new();
    for mut candidates in by_organisation.into_values() {
        candidates.sort_by(|one, other| one.route.service.cmp(&other.route.service));
        lines.push_back(candidates.into());
    }
    let mut all = Vec::new();
    while let Some(mut line) = lines.pop_front() {
        if let Some(next) = line.pop_front() {
            all.push(next);
            lines.push_back(line);
        }
    }
    all
}
