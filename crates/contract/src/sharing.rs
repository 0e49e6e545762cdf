//! How a service is shared: the settings of its rule, which its owner chooses key by key.

use crate::word::words;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

/// The name of the rule that says how many may use a service at once. It is for people and for the owner's choice: what
/// follows from it are [`crate::Capabilities`]. A node may have rules that this program does not know.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Mode(Cow<'static, str>);

impl Mode {
    /// Everybody whom policies permit.
    pub const OPEN: Self = Self::named("open");
    /// One holder of a grant at a time.
    pub const EXCLUSIVE: Self = Self::named("exclusive");
    /// As many holders as the owner says.
    pub const LIMITED: Self = Self::named("limited");

    /// The mode of a rule with that name.
    pub const fn named(name: &'static str) -> Self {
        Self(Cow::Borrowed(name))
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.0
    }
}

impl From<&str> for Mode {
    fn from(name: &str) -> Self {
        Self(Cow::Owned(name.to_owned()))
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

words! {
    /// The treatment of a contender for whom no place is free.
    pub enum OnConflict {
        /// It is refused.
        Deny = "deny",
        /// It waits in line.
        Queue = "queue",
        /// It takes the place of the holder with the lowest priority below its own.
        Preempt = "preempt",
    }
}

/// Ends the id of the places from which a service is read. No topic has a colon.
const READERS: &str = ":subscribe";

/// The id under which the places of a service's subscribers are acquired: `Turtlebot4/camera:subscribe`.
pub fn readers(service: &str) -> String {
    format!("{service}{READERS}")
}

/// The service whose messages are read from the places with this id; none if it is the id of no such places.
pub fn read_from(id: &str) -> Option<&str> {
    id.strip_suffix(READERS)
}

/// The settings of a service's rule. Each has a default: see docs/conflict.md.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sharing {
    /// How many may hold the service at once; for mode `limited`, where everybody may publish without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub publishers: Option<u64>,
    /// How many may read the messages of the service at once; for mode `limited`. Each takes a place: see [`readers`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subscribers: Option<u64>,
    /// The treatment of a contender for whom no place is free; `deny` by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_conflict: Option<OnConflict>,
    /// The most that wait in line; 64 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue_max: Option<u64>,
    /// How long (milliseconds) a contender waits at most; ten minutes by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue_wait_max_ms: Option<u64>,
    /// Where priorities come from: `attribute:NAME`, `policy` or `fixed:N`; `fixed:0` by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<String>,
    /// The time (milliseconds) of waiting that raises a priority by one; never by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aging_ms: Option<u64>,
    /// How long (milliseconds) a holder cannot be preempted; 0 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_hold_ms: Option<u64>,
    /// A holder that publishes nothing for so long (milliseconds) loses the service; never by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idle_release_ms: Option<u64>,
    /// May a holder pass its grant on? No by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delegable: Option<bool>,
    /// How many identities must confirm a contender before it competes; none by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirm: Option<u64>,
    /// How long (milliseconds) confirmations are waited for, and count; a minute by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirm_within_ms: Option<u64>,
    /// Are messages encrypted for those who may read them? No by default. It goes with every mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidential: Option<bool>,
    /// Most bytes of transactions a second that all publishers together publish; the quota of the owner's organisation by
    /// default. It goes with every mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes_per_s: Option<u64>,
    /// Most messages a second that all publishers together publish; the quota of the owner's organisation by default. It
    /// goes with every mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub messages_per_s: Option<u64>,
    /// Largest linear speed (millimetres per second) that the robot's gate lets pass, whatever policies say; any by default. It goes
    /// with every mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_linear_mm_s: Option<u64>,
    /// Largest angular speed (thousandths of a radian per second), likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_angular_mrad_s: Option<u64>,
}

/// A key of [`Sharing`]: its name, its value for people if it is set, how it takes the value of another, how it is cleared.
struct Key {
    name: &'static str,
    shown: fn(&Sharing) -> Option<String>,
    take: fn(&mut Sharing, &Sharing),
}

macro_rules! keys {
    ($($name:ident)*) => {
        /// Every key.
        const KEYS: &[Key] = &[$(Key {
            name: stringify!($name),
            shown: |sharing| sharing.$name.as_ref().map(ToString::to_string),
            take: |sharing, other| sharing.$name.clone_from(&other.$name),
        },)*];
    };
}

keys!(
    publishers subscribers on_conflict queue_max queue_wait_max_ms priority aging_ms min_hold_ms idle_release_ms delegable confirm confirm_within_ms confidential bytes_per_s messages_per_s max_linear_mm_s max_angular_mrad_s
);

impl Sharing {
    /// Are all settings the defaults?
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Are messages encrypted for those who may read them?
    pub fn is_confidential(&self) -> bool {
        self.confidential == Some(true)
    }

    /// The names of all keys.
    pub fn keys() -> impl Iterator<Item = &'static str> {
        KEYS.iter().map(|key| key.name)
    }

    /// The keys that are set, with their values for people.
    pub fn set(&self) -> impl Iterator<Item = (&'static str, String)> {
        KEYS.iter().filter_map(|key| (key.shown)(self).map(|value| (key.name, value)))
    }

    /// The value of a key for people; empty if it is not set.
    pub fn shown(&self, name: &str) -> String {
        KEYS.iter().find(|key| key.name == name).and_then(|key| (key.shown)(self)).unwrap_or_default()
    }

    /// Takes over what `changes` sets.
    pub fn change(&mut self, changes: &Self) {
        for key in KEYS.iter().filter(|key| (key.shown)(changes).is_some()) {
            (key.take)(self, changes);
        }
    }

    /// Gives a key its default again. Answers if there is such a key.
    pub fn clear(&mut self, name: &str) -> bool {
        let key = KEYS.iter().find(|key| key.name == name);
        key.is_some_and(|key| {
            (key.take)(self, &Self::default());
            true
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_places_of_subscribers_are_named_by_their_service() {
        let places = readers("Turtlebot4/camera");
        assert_eq!((places.as_str(), read_from(&places)), ("Turtlebot4/camera:subscribe", Some("Turtlebot4/camera")));
        assert_eq!(read_from("Turtlebot4/camera"), None);
    }

    #[test]
    fn every_field_of_the_settings_is_a_key() {
        let all = Sharing {
            publishers: Some(2),
            subscribers: Some(11),
            on_conflict: Some(OnConflict::Queue),
            queue_max: Some(3),
            queue_wait_max_ms: Some(4),
            priority: Some("fixed:5".into()),
            aging_ms: Some(6),
            min_hold_ms: Some(7),
            idle_release_ms: Some(8),
            delegable: Some(true),
            confirm: Some(9),
            confirm_within_ms: Some(10),
            confidential: Some(true),
            bytes_per_s: Some(12),
            messages_per_s: Some(13),
            max_linear_mm_s: Some(14),
            max_angular_mrad_s: Some(15),
        };
        let json = serde_json::to_value(&all).unwrap();
        let mut fields: Vec<&String> = json.as_object().unwrap().keys().collect();
        let mut keys: Vec<&str> = Sharing::keys().collect();
        fields.sort();
        keys.sort_unstable();
        assert_eq!(fields, keys);
        assert_eq!(all.set().count(), keys.len());

        let mut some = Sharing { queue_max: Some(9), ..Sharing::default() };
        some.change(&all);
        assert_eq!(some, all);
        assert_eq!(some.shown("on_conflict"), "queue");
        for key in keys {
            assert!(some.clear(key), "{key}");
        }
        assert!(some.is_default() && !some.clear("queue"));
        assert_eq!(serde_json::to_string(&some).unwrap(), "{}");
    }
}
