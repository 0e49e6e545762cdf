//! The sections `[[route]]`.

use std::ops::RangeInclusive;

use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::{Section, Spot};
use ledger_gate::sample::SAMPLE_BYTES_MAX;

use crate::{
    graph::{
        names::{TopicName, TypeName},
        qos::{AdoptedQos, Qos},
        queue::Limits,
    },
    routes::{
        kind::{CommonSettings, Kind, RouteConfig, SAMPLE_BYTES_RANGE, circle},
        kinds,
    },
};

/// Reads all of them.
pub(super) fn read_all(section: &mut Section<'_, '_>, count: RangeInclusive<usize>) -> Vec<RouteConfig> {
    let mut routes = Vec::new();
    section.sections("route", count, |number, section| {
        if let Some(route) = route(section) {
            routes.push(NumberedRoute { number, spot: section.spot(), route });
        }
    });
    for (spot, fault) in twice(&routes).chain(circles(&routes)) {
        section.refuse(spot, fault);
    }
    routes.into_iter().map(|numbered| numbered.route).collect()
}

/// A route, and where it stands.
struct NumberedRoute {
    /// From 1.
    number: usize,
    spot: Spot,
    route: RouteConfig,
}

/// Pairs of routes, each once.
fn pairs(routes: &[NumberedRoute]) -> impl Iterator<Item = (&NumberedRoute, &NumberedRoute)> {
    routes.iter().enumerate().flat_map(|(at, one)| routes.iter().skip(at + 1).map(move |other| (one, other)))
}

/// Routes that carry the same as one before them.
fn twice(routes: &[NumberedRoute]) -> impl Iterator<Item = (&Spot, Rejection)> {
    let same =
        |one: &RouteConfig, other: &RouteConfig| (&one.service, one.kind.name) == (&other.service, other.kind.name);
    pairs(routes).filter(move |(one, other)| same(&one.route, &other.route)).map(|(one, other)| {
        let (service, numbers) = (&other.route.service, format!("routes {} and {}", one.number, other.number));
        let message = format!("two routes carry {service} in the same direction");
        let fault = Rejection::new(Code::BadConfiguration, message).found(numbers);
        (&other.spot, fault.wanted("each service once per direction").next("remove one of both"))
    })
}

/// Pairs of routes that are a circle by what the configuration alone says.
fn circles(routes: &[NumberedRoute]) -> impl Iterator<Item = (&Spot, Rejection)> {
    let closed = |one: &RouteConfig, other: &RouteConfig| {
        one.service == other.service && one.topic == other.topic && one.kind.takes_in() != other.kind.takes_in()
    };
    pairs(routes).filter(move |(one, other)| closed(&one.route, &other.route)).map(|(one, other)| {
        let topic = one.route.topic.as_ref().map_or("the service's topic", TopicName::as_str);
        let both = [one, other].map(|numbered| (numbered.number, numbered.route.kind));
        (&other.spot, circle(&one.route.service, topic, both))
    })
}

fn route(section: &mut Section<'_, '_>) -> Option<RouteConfig> {
    const SERVICE: &str = "ROBOT/TOPIC in full, e.g. \"Turtlebot4/cmd_vel\"";
    const TYPE: &str = "a ROS 2 type, e.g. \"geometry_msgs/msg/Twist\"";
    let (mut service, mut kind, mut topic, mut message) = (None, None, None, None);
    section.required("service", SERVICE);
    section.text("service", SERVICE, &mut service, |text| {
        let usable = text.split_once('/').is_some_and(|(robot, topic)| !robot.is_empty() && !topic.is_empty());
        usable.then(|| Some(text.to_owned()))
    });
    section.required("direction", &kinds::names());
    section.text("direction", &kinds::names(), &mut kind, |name| kinds::named(name).map(Some));
    section.parsed("topic", "a ROS 2 topic name", &mut topic, |text| TopicName::parse(text).map(Some));
    section.required("type", TYPE);
    section.parsed("type", TYPE, &mut message, |text| TypeName::parse(text).map(Some));
    let (mut qos, mut copied) = (Qos::default(), AdoptedQos::default());
    section.section("qos", |section| copied = qos.read(section));
    let mut sample_bytes_max = Limits::default().sample_bytes_max as u64;
    section.integer("sample_bytes_max", SAMPLE_BYTES_RANGE, &mut sample_bytes_max);
    let sample_bytes_max = usize::try_from(sample_bytes_max).unwrap_or(SAMPLE_BYTES_MAX);
    if let (Some(kind), Some(message)) = (kind, &message)
        && let (Kind { name, carries, .. }, found) = (kind, TypeName::interface(message))
        && found != *carries
    {
        let wanted = format!("a type of the form PACKAGE/{}/NAME for {name:?}", carries.name());
        section.conflict(["direction", "type"], format!("{name:?} and {:?}", message.to_string()), wanted);
    }
    let given = CommonSettings { message: message.as_ref(), sample_bytes_max };
    let plan = kind.map(|kind: &Kind| (kind.read)(section, &given));
    if kind.is_none() {
        kinds::KINDS.iter().for_each(|kind| section.ignore(kind.keys));
    }
    let (service, kind, plan, message) = (service?, kind?, plan?, message?);
    Some(RouteConfig { service, kind, plan, topic, message, qos, copied, sample_bytes_max })
}
