//! The file of a fleet: robots with their services and trust, policies and shares, in TOML.
//!
//! Names of settings are those of `robot set`, names of a share's terms those of `share`; `-` and `_` are the same.

use crate::argument::setting::{self, Key};
use crate::argument::when::When;
use ledger_base::nearest::nearest;
use ledger_contract::{Attribute, Attributes, RobotSettings, ShareTerms};
use ledger_identity::read_attribute;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// All that a file names.
#[derive(Debug, Default)]
pub(super) struct FleetFile {
    /// The owner, if it is named.
    pub(super) organisation: Option<String>,
    pub(super) robots: BTreeMap<String, RobotEntry>,
    /// Texts by their ids.
    pub(super) policies: BTreeMap<String, String>,
    pub(super) shares: Vec<ShareTerms>,
}

/// A robot, as far as the file names its settings.
#[derive(Debug, Default)]
pub(super) struct RobotEntry {
    /// Those of the robot itself.
    pub(super) settings: RobotSettings,
    pub(super) attributes: Attributes,
    /// By their topics.
    pub(super) services: BTreeMap<String, ServiceEntry>,
}

/// A service, as far as the file names its settings.
#[derive(Debug, Default)]
pub(super) struct ServiceEntry {
    pub(super) settings: RobotSettings,
    pub(super) attributes: Attributes,
}

impl FleetFile {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// The place that cannot be read, and the form that is wanted.
    pub(super) fn read(text: &str) -> Result<Self, String> {
        let table: Table = toml::from_str(text).map_err(|fault| fault.to_string().trim().to_owned())?;
        let mut file = Self::default();
        for (key, value) in table {
            match known(&key, &["organisation", "policy", "robot", "share"], "")? {
                "organisation" => file.organisation = Some(text_of(&value, "organisation")?),
                "policy" => {
                    for (id, text) in table_of(value, "policy")? {
                        let text = text_of(&text, &format!("policy.{id}"))?;
                        file.policies.insert(id, text);
                    }
                }
                "robot" => {
                    for (name, robot) in table_of(value, "robot")? {
                        let place = format!("robot.{name}");
                        file.robots.insert(name, robot_of(table_of(robot, &place)?, &place)?);
                    }
                }
                _ => {
                    let Value::Array(several) = value else { return Err(wanted("share", "[[share]]")) };
                    for (at, share) in several.into_iter().enumerate() {
                        let place = format!("share {}", at + 1);
                        file.shares.push(share_of(table_of(share, &place)?, &place)?);
                    }
                }
            }
        }
        Ok(file)
    }
}

fn robot_of(table: Table, place: &str) -> Result<RobotEntry, String> {
    let mut robot = RobotEntry::default();
    for (key, value) in table {
        match key.as_str() {
            "attributes" => robot.attributes = attributes_of(value, place)?,
            "service" => {
                for (topic, service) in table_of(value, &format!("{place}.service"))? {
                    let place = format!("{place}.service.{topic:?}");
                    let topic = if topic.starts_with('/') { topic } else { format!("/{topic}") };
                    robot.services.insert(topic, service_of(table_of(service, &place)?, &place)?);
                }
            }
            name => read(&mut robot.settings, name, &value, place, |key| !key.of_service)?,
        }
    }
    Ok(robot)
}

fn service_of(table: Table, place: &str) -> Result<ServiceEntry, String> {
    let mut service = ServiceEntry::default();
    for (key, value) in table {
        match key.as_str() {
            "attributes" => service.attributes = attributes_of(value, place)?,
            name => read(&mut service.settings, name, &value, place, |key| key.of_service)?,
        }
    }
    Ok(service)
}

/// Reads a setting as `robot set` does.
fn read(
    settings: &mut RobotSettings,
    name: &str,
    value: &Value,
    place: &str,
    meant: impl Fn(&Key) -> bool,
) -> Result<(), String> {
    let within = |fault: String| format!("{place}: {fault}");
    let key = setting::find(name, meant).map_err(within)?;
    key.read(settings, &word_of(value, name).map_err(within)?).map_err(within)
}

/// A value as it is typed on the command line.
fn word_of(value: &Value, name: &str) -> Result<String, String> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Integer(number) => Ok(number.to_string()),
        Value::Float(number) => Ok(number.to_string()),
        Value::Boolean(is_so) => Ok(is_so.to_string()),
        Value::Datetime(moment) => Ok(moment.to_string()),
        Value::Array(several) => {
            Ok(several.iter().map(|one| text_of(one, name)).collect::<Result<Vec<_>, _>>()?.join(","))
        }
        Value::Table(_) => Err(wanted(name, "a text, a number, or true or false")),
    }
}

fn attributes_of(value: Value, place: &str) -> Result<Attributes, String> {
    let place = format!("{place}.attributes");
    let attribute = |(name, value): (String, Value)| {
        let attribute = match value {
            Value::String(text) => Attribute::Text(text),
            Value::Integer(number) => Attribute::Number(number),
            Value::Array(several) => {
                Attribute::Set(several.iter().map(|one| text_of(one, &place)).collect::<Result<_, _>>()?)
            }
            _ => return Err(wanted(&format!("{place}.{name}"), "a text, a whole number, or a list of texts")),
        };
        Ok((name, attribute))
    };
    table_of(value, &place)?.into_iter().map(attribute).collect()
}

