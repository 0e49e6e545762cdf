//! The settings `[discover]`.

use std::{collections::BTreeMap, ops::RangeInclusive};

use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;

use super::pattern::{Pattern, PatternLimit};
use crate::{
    graph::names::TopicName,
    routes::{
        kind::{Kind, SAMPLE_BYTES_RANGE},
        kinds::KINDS,
        pace::RATE_HZ_MAX,
    },
};

/// Most expressions of one list.
const PATTERNS_MAX: usize = 64;
/// Most lines of `remap`.
const REMAPS_MAX: usize = 256;

/// The settings `[discover]`.
#[derive(Debug, Clone, Default)]
pub(crate) struct Settings {
    /// The robot on whose side the bridge is; none = on a user's.
    pub(crate) robot: Option<String>,
    /// Before every topic.
    pub(super) namespace: Option<TopicName>,
    /// By kind of route: only these services; a kind that is not named has all.
    pub(super) allow: BTreeMap<&'static str, Vec<Pattern>>,
    /// By kind of route: not these.
    pub(super) deny: BTreeMap<&'static str, Vec<Pattern>>,
    /// LocalGraph topics by service.
    pub(super) remap: BTreeMap<String, TopicName>,
    pub(super) max_rate_hz: Vec<PatternLimit>,
    pub(super) sample_bytes_max: Vec<PatternLimit>,
}

impl Settings {
    pub(crate) fn read(section: &mut Section<'_, '_>) -> Self {
        let mut settings = Self::default();
        section.text("robot", "the name of a robot", &mut settings.robot, |name| {
            let usable = !name.is_empty() && !name.contains('/');
            usable.then(|| Some(name.to_owned()))
        });
        section.parsed("namespace", "a ROS 2 namespace such as \"/fleet\"", &mut settings.namespace, |text| {
            // ROS 2 writes no namespace as the root.
            if text == "/" { Ok(None) } else { TopicName::parse(text).map(Some) }
        });
        for (name, lists) in [("allow", &mut settings.allow), ("deny", &mut settings.deny)] {
            section.section(name, |section| {
                for kind in kinds() {
                    let patterns = section.texts(kind.name, PATTERNS_MAX, Pattern::parse);
                    lists.extend(patterns.map(|patterns| (kind.name, patterns)));
                }
            });
        }
        settings.read_remap(section);
        let mut limits = |name, range: RangeInclusive<u64>| {
            section.texts(name, PATTERNS_MAX, |text| PatternLimit::parse(text, range.clone())).unwrap_or_default()
        };
        settings.max_rate_hz = limits("max_rate_hz", 1..=RATE_HZ_MAX);
        settings.sample_bytes_max = limits("sample_bytes_max", SAMPLE_BYTES_RANGE);
        settings
    }

    /// Two services on one topic, or one of another robot, are faults here.
    fn read_remap(&mut self, section: &mut Section<'_, '_>) {
        let entries = section.entries("remap", REMAPS_MAX, |service, topic| {
            let usable = service.split_once('/').is_some_and(|(robot, topic)| !robot.is_empty() && !topic.is_empty());
            if !usable {
                return Err(Rejection::new(Code::BadName, "this names no service")
                    .found(format!("{service:?}"))
                    .wanted("ROBOT/TOPIC in full, e.g. \"Turtlebot4/cmd_vel\""));
            }
            Ok((service.to_owned(), TopicName::parse(topic)?))
        });
        for (spot, (service, topic)) in entries {
            let robot = service.split('/').next().unwrap_or_default();
            if let Some(own) = self.robot.as_ref().filter(|own| *own != robot) {
                let rejection = Rejection::new(
                    Code::BadConfiguration,
                    format!("discover.remap.{service:?} does not fit discover.robot"),
                );
                let found = format!("a service of {robot} on the side of {own}");
                section.refuse(&spot, rejection.found(found).wanted(format!("services of {own}")));
            }
            if let Some((other, _)) = self.remap.iter().find(|(_, taken)| **taken == topic) {
                let message = format!("discover.remap.{service:?} does not fit discover.remap.{other:?}");
                let rejection = Rejection::new(Code::BadConfiguration, message).found(format!("both on {topic}"));
                section.refuse(&spot, rejection.wanted("a topic of its own for each service"));
            }
            self.remap.insert(service, topic);
        }
    }

    /// Is a service to have a route of this kind?
    pub(super) fn permits(&self, kind: &Kind, service: &str) -> bool {
        let matches = |patterns: &Vec<Pattern>| patterns.iter().any(|pattern| pattern.matches(service));
        self.allow.get(kind.name).is_none_or(matches) && !self.deny.get(kind.name).is_some_and(matches)
    }
}

/// The kinds that can be discovered.
pub(super) fn kinds() -> impl Iterator<Item = &'static Kind> {
    KINDS.into_iter().filter(|kind| kind.discovered.is_some())
}
