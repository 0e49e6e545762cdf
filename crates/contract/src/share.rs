//! Shares: policies in one fixed form, written and read without a policy language.
//!
//! The text of a share is composed from its terms, and only from them. So its terms can be read back from the text, and a text that
//! was edited is noticed: composed again, it differs.

use crate::can::{PolicyDiff, PolicyMeaning, Right, UnknownName};
use crate::policy::PolicyDraft;
use serde::{Deserialize, Serialize};

/// The annotation of a share, with the number of its form.
const MARK: &str = "@share(\"1\")";
/// The condition that leaves the feeds of a robot to their publisher.
const COMMANDS: &str = "(action == Action::\"subscribe\" || resource.direction == \"command\")";
/// The condition under which attributes of an organisation count.
const TRUSTED: &str = "resource.trusted.contains(principal.organisation)";
/// The actions of a share.
const USE: &str = "action in [Action::\"acquire\", Action::\"publish\", Action::\"subscribe\"]";
/// The action of a share for reading.
const READ: &str = "action == Action::\"subscribe\"";
/// Longest id of a share without the number that makes it unique, in bytes.
const ID_BYTES_MAX: usize = 56;

/// The terms on which an owner shares a robot or a service.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShareTerms {
    /// The robot, or the service: `Turtlebot4`, `Turtlebot4/cmd_vel`.
    pub resource: String,
    /// The organisation, or the person: `Org1`, `Org1/Salma`.
    pub with: String,
    /// An attribute that they must carry: `KEY=VALUE`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attribute: Option<String>,
    /// From when on (microseconds since the UNIX epoch, a whole millisecond).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<u64>,
    /// Until when (microseconds since the UNIX epoch, a whole millisecond).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<u64>,
    /// The window of each day, with its offset from UTC: `08:00-18:00 +01:00`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hours: Option<String>,
    /// Largest linear speed, m/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_linear: Option<String>,
    /// Largest angular speed, rad/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_angular: Option<String>,
    /// Most messages a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate: Option<String>,
    /// Their priority.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<String>,
    /// They read only.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub read_only: bool,
}

/// A share that is in force: an element of `shares`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShareEntry {
    /// The owner.
    pub organisation: String,
    /// The id of its policy.
    pub id: String,
    /// Its terms; none if its text was edited.
    #[serde(flatten)]
    pub terms: Option<ShareTerms>,
    /// It is marked as a share, and its text has another form: only the text says what it gives.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub edited: bool,
    /// Cedar.
    pub text: String,
}

/// Answer of `share_preview`: a share that is not in force yet, and what it would change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SharePreview {
    /// The id of its policy.
    pub id: String,
    /// Cedar.
    pub text: String,
    /// Its meaning in words.
    pub meaning: Vec<PolicyMeaning>,
    /// The share whose place it takes: one of the same resource, receiver and attribute; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub replaces: String,
    /// The owner has no policy of its own yet: the built-in one becomes part of the set, and stays in force.
    pub keeps_built_in: bool,
    /// Does the robot trust the organisation, so that its attributes count?
    pub trusted: bool,
    /// Names in it that the network does not know today.
    pub unknown: Vec<UnknownName>,
    /// The argument of `policy apply`.
    pub set: PolicyDraft,
    /// The differences from the set in force.
    pub diff: PolicyDiff,
}

/// Answer of `unshare_preview`: the set without a share, and what its end would change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnsharePreview {
    /// The id of the share.
    pub id: String,
    /// Cedar.
    pub text: String,
    /// The argument of `policy apply`.
    pub set: PolicyDraft,
    /// The differences from the set in force.
    pub diff: PolicyDiff,
    /// The people of other organisations who may still use the robot, each with their rights.
    pub still: Vec<Access>,
}

/// The rights of a person on a robot: an element of `access`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Access {
    /// The person.
    pub who: String,
    /// Their role.
    pub role: String,
    /// The rights that they have.
    pub rights: Vec<Right>,
}

/// The argument of `access`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AskAccess {
    /// The robot.
    pub robot: String,
    /// Only this person.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// When (microseconds since the UNIX epoch); now without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<u64>,
    /// Policies to decide by instead of those in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<Vec<crate::policy::PolicyText>>,
}

impl ShareTerms {
    /// The robot.
    pub fn robot(&self) -> &str {
        self.resource.split_once('/').map_or(&self.resource, |(robot, _)| robot)
    }

    /// The organisation with which it is shared.
    pub fn organisation(&self) -> &str {
        self.with.split_once('/').map_or(&self.with, |(organisation, _)| organisation)
    }

