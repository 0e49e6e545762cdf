//! Why policies decide as they do: the conditions of each, and the values found.
//!
//! A policy is a conjunction: its scope, what it says with `when`, and the contrary of what it says with `unless`. Each part
//! is evaluated by itself. A part that fails is told with the values of what it speaks of. A part that cannot be evaluated
//! is left out: one before it fails and guards it, as `hasTag` does `getTag`.
//!
//! Cedar reads each part anew, which takes much longer than a decision. So the work is bounded, and questions are explained on
//! another thread than the one that blocks wait for.

use super::annotation::Said;
use super::asked::{Asked, asked};
use super::expression::{self, operands, split};
use super::index::Index;
use super::{Question, display};
use cedar_policy::{Authorizer, Decision, Effect, EvalResult, Expression, Policy, eval_expression};
use ledger_base::moment::rfc3339;
use ledger_contract::Condition;
use serde_json::{Value, json};
use std::cell::Cell;

/// Work for somebody who asks for an explanation, in parts of expressions that Cedar reads.
pub(crate) const WORK_OF_QUESTION: usize = 8192;
/// Work for a refusal, which everybody can cause.
pub(crate) const WORK_OF_REFUSAL: usize = 1024;
/// Work of reading an expression, however small it is, and of reading a policy.
const WORK_OF_READING: usize = 8;
const WORK_OF_POLICY: usize = 16;
/// A value this deep is as much work as reading an expression adds for it.
const SHALLOW: usize = 4;
/// Most policies that are told, those with the fewest parts that fail first.
const TOLD_MAX: usize = 4;
/// Most values that are told with one part.
const TERMS_MAX: usize = 6;
/// Longest text of a part or a value, in characters.
const TEXT_MAX: usize = 160;

/// The part of a decision that the conditions of policies explain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Explanation {
    /// The policies that decided.
    pub(crate) deciding: Vec<String>,
    /// For a denial, what each policy that could permit it misses, the nearest policy first; or what makes a policy forbid.
    pub(crate) conditions: Vec<Condition>,
    /// Does it hold whatever the time is?
    pub(crate) timeless: bool,
}

/// The parts of a policy.
struct Weighed {
    /// Those that fail, for a policy that permits.
    failed: Vec<Condition>,
    /// The parts that hold, for a policy that forbids.
    held: Vec<Condition>,
}

/// Explains the decision of a set of policies.
///
/// # Errors
/// The fault of a question, in Cedar's words.
pub(super) fn explain(policies: &Index, question: &Question, work: usize) -> Result<Explanation, String> {
    let asked = asked(question)?;
    let deciding = deciding(policies, question, &asked)?;
    let effect = match deciding.first() {
        Some((Effect::Permit, _)) => {
            let deciding = deciding.into_iter().map(|(_, id)| id).collect();
            return Ok(Explanation { deciding, ..Explanation::default() });
        }
        Some((effect, _)) => *effect,
        None => Effect::Permit,
    };
    let deciding: Vec<String> = deciding.into_iter().map(|(_, id)| id).collect();
    let mut all: Vec<&Policy> = policies.all(question).filter(|policy| policy.effect() == effect).collect();
    all.retain(|policy| effect == Effect::Permit || deciding.contains(&policy.id().to_string()));
    all.sort_by_key(|policy| policy.id().to_string());
    let work = Work { asked, left: Cell::new(work), skipped: Cell::new(false) };
    let mut weighed = Vec::new();
    for policy in all {
        if !work.spend(WORK_OF_POLICY) {
            break;
        }
        let parts = weigh(policy, question, &work)?;
        // Half of its parts would tell the wrong reason.
        if !work.skipped.replace(false) {
            weighed.extend(parts);
        }
    }
    weighed.sort_by_key(|policy| policy.failed.len());
    let told = weighed.into_iter().take(TOLD_MAX);
    let conditions = told.flat_map(|policy| if effect == Effect::Permit { policy.failed } else { policy.held });
    Ok(Explanation { deciding, conditions: conditions.collect(), timeless: false })
}

