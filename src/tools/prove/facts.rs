//! Facts that hold in every network, as a Cedar expression. Without it a solver invents users who are in two organisations, or topics
//! that belong to another robot than their name says.

use cedar_policy::{EntityUid, Policy};
use std::collections::BTreeSet;

/// The known properties of the robot.
pub(super) struct Robot {
    /// `ROBOT` or `ROBOT/TOPIC`.
    pub(super) robot: Option<String>,
    pub(super) owner: Option<String>,
    /// `NAME` or `NAME=VALUE`.
    pub(super) requires: Option<String>,
    pub(super) trusted: Vec<String>,
}

impl Robot {
    /// Nothing is known.
    pub(super) const ANY: Self = Self { robot: None, owner: None, requires: None, trusted: Vec::new() };

    /// The known properties, as expressions; `of_service` if the resource is a service.
    fn expressions(&self, of_service: bool) -> Vec<String> {
        let mut all = Vec::new();
        if let Some(robot) = &self.robot {
            let (robot, topic) =
                robot.split_once('/').map_or((robot.as_str(), None), |(robot, topic)| (robot, Some(topic)));
            let attribute = if of_service { "robot" } else { "name" };
            all.push(format!("resource.{attribute} == {}", quoted(robot)));
            if let Some(topic) = topic.filter(|_| of_service) {
                all.push(format!("resource.topic == {}", quoted(&format!("/{topic}"))));
            }
        }
        all.extend(self.owner.as_ref().map(|owner| format!("resource.owner == {}", quoted(owner))));
        if let Some(requires) = &self.requires {
            let (name, value) = requires.split_once('=').unwrap_or((requires, "true"));
            all.push(format!("resource.requiredAttribute == {}", quoted(name)));
            all.push(format!("resource.requiredValue == {}", quoted(value)));
        }
        if !self.trusted.is_empty() {
            let trusted: Vec<_> = self.trusted.iter().map(|name| quoted(name)).collect();
            all.push(format!("resource.trusted == [{}]", trusted.join(", ")));
        }
        all
    }
}

/// Facts about every request on this kind of resource, with the known properties of the robot. `policies` give the names that matter.
pub(super) fn expressions<'a>(
    robot: &Robot,
    of_service: bool,
    policies: impl Iterator<Item = &'a Policy>,
) -> Vec<String> {
    let mut all = robot.expressions(of_service);
    all.push("[\"member\", \"admin\", \"node\", \"robot\"].contains(principal.role)".to_owned());
    if of_service {
        all.push("[\"command\", \"feed\"].contains(resource.direction)".to_owned());
    }
    let named: BTreeSet<EntityUid> = policies.flat_map(Policy::entity_literals).collect();
    all.extend(named.iter().flat_map(|entity| about(entity, of_service)));
    all
}

/// A name says the same as the attributes of its entity.
fn about(entity: &EntityUid, of_service: bool) -> Vec<String> {
    let (kind, id) = (entity.type_name().basename().to_owned(), entity.id().unescaped().to_owned());
    let name = quoted(&id);
    match (kind.as_str(), id.split_once('/')) {
        ("Organisation", _) => vec![
            format!("(principal in Organisation::{name}) == (principal.organisation == {name})"),
            format!("(resource in Organisation::{name}) == (resource.owner == {name})"),
        ],
        ("User", Some((organisation, person))) => {
            let (organisation, person) = (quoted(organisation), quoted(person));
            vec![format!(
                "(principal == User::{name}) == (principal.organisation == {organisation} && principal.name == {person})"
            )]
        }
        ("Robot", _) if of_service => vec![format!("(resource in Robot::{name}) == (resource.robot == {name})")],
        ("Robot", _) => vec![format!("(resource == Robot::{name}) == (resource.name == {name})")],
        ("Service", Some((robot, topic))) if of_service => {
            let (robot, topic) = (quoted(robot), quoted(&format!("/{topic}")));
            vec![format!("(resource == Service::{name}) == (resource.robot == {robot} && resource.topic == {topic})")]
        }
        _ => Vec::new(),
    }
}

/// A text as a Cedar literal.
pub(super) fn quoted(text: &str) -> String {
    format!("\"{}\"", text.escape_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_a_literal_whatever_it_holds() {
        assert_eq!(quoted("a\"b\\c\u{1}ö"), r#""a\"b\\c\u{1}\u{f6}""#);
    }
}
