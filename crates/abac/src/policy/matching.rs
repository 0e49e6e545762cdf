//! Which policies of a text concern anybody among some questions.

use super::action::NAMED_RIGHTS;
use super::asked::{Asked, asked};
use super::naming::names;
use super::{Question, words};
use cedar_policy::{Authorizer, Effect, PolicySet};

/// For each policy, in the order of the text: does it apply to one of the questions? One that cannot be evaluated does.
pub(super) fn matching(text: &str, questions: &[Question]) -> Vec<bool> {
    let Ok(set) = text.parse::<PolicySet>() else { return Vec::new() };
    let policies = words::in_order(text, &set);
    let alone: Vec<PolicySet> =
        policies.iter().map(|(_, policy)| PolicySet::from_policies([(*policy).clone()]).unwrap_or_default()).collect();
    let mut matched = vec![false; policies.len()];
    for question in questions {
        if matched.iter().all(|matched| *matched) {
            break;
        }
        let Ok(Asked { request, entities, .. }) = asked(question) else { continue };
        for ((matched, set), (_, policy)) in matched.iter_mut().zip(&alone).zip(&policies) {
            let is_named = !NAMED_RIGHTS.contains(&question.action) || names(policy, question.action);
            if *matched || (policy.effect() == Effect::Permit && !is_named) {
                continue;
            }
            let response = Authorizer::new().is_authorized(&request, set, &entities);
            let diagnostics = response.diagnostics();
            *matched = diagnostics.reason().next().is_some() || diagnostics.errors().next().is_some();
        }
    }
    matched
}
