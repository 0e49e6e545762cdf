//! Expressions of Cedar as JSON.

use cedar_policy::Policy;
use serde_json::{Value, json};

/// The operands of a chain of one operator, in order.
pub(super) fn split(expression: &Value, operator: &str, each: &mut impl FnMut(&Value)) {
    match operands(expression, operator) {
        Some((left, right)) => {
            split(left, operator, each);
            split(right, operator, each);
        }
        None => each(expression),
    }
}

pub(super) fn operands<'e>(expression: &'e Value, operator: &str) -> Option<(&'e Value, &'e Value)> {
    let both = expression.get(operator)?;
    Some((both.get("left")?, both.get("right")?))
}

/// The expression as Cedar; none if it is none.
pub(super) fn text(expression: &Value) -> Option<String> {
    let all = json!({"op": "All"});
    let policy = json!({
        "effect": "permit", "principal": all, "action": all, "resource": all,
        "conditions": [{"kind": "when", "body": expression}],
    });
    let policy = Policy::from_json(None, policy).ok()?.to_cedar()?;
    let (_, body) = policy.split_once("when {")?;
    Some(body.trim_end().strip_suffix("};")?.trim().to_owned())
}
