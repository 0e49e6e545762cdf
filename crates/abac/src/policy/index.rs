//! Policies by the entities that they can apply to, so that a decision looks at few of many.
//!
//! A policy may name a resource in its scope: `resource == Service::"…"`, `resource in Robot::"…"`. For every other
//! resource it is false before its conditions are looked at. So leaving it out changes neither decision, nor reasons,
//! nor faults. The same goes for one that names a principal.

use super::Question;
use super::action::NAMED_RIGHTS;
use super::naming::names_a_right;
use cedar_policy::{Effect, EntityUid, Policy, PolicySet, PrincipalConstraint, ResourceConstraint};
use std::collections::HashMap;

/// Policies by the entities that they name.
#[derive(Default)]
struct Sets {
    /// Those that name neither a resource nor a principal.
    any: PolicySet,
    /// Those that name a resource, or something that it must be in.
    resources: HashMap<EntityUid, PolicySet>,
    /// Those that name no resource, but a principal, or something that it must be in.
    principals: HashMap<EntityUid, PolicySet>,
}

/// The policies of an organisation.
#[derive(Default)]
pub(super) struct Index {
    /// All of them, for the actions that need not be named.
    all: Sets,
    /// Those that decide about rights that must be named: every `forbid`, and the permits that name one.
    of_rights: Sets,
    /// Those that take a right which somebody has by rule: the `forbid`s that name one.
    against_rules: Sets,
}

impl Index {
    /// Adds a policy.
    ///
    /// # Errors
    /// Its id is taken.
    pub(super) fn add(&mut self, policy: Policy) -> Result<(), String> {
        let (forbids, names) = (policy.effect() == Effect::Forbid, names_a_right(&policy));
        if forbids && names {
            self.against_rules.add(policy.clone())?;
        }
        if forbids || names {
            self.of_rights.add(policy.clone())?;
        }
        self.all.add(policy)
    }

    /// Those that decide about a question, in no order.
    pub(super) fn all<'a>(&'a self, question: &Question) -> impl Iterator<Item = &'a Policy> + use<'a> {
        let Sets { any, resources, principals } = self.sets(question);
        let sets = std::iter::once(any).chain(resources.values()).chain(principals.values());
        sets.flat_map(PolicySet::policies)
    }

    /// Every set with policies that can apply. `principals` and `resources` are each the entity itself and all that it
    /// is in.
    pub(super) fn candidates<'a>(
        &'a self,
        question: &Question,
        principals: &'a [EntityUid],
        resources: &'a [EntityUid],
    ) -> impl Iterator<Item = &'a PolicySet> + use<'a> {
        let sets = self.sets(question);
        let by_principal = principals.iter().filter_map(|entity| sets.principals.get(entity));
        let by_resource = resources.iter().filter_map(|entity| sets.resources.get(entity));
        std::iter::once(&sets.any).chain(by_principal).chain(by_resource)
    }

    fn sets(&self, question: &Question) -> &Sets {
        match question {
            Question { by_rule: true, .. } => &self.against_rules,
            Question { action, .. } if NAMED_RIGHTS.contains(action) => &self.of_rights,
            Question { .. } => &self.all,
        }
    }
}

impl Sets {
    fn add(&mut self, policy: Policy) -> Result<(), String> {
        let set = if let Some(resource) = resource(&policy) {
            self.resources.entry(resource).or_default()
        } else if let Some(principal) = principal(&policy) {
            self.principals.entry(principal).or_default()
        } else {
            &mut self.any
        };
        set.add(policy).map_err(|fault| fault.to_string())
    }
}

#[cfg(test)]
impl Index {
    /// One that looks at every policy, to compare with.
    pub(super) fn of_all(any: PolicySet) -> Self {
        Self { all: Sets { any, ..Sets::default() }, ..Self::default() }
    }
}

fn resource(policy: &Policy) -> Option<EntityUid> {
    match policy.resource_constraint() {
        ResourceConstraint::Eq(entity) | ResourceConstraint::In(entity) | ResourceConstraint::IsIn(_, entity) => {
            Some(entity)
        }
        ResourceConstraint::Any | ResourceConstraint::Is(_) => None,
    }
}

fn principal(policy: &Policy) -> Option<EntityUid> {
    match policy.principal_constraint() {
        PrincipalConstraint::Eq(entity) | PrincipalConstraint::In(entity) | PrincipalConstraint::IsIn(_, entity) => {
            Some(entity)
        }
        PrincipalConstraint::Any | PrincipalConstraint::Is(_) => None,
    }
}