fn share_of(table: Table, place: &str) -> Result<ShareTerms, String> {
    const KEYS: [&str; 11] = [
        "attr",
        "from",
        "hours",
        "max-angular",
        "max-linear",
        "priority",
        "rate",
        "read-only",
        "resource",
        "until",
        "with",
    ];
    let mut terms = ShareTerms::default();
    for (key, value) in table {
        let word = word_of(&value, &key).map_err(|fault| format!("{place}: {fault}"))?;
        let moment = |word: &str| match word.parse::<When>() {
            Ok(When::At(moment)) => Ok(Some(moment / 1000 * 1000)),
            _ => Err(format!("{place}: {key}: wanted a time in the form of RFC 3339, such as 2027-05-01T14:30:00Z")),
        };
        match known(&key.replace('_', "-"), &KEYS, place)? {
            "attr" => {
                let (key, value) = read_attribute(&word).map_err(|fault| format!("{place}: attr: {fault}"))?;
                terms.attribute = Some(format!("{key}={value}"));
            }
            "from" => terms.from = moment(&word)?,
            "until" => terms.until = moment(&word)?,
            "hours" => terms.hours = Some(word),
            "max-angular" => terms.max_angular = Some(word),
            "max-linear" => terms.max_linear = Some(word),
            "priority" => terms.priority = Some(word),
            "rate" => terms.rate = Some(word),
            "read-only" => terms.read_only = word.parse().map_err(|_| wanted(&key, "true or false"))?,
            "resource" => terms.resource = word,
            _ => terms.with = word,
        }
    }
    if terms.resource.is_empty() || terms.with.is_empty() {
        return Err(wanted(place, "resource (a robot or a service) and with (an organisation or a person)"));
    }
    Ok(terms)
}

/// The key of this name.
fn known<'k>(key: &str, keys: &[&'k str], place: &str) -> Result<&'k str, String> {
    if let Some(known) = keys.iter().find(|known| **known == key) {
        return Ok(known);
    }
    let near = nearest(key, keys.iter().copied()).map(|near| format!(" (did you mean {near}?)")).unwrap_or_default();
    let place = if place.is_empty() { String::new() } else { format!("{place}: ") };
    Err(format!("{place}unknown key {key:?}{near}; wanted one of {}", keys.join(", ")))
}

fn table_of(value: Value, place: &str) -> Result<Table, String> {
    match value {
        Value::Table(table) => Ok(table),
        _ => Err(wanted(place, "a table")),
    }
}

fn text_of(value: &Value, place: &str) -> Result<String, String> {
    value.as_str().map(str::to_owned).ok_or_else(|| wanted(place, "a text"))
}

fn wanted(place: &str, what: &str) -> String {
    format!("{place}: wanted {what}")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn settings_have_the_names_and_forms_of_the_command_line() {
        let file = FleetFile::read(
            r#"
            organisation = "Org2"
            [robot.Husky]
            attr-required = "level=3"
            trust = ["Org1", "Org2"]
            attributes = { kind = "rover", payload_kg = 75, zones = ["yard"] }
            [robot.Husky.service."/cmd_vel"]
            type = "geometry_msgs/msg/Twist"
            lease = "10s"
            on_conflict = "queue"
            queue-max = 8
            confidential = true
            [policy]
            night = "permit (principal, action, resource);"
            [[share]]
            resource = "Husky"
            with = "Org1"
            attr = "guest"
            max-linear = 0.3
            until = 2027-05-01T14:30:00Z
            "#,
        )
        .unwrap();
        let husky = &file.robots["Husky"];
        assert_eq!(husky.settings.trusted.as_deref().unwrap(), ["Org1", "Org2"]);
        assert_eq!(husky.attributes["payload_kg"], Attribute::Number(75));
        let service = &husky.services["/cmd_vel"].settings;
        assert_eq!((service.lease_ms, service.sharing.queue_max), (Some(10_000), Some(8)));
        assert!(service.sharing.is_confidential());
        let share = &file.shares[0];
        assert_eq!((share.attribute.as_deref(), share.max_linear.as_deref()), (Some("guest=true"), Some("0.3")));
        assert_eq!(share.until, Some(1_809_181_800_000_000));
        assert_eq!(file.policies.len(), 1);
    }

    #[test]
    fn slips_are_refused_with_their_place_and_what_is_wanted() {
        for (text, part) in [
            ("robots = 1", "did you mean robot?"),
            ("[robot.Husky]\ntrusst = ['Org1']", "robot.Husky: unknown setting \"trusst\" (did you mean trust?)"),
            ("[robot.Husky.service.'/c']\nlease = 10", "robot.Husky.service.\"/c\": lease=10"),
            ("[robot.Husky.service.'/c']\ntrust = 'Org1'", "unknown setting"),
            ("[[share]]\nresource = 'Husky'", "share 1: wanted resource"),
            ("[[share]]\nresource = 'Husky'\nwith = 'Org1'\nuntil = '8h'", "RFC 3339"),
            ("[policy]\nnight = 1", "policy.night: wanted a text"),
            ("[robot.Husky]\nattributes = { a = 1.5 }", "robot.Husky.attributes.a"),
            ("x", "TOML"),
        ] {
            let fault = FleetFile::read(text).unwrap_err();
            assert!(fault.contains(part), "{text}: {fault}");
        }
    }
}