    /// Are these about the same resource, receiver and attribute? One share of them takes the place of the other.
    pub fn is_about_the_same(&self, other: &Self) -> bool {
        (&self.resource, &self.with, &self.attribute) == (&other.resource, &other.with, &other.attribute)
    }

    /// The id of its policy, unless another policy has it.
    pub fn id(&self) -> String {
        let attribute = self.attribute.as_deref().map(|attribute| attribute.trim_end_matches("=true"));
        let parts = [Some("share"), Some(&self.resource), Some(&self.with), attribute];
        let text = parts.into_iter().flatten().collect::<Vec<_>>().join("-");
        let letters = text.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' });
        letters.take(ID_BYTES_MAX).collect()
    }

    /// Its policy in Cedar.
    pub fn text(&self) -> String {
        let limits = [
            ("between", &self.hours),
            ("max_rate", &self.rate),
            ("max_linear", &self.max_linear),
            ("max_angular", &self.max_angular),
            ("priority", &self.priority),
        ];
        let limits =
            limits.into_iter().filter_map(|(name, value)| Some(format!("@{name}({})\n", quoted(value.as_deref()?))));
        let principal = match self.with.contains('/') {
            true => format!("principal == User::{}", quoted(&self.with)),
            false => format!("principal in Organisation::{}", quoted(&self.with)),
        };
        let resource = match self.resource.contains('/') {
            true => format!("resource == Service::{}", quoted(&self.resource)),
            false => format!("resource in Robot::{}", quoted(&self.resource)),
        };
        let action = if self.read_only { READ } else { USE };
        let mut conditions = Vec::new();
        if !self.read_only {
            conditions.push(COMMANDS.to_owned());
        }
        if let Some(attribute) = &self.attribute {
            let (key, value) = attribute.split_once('=').unwrap_or((attribute, "true"));
            let (key, value) = (quoted(key), quoted(value));
            conditions.push(TRUSTED.to_owned());
            conditions.push(format!("principal.hasTag({key})"));
            conditions.push(format!("principal.getTag({key}) == {value}"));
        }
        conditions.extend(self.from.map(|from| format!("context.time >= {}", from / 1000)));
        conditions.extend(self.until.map(|until| format!("context.time < {}", until / 1000)));
        let when = match conditions.is_empty() {
            true => String::new(),
            false => format!(" when {{\n    {}\n}}", conditions.join(" &&\n    ")),
        };
        let limits = limits.collect::<String>();
        format!("{MARK}\n{limits}permit (\n    {principal},\n    {action},\n    {resource}\n){when};\n")
    }
}

impl ShareEntry {
    /// A policy as a share; none if it is not marked as one.
    pub fn of(organisation: &str, id: &str, text: &str) -> Option<Self> {
        if !text.starts_with("@share(") {
            return None;
        }
        let terms = terms(text).filter(|terms| terms.text() == text);
        let edited = terms.is_none();
        Some(Self { organisation: organisation.to_owned(), id: id.to_owned(), terms, edited, text: text.to_owned() })
    }
}

/// The terms in a text of the form of shares.
fn terms(text: &str) -> Option<ShareTerms> {
    let mut terms = ShareTerms::default();
    let within = |line: &str, start: &str, end: &str| unquoted(line.strip_prefix(start)?.strip_suffix(end)?);
    for line in text.lines().skip(1) {
        let line = line.trim();
        let line = line.strip_suffix(" &&").or(line.strip_suffix(',')).unwrap_or(line);
        let milliseconds = |start: &str| line.strip_prefix(start)?.parse::<u64>().ok()?.checked_mul(1000);
        if let Some(annotation) = line.strip_prefix('@') {
            let (name, _) = annotation.split_once('(')?;
            let value = Some(within(annotation, &format!("{name}("), ")")?);
            match name {
                "between" => terms.hours = value,
                "max_rate" => terms.rate = value,
                "max_linear" => terms.max_linear = value,
                "max_angular" => terms.max_angular = value,
                "priority" => terms.priority = value,
                _ => return None,
            }
        } else if line.starts_with("principal == ") {
            terms.with = within(line, "principal == User::", "")?;
        } else if line.starts_with("principal in ") {
            terms.with = within(line, "principal in Organisation::", "")?;
        } else if line.starts_with("resource == ") {
            terms.resource = within(line, "resource == Service::", "")?;
        } else if line.starts_with("resource in ") {
            terms.resource = within(line, "resource in Robot::", "")?;
        } else if line.starts_with("principal.hasTag(") {
            terms.attribute = Some(within(line, "principal.hasTag(", ")")?);
        } else if line.starts_with("principal.getTag(") {
            let key = terms.attribute.take()?;
            let value = within(line, &format!("principal.getTag({}) == ", quoted(&key)), "")?;
            terms.attribute = Some(format!("{key}={value}"));
        } else if line == READ {
            terms.read_only = true;
        } else if line.starts_with("context.time >= ") {
            terms.from = Some(milliseconds("context.time >= ")?);
        } else if line.starts_with("context.time < ") {
            terms.until = Some(milliseconds("context.time < ")?);
        }
    }
    Some(terms)
}

