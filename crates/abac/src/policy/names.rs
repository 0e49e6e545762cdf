//! The names in policies, of users, organisations, robots and services.

use super::expression::operands;
use cedar_policy::{Policy, PolicySet};
use ledger_contract::UnknownName;
use serde_json::Value;
use std::collections::BTreeSet;

/// All names in a text, each with the line of its policy.
pub(super) fn named(source: &str) -> Vec<UnknownName> {
    let Ok(set) = source.parse::<PolicySet>() else { return Vec::new() };
    let mut found = BTreeSet::new();
    for policy in set.policies() {
        let offset = source.find(&policy.to_string()).unwrap_or(0);
        let line = 1 + source.get(..offset).unwrap_or_default().bytes().filter(|byte| *byte == b'\n').count() as u64;
        found.extend(of_policy(policy).into_iter().map(|(kind, name)| (line, kind, name)));
    }
    let unknown = |(line, kind, name)| UnknownName { line, kind, name, near: String::new() };
    found.into_iter().map(unknown).collect()
}

fn of_policy(policy: &Policy) -> BTreeSet<(String, String)> {
    let mut found = BTreeSet::new();
    if let Ok(json) = policy.to_json() {
        collect(&json, &mut found);
    }
    found
}

fn collect(part: &Value, found: &mut BTreeSet<(String, String)>) {
    found.extend(entity(part));
    found.extend(compared(part));
    match part {
        Value::Array(several) => several.iter().for_each(|one| collect(one, found)),
        Value::Object(fields) => fields.values().for_each(|one| collect(one, found)),
        _ => {}
    }
}

/// An entity that is named.
fn entity(part: &Value) -> Option<(String, String)> {
    let text = |key: &str| part.get(key).and_then(Value::as_str);
    let (kind, id) = (text("type")?, text("id")?);
    ["User", "Organisation", "Robot", "Service"].contains(&kind).then(|| (kind.to_owned(), id.to_owned()))
}

/// The organisation or the robot with which an attribute is compared.
fn compared(part: &Value) -> Option<(String, String)> {
    let (left, right) = ["==", "!="].iter().find_map(|operator| operands(part, operator))?;
    let name = right.get("Value").and_then(Value::as_str)?;
    let access = left.get(".")?;
    let variable = access.get("left")?.get("Var")?.as_str()?;
    let kind = match (variable, access.get("attr")?.as_str()?) {
        ("principal", "organisation") | ("resource", "owner") => "Organisation",
        ("resource", "robot" | "name") => "Robot",
        _ => return None,
    };
    Some((kind.to_owned(), name.to_owned()))
}
