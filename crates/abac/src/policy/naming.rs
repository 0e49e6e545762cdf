//! Rights that a policy must name: `override`, `confirm`, `stop` and `resume`.
//!
//! Only the scope names an action: `action == Action::"stop"` or `action in [Action::"stop", …]`. It is read without evaluating
//! anything, by people and by this code. A condition that speaks of one of these actions without the scope is rejected.
//! In a permit it would give nothing. In a forbid it would leave the right to those who have it by rule.

use super::action::NAMED_RIGHTS;
use super::misfit::Misfit;
use cedar_policy::{ActionConstraint, Effect, EntityUid, Policy, PolicySet, ResourceConstraint};
use serde_json::Value;

/// The actions that the scope of a policy names.
pub(super) fn named(policy: &Policy) -> Vec<EntityUid> {
    match policy.action_constraint() {
        ActionConstraint::Any => Vec::new(),
        ActionConstraint::In(several) => several,
        ActionConstraint::Eq(one) => vec![one],
    }
}

/// Does the scope of a policy name this action?
pub(super) fn names(policy: &Policy, action: &str) -> bool {
    named(policy).iter().any(|named| is_action(named, action))
}

/// Does the scope of a policy name one of the rights that must be named?
pub(super) fn names_a_right(policy: &Policy) -> bool {
    NAMED_RIGHTS.iter().any(|right| names(policy, right))
}

fn is_action(entity: &EntityUid, action: &str) -> bool {
    entity.type_name().basename() == "Action" && entity.id().unescaped() == action
}

/// Does each policy name the rights that it speaks of, and does each permit give something?
pub(super) fn check(policies: &PolicySet) -> Result<(), Vec<Misfit>> {
    let faults: Vec<Misfit> = policies.policies().flat_map(faults).collect();
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

fn faults(policy: &Policy) -> Vec<Misfit> {
    let fault = |message: String, quoted: String| Misfit { message, policy: policy.to_string(), quoted };
    let conditions = policy.to_json().ok().and_then(|mut json| json.get_mut("conditions").map(Value::take));
    let unnamed = NAMED_RIGHTS.into_iter().filter(|right| {
        !names(policy, right) && conditions.as_ref().is_some_and(|conditions| speaks_of(conditions, right))
    });
    let mut faults: Vec<Misfit> = unnamed
        .map(|right| {
            let quoted = format!("Action::\"{right}\"");
            let message = format!(
                "a condition uses {quoted}, but the scope does not name it; wanted action in \
                                   [{quoted}, …] in the scope"
            );
            fault(message, quoted)
        })
        .collect();
    let open = policy.effect() == Effect::Permit && policy.action_constraint() == ActionConstraint::Any;
    if open && is_of_robots(&policy.resource_constraint()) {
        faults.push(fault(
            "the permit has no effect: stop and resume of a robot must be named, other actions are of its services; \
             wanted action in [Action::\"stop\", …], or a resource in Robot::\"…\""
                .to_owned(),
            "resource".to_owned(),
        ));
    }
    faults
}

/// Is it a constraint that only robots meet, and no service?
fn is_of_robots(constraint: &ResourceConstraint) -> bool {
    let is_robot = |kind: &cedar_policy::EntityTypeName| kind.basename() == "Robot";
    match constraint {
        ResourceConstraint::Eq(entity) => is_robot(entity.type_name()),
        ResourceConstraint::Is(kind) | ResourceConstraint::IsIn(kind, _) => is_robot(kind),
        ResourceConstraint::Any | ResourceConstraint::In(_) => false,
    }
}

/// Is there a literal of this action in an expression?
fn speaks_of(expression: &Value, action: &str) -> bool {
    match expression {
        Value::Array(several) => several.iter().any(|one| speaks_of(one, action)),
        Value::Object(fields) => {
            let is_it = |entity: &Value| {
                entity.get("type").and_then(Value::as_str) == Some("Action")
                    && entity.get("id").and_then(Value::as_str) == Some(action)
            };
            fields.get("__entity").is_some_and(is_it) || fields.values().any(|one| speaks_of(one, action))
        }
        _ => false,
    }
}