/// A text as a literal of Cedar.
fn quoted(text: &str) -> String {
    let mut literal = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => literal.extend(['\\', c]),
            c if c.is_control() => literal.push_str(&format!("\\u{{{:x}}}", c as u32)),
            c => literal.push(c),
        }
    }
    literal.push('"');
    literal
}

/// The text of a literal that [`quoted`] has written.
fn unquoted(literal: &str) -> Option<String> {
    let mut rest = literal.strip_prefix('"')?.strip_suffix('"')?.chars();
    let mut text = String::new();
    while let Some(c) = rest.next() {
        match c {
            '"' => return None,
            '\\' => match rest.next()? {
                'u' => {
                    let digits: String = rest.by_ref().skip(1).take_while(|c| *c != '}').collect();
                    text.push(char::from_u32(u32::from_str_radix(&digits, 16).ok()?)?);
                }
                c => text.push(c),
            },
            c => text.push(c),
        }
    }
    Some(text)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn all() -> ShareTerms {
        ShareTerms {
            resource: "Turtlebot4/cmd_vel".into(),
            with: "Org1/Sal\"ma\\".into(),
            attribute: Some("ro=le, &&=a\nb".into()),
            from: Some(1_796_083_200_000_000),
            until: Some(1_796_083_300_000_000),
            hours: Some("08:00-18:00 Mon-Fri +01:00".into()),
            max_linear: Some("0.3".into()),
            max_angular: Some("1".into()),
            rate: Some("20".into()),
            priority: Some("-3".into()),
            read_only: false,
        }
    }

    #[test]
    fn the_terms_of_a_share_are_read_back_from_its_text() {
        let of_robot = ShareTerms { resource: "Turtlebot4".into(), with: "Org1".into(), ..ShareTerms::default() };
        let reading = ShareTerms { read_only: true, ..of_robot.clone() };
        for terms in [all(), of_robot, reading.clone(), ShareTerms { attribute: Some("guest=true".into()), ..reading }]
        {
            let entry = ShareEntry::of("Org2", "share-x", &terms.text()).unwrap();
            assert_eq!((entry.terms, entry.edited), (Some(terms.clone()), false), "{}", terms.text());
        }
    }

    #[test]
    fn a_share_that_was_edited_has_no_terms() {
        let text = all().text();
        for edited in [
            text.replace("Action::\"publish\"", "Action::\"stop\""),
            text.replace(" &&\n    context.time <", " ||\n    context.time <"),
            text.clone() + "permit (principal, action, resource);\n",
            text.replace("Org1/", "Org3/") + " ",
        ] {
            let entry = ShareEntry::of("Org2", "share-x", &edited).unwrap();
            assert_eq!((entry.terms, entry.edited), (None, true), "{edited}");
        }
        assert_eq!(ShareEntry::of("Org2", "x", "permit (principal, action, resource);"), None);
    }

    #[test]
    fn the_text_of_a_share_leaves_feeds_to_their_publisher_and_names_whom_it_is_for() {
        let terms = ShareTerms {
            resource: "Turtlebot4".into(),
            with: "Org1".into(),
            max_linear: Some("0.3".into()),
            ..ShareTerms::default()
        };
        let wanted = "@share(\"1\")\n@max_linear(\"0.3\")\npermit (\n    principal in Organisation::\"Org1\",\n    action in \
                      [Action::\"acquire\", Action::\"publish\", Action::\"subscribe\"],\n    resource in \
                      Robot::\"Turtlebot4\"\n) when {\n    (action == Action::\"subscribe\" || resource.direction == \
                      \"command\")\n};\n";
        assert_eq!(terms.text(), wanted);
        assert_eq!(terms.id(), "share-Turtlebot4-Org1");
        assert_eq!(all().id(), "share-Turtlebot4-cmd_vel-Org1-Sal-ma--ro-le-----a-b");
    }
}
