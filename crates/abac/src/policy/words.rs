//! The meaning of policies in words.

use super::action::NAMED_RIGHTS;
use super::expression::{operands, split, text};
use super::naming::named;
use crate::arguments::shown;
use cedar_policy::{Effect, EntityUid, Policy, PolicySet, PrincipalConstraint, ResourceConstraint};
use ledger_base::moment::rfc3339_seconds;
use ledger_contract::PolicyMeaning;
use serde_json::Value;

/// Actions on services, each with its verb.
const OF_SERVICE: [(&str, &str); 5] = [
    ("acquire", "acquire"),
    ("publish", "publish on"),
    ("subscribe", "subscribe to"),
    ("override", "override the holder of"),
    ("confirm", "confirm who acquires"),
];
/// Actions on robots.
const OF_ROBOT: [&str; 2] = ["stop", "resume"];
/// Conditions that most policies have, in Cedar and in words.
const PHRASES: [(&str, &str); 7] = [
    ("resource.trusted.contains(principal.organisation)", "the owner of the robot trusts their organisation"),
    ("principal.hasTag(resource.requiredAttribute)", "their certificate has the attribute that the robot requires"),
    (
        "principal.getTag(resource.requiredAttribute) == resource.requiredValue",
        "this attribute has the value that the robot requires",
    ),
    ("principal.organisation == resource.owner", "they belong to the owner of the robot"),
    ("resource.direction == \"command\"", "it is a command service"),
    ("resource.direction == \"feed\"", "it is a feed of the robot"),
    (
        "action == Action::\"subscribe\" || resource.direction == \"command\"",
        "it is a command service, or they only subscribe",
    ),
];

/// The meaning of each policy of a text, in the order of the text.
pub(super) fn meanings(source: &str) -> Vec<PolicyMeaning> {
    let Ok(set) = source.parse::<PolicySet>() else { return Vec::new() };
    let phrases: Vec<(Value, &str)> =
        PHRASES.iter().filter_map(|(cedar, words)| Some((conditions(cedar)?, *words))).collect();
    let placed = in_order(source, &set);
    placed.into_iter().map(|(offset, policy)| meaning(source, offset, policy, &phrases)).collect()
}

/// The policies of a text with their places in it, in the order of the text.
pub(super) fn in_order<'s>(source: &str, set: &'s PolicySet) -> Vec<(usize, &'s Policy)> {
    let mut placed: Vec<(usize, &Policy)> =
        set.policies().map(|policy| (source.find(&policy.to_string()).unwrap_or(0), policy)).collect();
    placed.sort_by_key(|(offset, policy)| (*offset, policy.id().to_string()));
    placed
}

/// The condition of a policy with this one.
fn conditions(cedar: &str) -> Option<Value> {
    let policy = Policy::parse(None, format!("permit (principal, action, resource) when {{ {cedar} }};")).ok()?;
    Some(policy.to_json().ok()?.get("conditions")?.get(0)?.get("body")?.clone())
}

fn meaning(source: &str, offset: usize, policy: &Policy, phrases: &[(Value, &str)]) -> PolicyMeaning {
    let permits = policy.effect() == Effect::Permit;
    let actions = actions(policy, permits);
    let open = named(policy).is_empty();
    let except: &[&str] = match (open, permits) {
        (false, _) => &[],
        (true, true) => &NAMED_RIGHTS,
        (true, false) => &["stop"],
    };
    let may = if permits { "may" } else { "may not" };
    PolicyMeaning {
        line: 1 + source.get(..offset).unwrap_or_default().bytes().filter(|byte| *byte == b'\n').count() as u64,
        effect: policy.effect().to_string(),
        meaning: format!("{} {may} {}", who(policy), objects(policy, &actions)),
        when: when(policy, phrases),
        limits: policy.annotations().filter_map(|(name, value)| limit(name, value)).collect(),
        except: except.iter().map(|action| (*action).to_owned()).collect(),
        unmatched: false,
    }
}

/// The actions that a policy is about: those that it names; without, those that need no name, and for a `forbid` all.
fn actions(policy: &Policy, permits: bool) -> Vec<String> {
    let named: Vec<String> = named(policy).iter().map(|action| action.id().unescaped().to_owned()).collect();
    if !named.is_empty() {
        return named;
    }
    let all = OF_SERVICE.iter().map(|(action, _)| *action).chain(OF_ROBOT);
    all.filter(|action| !permits || !NAMED_RIGHTS.contains(action)).map(str::to_owned).collect()
}