/// The policies that decided, in order: those that forbid it, or else those that permit it.
fn deciding(policies: &Index, question: &Question, asked: &Asked) -> Result<Vec<(Effect, String)>, String> {
    let mut deciding = Vec::new();
    for set in policies.candidates(question, &asked.principals, &asked.resources) {
        let response = Authorizer::new().is_authorized(&asked.request, set, &asked.entities);
        let permits = response.decision() == Decision::Allow;
        for id in response.diagnostics().reason() {
            if !permits || matches!(question.said(set, id)?, Said::Permits(_)) {
                deciding.push((if permits { Effect::Permit } else { Effect::Forbid }, id.to_string()));
            }
        }
    }
    let forbids = deciding.iter().any(|(effect, _)| *effect == Effect::Forbid);
    deciding.retain(|(effect, _)| (*effect == Effect::Forbid) == forbids);
    deciding.sort_by(|(_, one), (_, other)| one.cmp(other));
    Ok(deciding)
}

/// A question, and the work that is left to explain its answer.
struct Work {
    asked: Asked,
    left: Cell<usize>,
    /// Was something too much work?
    skipped: Cell<bool>,
}

impl Work {
    /// Takes so much work, if it is left.
    fn spend(&self, work: usize) -> bool {
        let left = self.left.get().checked_sub(work);
        self.left.set(left.unwrap_or(self.left.get()));
        self.skipped.set(self.skipped.get() || left.is_none());
        left.is_some()
    }
}

/// The parts of a policy, each evaluated; none if the policy is about other actions or other robots.
fn weigh(policy: &Policy, question: &Question, work: &Work) -> Result<Option<Weighed>, String> {
    let json = policy.to_json().map_err(display)?;
    let is_false = |part: &Value| matches!(value(part, work), Some(EvalResult::Bool(false)));
    if ["action", "resource"].iter().filter_map(|of| scope(&json, of)).any(|part| is_false(&part)) {
        return Ok(None);
    }
    let mut parts: Vec<Value> = scope(&json, "principal").into_iter().collect();
    for clause in json.get("conditions").and_then(Value::as_array).into_iter().flatten() {
        let Some(body) = clause.get("body") else { continue };
        if clause.get("kind").and_then(Value::as_str) == Some("unless") {
            split(body, "||", &mut |part| parts.push(json!({"!": {"arg": part}})));
        } else {
            split(body, "&&", &mut |part| parts.push(part.clone()));
        }
    }
    let name = policy.id().to_string();
    let permits = policy.effect() == Effect::Permit;
    let (mut failed, mut held) = (Vec::new(), Vec::new());
    for part in &parts {
        match value(part, work) {
            Some(EvalResult::Bool(false)) if permits => failed.push(condition(&name, part, work)),
            Some(EvalResult::Bool(true)) if !permits => held.push(condition(&name, part, work)),
            _ => {}
        }
    }
    if failed.is_empty()
        && permits
        && let Said::Closed(window) = question.said_by(policy)?
    {
        failed.push(Condition {
            policy: name.clone(),
            condition: format!("@between({window:?})"),
            found: format!("the time is {}", moment(question.time_ms)),
            wanted: format!("a time within {window}"),
        });
    }
    Ok(Some(Weighed { failed, held }))
}

/// A constraint of the scope as an expression; none if there is none.
fn scope(policy: &Value, of: &str) -> Option<Value> {
    let constraint = policy.get(of)?;
    let variable = json!({"Var": of});
    let entity = |entity: &Value| json!({"Value": {"__entity": entity.clone()}});
    match constraint.get("op")?.as_str()? {
        op @ ("==" | "in") => match (constraint.get("entity"), constraint.get("entities")) {
            (Some(one), _) => Some(json!({op: {"left": variable, "right": entity(one)}})),
            (None, Some(Value::Array(several))) => {
                let set: Vec<Value> = several.iter().map(entity).collect();
                Some(json!({op: {"left": variable, "right": {"Set": set}}}))
            }
            _ => None,
        },
        "is" => {
            let kind = constraint.get("entity_type")?;
            match constraint.get("in").and_then(|within| within.get("entity")) {
                Some(within) => Some(json!({"is": {"left": variable, "entity_type": kind, "in": entity(within)}})),
                None => Some(json!({"is": {"left": variable, "entity_type": kind}})),
            }
        }
        _ => None,
    }
}

/// A part of a policy with the values that decided it.
fn condition(policy: &str, part: &Value, work: &Work) -> Condition {
    let (found, wanted) = told(part, work);
    let condition = text(part, work).unwrap_or_default();
    Condition { policy: policy.to_owned(), condition: short(condition), found: short(found), wanted: short(wanted) }
}

