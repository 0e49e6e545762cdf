//! The policies that decide about an action, for proofs about all requests at once (`ledgerd policy prove`).

use super::action::NAMED_RIGHTS;
use super::naming::{names, names_a_right};
use super::{Engine, annotation, display};
use cedar_policy::{Effect, Policy, PolicyId, PolicySet};
use ledger_base::rejection::{Code, Rejection};

/// Policies of an organisation, each as the ledger would take it.
pub struct Analysis(Vec<Policy>);

impl Analysis {
    /// Reads policies, each text with its name.
    ///
    /// # Errors
    /// [`Code::PolicyInvalid`] with the faults, as `ledgerctl policy check` finds them.
    pub fn read<'a>(texts: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self, Rejection> {
        let engine = Engine::start()?;
        let mut policies = Vec::new();
        for (name, text) in texts {
            engine.check(text).map_err(|refused| refused.prefix(format!("{name}: ")))?;
            let unreadable = |fault: String| Rejection::new(Code::PolicyInvalid, format!("{name}: {fault}"));
            let set: PolicySet = text.parse().map_err(|fault| unreadable(display(fault)))?;
            let only = set.num_of_policies() == 1;
            let id = |policy: &Policy| if only { name.to_owned() } else { format!("{name}.{}", policy.id()) };
            policies.extend(set.policies().map(|policy| policy.new_id(PolicyId::new(id(policy)))));
        }
        Ok(Self(policies))
    }

    /// All policies, in no order.
    pub fn all(&self) -> impl Iterator<Item = &Policy> {
        self.0.iter()
    }

    /// Those that the ledger asks about an action: a right that must be named is given only by permits that name it.
    pub fn deciding(&self, action: &str) -> impl Iterator<Item = &Policy> {
        let is_named_right = NAMED_RIGHTS.contains(&action);
        let decides =
            move |policy: &&Policy| !is_named_right || policy.effect() == Effect::Forbid || names_a_right(policy);
        self.0.iter().filter(decides)
    }

    /// The `forbid`s that take a right from those who have it by rule.
    pub fn against_rule(&self, action: &str) -> impl Iterator<Item = &Policy> {
        self.0.iter().filter(move |policy| policy.effect() == Effect::Forbid && names(policy, action))
    }
}

/// The terms of a permit in one form: limits, windows of time, a priority. Empty if it has none.
pub fn terms(policy: &Policy) -> String {
    let mut terms: Vec<String> = annotation::meant(policy).map(|(name, value)| format!("@{name}({value:?})")).collect();
    terms.sort();
    terms.join(" ")
}