fn who(policy: &Policy) -> String {
    match policy.principal_constraint() {
        PrincipalConstraint::Any | PrincipalConstraint::Is(_) => "any user".to_owned(),
        PrincipalConstraint::Eq(user) => id(&user),
        PrincipalConstraint::In(entity) | PrincipalConstraint::IsIn(_, entity) if is(&entity, "User") => id(&entity),
        PrincipalConstraint::In(entity) | PrincipalConstraint::IsIn(_, entity) => {
            format!("any user of {}", id(&entity))
        }
    }
}

/// The actions with their objects: `acquire and publish on any service of Husky, and stop Husky`.
fn objects(policy: &Policy, actions: &[String]) -> String {
    let has = |action: &&str| actions.iter().any(|one| one == action);
    let on_service: Vec<&str> = OF_SERVICE.iter().filter(|(action, _)| has(action)).map(|(_, verb)| *verb).collect();
    let on_robot: Vec<&str> = OF_ROBOT.into_iter().filter(has).collect();
    let (service, robot) = resources(&policy.resource_constraint());
    let part = |verbs: Vec<&str>, object: Option<String>| match object {
        Some(object) if !verbs.is_empty() => Some(format!("{} {object}", list(&verbs))),
        _ => None,
    };
    let parts: Vec<String> = [part(on_service, service), part(on_robot, robot)].into_iter().flatten().collect();
    if parts.is_empty() { "do nothing".to_owned() } else { parts.join(", and ") }
}

/// The services and the robots that a constraint admits.
fn resources(constraint: &ResourceConstraint) -> (Option<String>, Option<String>) {
    let service_in = |entity: &EntityUid| match entity.type_name().basename() {
        "Service" => id(entity),
        "Robot" => format!("any service of {}", id(entity)),
        _ => format!("any service of a robot of {}", id(entity)),
    };
    let robot_in = |entity: &EntityUid| match entity.type_name().basename() {
        "Service" => None,
        "Robot" => Some(id(entity)),
        _ => Some(format!("any robot of {}", id(entity))),
    };
    let (service, robot) = (Some("any service".to_owned()), Some("any robot".to_owned()));
    match constraint {
        ResourceConstraint::Any => (service, robot),
        ResourceConstraint::Is(kind) if kind.basename() == "Robot" => (None, robot),
        ResourceConstraint::Is(_) => (service, None),
        ResourceConstraint::Eq(entity) if is(entity, "Service") => (Some(id(entity)), None),
        ResourceConstraint::Eq(entity) => (None, Some(id(entity))),
        ResourceConstraint::In(entity) => (Some(service_in(entity)), robot_in(entity)),
        ResourceConstraint::IsIn(kind, entity) if kind.basename() == "Robot" => (None, robot_in(entity)),
        ResourceConstraint::IsIn(_, entity) => (Some(service_in(entity)), None),
    }
}

fn is(entity: &EntityUid, kind: &str) -> bool {
    entity.type_name().basename() == kind
}

fn id(entity: &EntityUid) -> String {
    entity.id().unescaped().to_owned()
}

/// `a, b and c`.
fn list(words: &[&str]) -> String {
    match words {
        [first @ .., last] if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        _ => words.concat(),
    }
}

/// The conditions of a policy, all of which must hold.
fn when(policy: &Policy, phrases: &[(Value, &str)]) -> Vec<String> {
    let Ok(json) = policy.to_json() else { return Vec::new() };
    let mut told = Vec::new();
    for clause in json.get("conditions").and_then(Value::as_array).into_iter().flatten() {
        let Some(body) = clause.get("body") else { continue };
        if clause.get("kind").and_then(Value::as_str) == Some("unless") {
            split(body, "||", &mut |part| told.push(format!("not: {}", in_words(part, phrases))));
        } else {
            split(body, "&&", &mut |part| told.push(in_words(part, phrases)));
        }
    }
    told
}