/// The values found in a part, and what is wanted instead.
fn told(part: &Value, work: &Work) -> (String, String) {
    let shown = |expression: &Value| text(expression, work).unwrap_or_default();
    let valued = |expression: &Value| value(expression, work).map(|value| value.to_string());
    let whole = || (terms(part, work), shown(part));
    for operator in ["==", "!=", "<", "<=", ">", ">="] {
        let Some((left, right)) = operands(part, operator) else { continue };
        return match (is_literal(left), valued(right)) {
            (false, Some(wanted)) => (terms(left, work), format!("{} {operator} {wanted}", shown(left))),
            _ => whole(),
        };
    }
    if let Some((set, element)) = operands(part, "contains") {
        return match (is_literal(element), valued(set)) {
            (false, Some(wanted)) => (terms(element, work), format!("{} in {wanted}", shown(element))),
            _ => whole(),
        };
    }
    if let Some((entity, name)) = operands(part, "hasTag")
        && let Some(name) = valued(name)
    {
        let entity = shown(entity);
        return (format!("{entity} has no {name}"), format!("{entity} with {name}"));
    }
    whole()
}

/// The values of all that an expression speaks of.
fn terms(expression: &Value, work: &Work) -> String {
    let mut found = Vec::new();
    collect(expression, &mut found);
    let mut told: Vec<String> = Vec::new();
    for term in found.into_iter().take(TERMS_MAX) {
        let (Some(name), Some(value)) = (text(term, work), value(term, work)) else { continue };
        let time = match &value {
            EvalResult::Long(ms) if name == "context.time" => format!(" ({})", moment(*ms)),
            _ => String::new(),
        };
        let term = format!("{name} is {value}{time}");
        if !told.contains(&term) {
            told.push(term);
        }
    }
    if told.is_empty() { "false".to_owned() } else { told.join(", ") }
}

/// The variables, attributes and tags in an expression.
fn collect<'e>(expression: &'e Value, found: &mut Vec<&'e Value>) {
    let Some((operator, content)) = expression.as_object().and_then(|object| object.iter().next()) else { return };
    match operator.as_str() {
        "Value" => {}
        "Var" | "." | "has" => found.push(expression),
        "getTag" | "hasTag" => {
            found.push(expression);
            content.get("right").into_iter().for_each(|name| collect(name, found));
        }
        _ => match content {
            Value::Array(several) => several.iter().for_each(|one| collect(one, found)),
            Value::Object(fields) => fields.values().for_each(|one| match one {
                Value::Array(several) => several.iter().for_each(|one| collect(one, found)),
                one => collect(one, found),
            }),
            _ => {}
        },
    }
}

fn is_literal(expression: &Value) -> bool {
    let mut found = Vec::new();
    collect(expression, &mut found);
    found.is_empty()
}

/// The expression as Cedar; none if no work is left.
fn text(expression: &Value, work: &Work) -> Option<String> {
    if !work.spend(WORK_OF_READING + size(expression, 1) / SHALLOW) {
        return None;
    }
    expression::text(expression)
}

/// The values of an expression, each as often as it is deep: Cedar reads and writes what is deep again and again.
fn size(expression: &Value, depth: usize) -> usize {
    match expression {
        Value::Array(several) => several.iter().map(|one| size(one, depth + 1)).sum(),
        Value::Object(fields) => depth + fields.values().map(|one| size(one, depth + 1)).sum::<usize>(),
        _ => depth,
    }
}

/// The value of an expression; none if it cannot be evaluated.
fn value(expression: &Value, work: &Work) -> Option<EvalResult> {
    let expression: Expression = text(expression, work)?.parse().ok()?;
    eval_expression(&work.asked.request, &work.asked.entities, &expression).ok()
}

/// A time (milliseconds since the UNIX epoch) for people.
fn moment(ms: i64) -> String {
    u64::try_from(ms).map_or_else(|_| ms.to_string(), |ms| rfc3339(ms.saturating_mul(1000)))
}

fn short(text: String) -> String {
    match text.char_indices().nth(TEXT_MAX) {
        Some((end, _)) => format!("{}…", text.get(..end).unwrap_or_default()),
        None => text,
    }
}
