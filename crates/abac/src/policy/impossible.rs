//! Conditions that no network can ever satisfy: names of a form that nothing has, attributes that are not in the schema, values
//! outside of closed sets. Cedar accepts them, and the policy then says something else than its author meant.

use super::expression::operands;
use super::misfit::Misfit;
use crate::arguments::shown;
use crate::records::robot;
use cedar_policy::{Policy, PolicySet};
use ledger_identity::Role;
use serde_json::Value;

/// The attributes of each variable in the schema.
const PRINCIPAL: [&str; 3] = ["organisation", "name", "role"];
const RESOURCE: [&str; 10] =
    ["name", "robot", "topic", "type", "mode", "direction", "owner", "requiredAttribute", "requiredValue", "trusted"];
const CONTEXT: [&str; 1] = ["time"];

/// Can a network satisfy what each of these policies asks for?
pub(super) fn check(policies: &PolicySet) -> Result<(), Vec<Misfit>> {
    let faults: Vec<Misfit> = policies.policies().flat_map(faults).collect();
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

fn faults(policy: &Policy) -> Vec<Misfit> {
    let Ok(json) = policy.to_json() else { return Vec::new() };
    let mut found = Vec::new();
    walk(&json, &mut |expression| {
        found.extend(entity(expression).or_else(|| attribute(expression)));
        found.extend(comparisons(expression));
    });
    let misfit = |(message, quoted)| Misfit { message, policy: policy.to_string(), quoted };
    found.into_iter().map(misfit).collect()
}

/// Every part of a policy as JSON, the whole first.
fn walk(part: &Value, each: &mut impl FnMut(&Value)) {
    each(part);
    match part {
        Value::Array(several) => several.iter().for_each(|one| walk(one, each)),
        Value::Object(fields) => fields.values().for_each(|one| walk(one, each)),
        _ => {}
    }
}

/// An entity whose id has a form that no entity of its type has: the message and the quotation.
fn entity(part: &Value) -> Option<(String, String)> {
    let text = |key: &str| part.get(key).and_then(Value::as_str);
    let (kind, id) = (text("type")?, text("id")?);
    let is_name = |name: &str| ledger_identity::check_name(name).is_ok();
    let (fits, wanted) = match kind {
        "User" => (
            id.split_once('/').is_some_and(|(organisation, name)| is_name(organisation) && is_name(name)),
            "User::\"ORGANISATION/NAME\"",
        ),
        "Organisation" => (is_name(id), "Organisation::\"ORGANISATION\""),
        "Robot" => (robot::check_name(id).is_ok(), "Robot::\"ROBOT\""),
        "Service" => (
            id.split_once('/').is_some_and(|(name, topic)| {
                robot::check_name(name).is_ok() && !topic.is_empty() && !topic.ends_with('/')
            }),
            "Service::\"ROBOT/TOPIC\"",
        ),
        _ => return None,
    };
    let quoted = format!("{kind}::{}", quotation(id));
    (!fits).then(|| (format!("no network can have {quoted}; wanted {wanted}"), quoted))
}

fn quotation(text: &str) -> String {
    format!("\"{}\"", text.escape_debug())
}

/// An attribute that the schema does not have: to ask for it is always false.
fn attribute(part: &Value) -> Option<(String, String)> {
    let has = part.get("has")?;
    let (variable, attribute) = (variable(has.get("left")?)?, has.get("attr")?.as_str()?);
    let (known, wanted): (&[&str], String) = match variable {
        "principal" => {
            (&PRINCIPAL, format!("principal.hasTag({}) for an attribute of a certificate", quotation(attribute)))
        }
        "resource" => (&RESOURCE, format!("resource.hasTag({}) for an attribute of a robot", quotation(attribute))),
        _ => (&CONTEXT, "time, the only attribute of context".to_owned()),
    };
    let message = format!("{variable} never has the attribute {}; wanted {wanted}", shown(attribute));
    (!known.contains(&attribute)).then(|| (message, attribute.to_owned()))
}

fn variable(part: &Value) -> Option<&str> {
    part.get("Var")?.as_str()
}

/// Comparisons of an attribute with a text that it can never be.
fn comparisons(part: &Value) -> Vec<(String, String)> {
    let literals = |value: &Value| -> Vec<String> {
        let text = |value: &Value| value.get("Value").and_then(Value::as_str).map(str::to_owned);
        match value.get("Set").and_then(Value::as_array) {
            Some(several) => several.iter().filter_map(text).collect(),
            None => text(value).into_iter().collect(),
        }
    };
    let sides =
        ["==", "!=", "contains", "containsAny", "containsAll"].iter().find_map(|operator| operands(part, operator));
    let Some((left, right)) = sides else { return Vec::new() };
    let both = [(left, right), (right, left)];
    let pairs = both.into_iter().filter_map(|(attribute, value)| Some((attribute_of(attribute)?, literals(value))));
    let wrong = pairs.flat_map(|(attribute, values)| {
        values.into_iter().filter_map(move |value| {
            let wanted = wanted(attribute, &value)?;
            let (variable, name) = attribute;
            Some((format!("{variable}.{name} is never {}; wanted {wanted}", shown(&value)), quotation(&value)))
        })
    });
    wrong.collect()
}

/// `principal.role`.
fn attribute_of(part: &Value) -> Option<(&str, &str)> {
    let access = part.get(".")?;
    Some((variable(access.get("left")?)?, access.get("attr")?.as_str()?))
}

/// The form of the values of an attribute, if this is none of them.
fn wanted((variable, attribute): (&str, &str), value: &str) -> Option<String> {
    let is_name = !value.is_empty() && !value.contains('/');
    let (fits, wanted) = match (variable, attribute) {
        ("principal", "role") => {
            let roles = [Role::Member, Role::Admin, Role::Node, Role::Robot].map(Role::as_str);
            (roles.contains(&value), format!("one of {}", roles.join(", ")))
        }
        ("principal", "name") => (is_name, "a name without its organisation".to_owned()),
        ("principal", "organisation") | ("resource", "owner") => (is_name, "the name of an organisation".to_owned()),
        ("resource", "name" | "robot") => (robot::check_name(value).is_ok(), "the name of a robot".to_owned()),
        ("resource", "topic") => (value.starts_with('/'), "a topic, which begins with \"/\"".to_owned()),
        ("resource", "direction") => (["command", "feed"].contains(&value), "command or feed".to_owned()),
        _ => return None,
    };
    (!fits).then_some(wanted)
}