/// A condition in words, or else in Cedar.
fn in_words(part: &Value, phrases: &[(Value, &str)]) -> String {
    if let Some((_, words)) = phrases.iter().find(|(phrase, _)| phrase == part) {
        return (*words).to_owned();
    }
    let literal = |value: &Value| value.get("Value").and_then(Value::as_str).map(str::to_owned);
    let is_principal = |value: &Value| value.get("Var").and_then(Value::as_str) == Some("principal");
    if let Some((entity, tag)) = operands(part, "hasTag")
        && let (true, Some(tag)) = (is_principal(entity), literal(tag))
    {
        return format!("their certificate has the attribute {tag}");
    }
    if let Some((left, right)) = operands(part, "==")
        && let Some(value) = literal(right)
    {
        if let Some((entity, tag)) = operands(left, "getTag")
            && let (true, Some(tag)) = (is_principal(entity), literal(tag))
        {
            return format!("their attribute {tag} is {value}");
        }
        let attribute = left.get(".").filter(|access| access.get("left").is_some_and(is_principal));
        if let Some(attribute) = attribute.and_then(|access| access.get("attr")).and_then(Value::as_str) {
            return format!("their {attribute} is {value}");
        }
    }
    moment(part).or_else(|| text(part)).unwrap_or_else(|| part.to_string())
}

/// A bound of the time of the ledger.
fn moment(part: &Value) -> Option<String> {
    let bound = |operator: &str, words: &str| {
        let (left, right) = operands(part, operator)?;
        let access = left.get(".")?;
        let is_time = access.get("left")?.get("Var")?.as_str()? == "context" && access.get("attr")?.as_str()? == "time";
        let milliseconds = right.get("Value")?.as_u64().filter(|_| is_time)?;
        Some(format!("it is {words} {}", rfc3339_seconds(milliseconds.checked_mul(1000)?)))
    };
    bound("<", "before").or_else(|| bound(">=", "not before"))
}

/// A limit in words; none for annotations that are for people.
fn limit(name: &str, value: &str) -> Option<String> {
    let value = shown(value);
    let value = value.trim_matches('"');
    Some(match name {
        "between" => format!("within {value}"),
        "max_rate" => format!("at most {value} messages a second"),
        "max_age" => format!("messages of at most {value}"),
        "max_linear" => format!("at most {value} m/s"),
        "max_angular" => format!("at most {value} rad/s"),
        "priority" => format!("priority {value}"),
        _ => return None,
    })
}

#[cfg(test)]
#[expect(clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        meanings(text).into_iter().map(|policy| policy.meaning).collect()
    }

    #[test]
    fn each_permit_says_whom_it_lets_do_what() {
        let text = r#"
            permit (principal, action, resource);
            permit (principal == User::"Org1/Salma", action in [Action::"stop", Action::"acquire"], resource in Robot::"Husky");
            permit (principal in Organisation::"Org1", action == Action::"override", resource == Service::"Husky/cmd_vel");
            forbid (principal, action, resource is Robot);"#;
        assert_eq!(
            words(text),
            [
                "any user may acquire, publish on and subscribe to any service",
                "Org1/Salma may acquire any service of Husky, and stop Husky",
                "any user of Org1 may override the holder of Husky/cmd_vel",
                "any user may not stop and resume any robot",
            ]
        );
        assert_eq!(meanings(text)[0].except, NAMED_RIGHTS);
        assert!(meanings(text)[1].except.is_empty());
        assert_eq!(meanings(text)[3].except, ["stop"]);
        assert_eq!(meanings(text).iter().map(|policy| policy.line).collect::<Vec<_>>(), [2, 3, 4, 5]);
    }

    #[test]
    fn conditions_and_limits_are_in_words_where_there_are_words() {
        let text = r#"@max_linear("0.2") @between("08:00-18:00 Mon-Fri Z") @description("x")
            permit (principal, action, resource is Service) when {
                resource.trusted.contains(principal.organisation) && principal.hasTag("guest") &&
                principal.getTag("guest") == "yes" && principal.role == "member" && context.time < 5
            } unless { principal.name like "A*" };"#;
        let meaning = &meanings(text)[0];
        assert_eq!(
            meaning.when,
            [
                "the owner of the robot trusts their organisation",
                "their certificate has the attribute guest",
                "their attribute guest is yes",
                "their role is member",
                "it is before 1970-01-01T00:00:00Z",
                "not: principal.name like \"A*\"",
            ]
        );
        let mut limits = meaning.limits.clone();
        limits.sort();
        assert_eq!(limits, ["at most 0.2 m/s", "within 08:00-18:00 Mon-Fri Z"]);
    }
}
