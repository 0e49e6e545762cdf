//! Policies by the entities that they can apply to, so that a decision looks at few of many.
//!
//! A policy may name a resource in its scope: `resource == Service::"…"`, `resource in Robot::"…"`. For every other
//! resource it is false before its conditions are looked at. So leaving it out changes neither decision, nor reasons,
//! nor faults. The same goes for one that names a principal.

use cedar_policy::{EntityUid, Policy, PolicySet, PrincipalConstraint, ResourceConstraint};
use std::collections::HashMap;

/// The policies of an organisation.
#[derive(Default)]
pub(super) struct Index {
    /// Those that name neither a resource nor a principal.
    any: PolicySet,
    /// Those that name a resource, or something that it must be in.
    resources: HashMap<EntityUid, PolicySet>,
    /// Those that name no resource, but a principal, or something that it must be in.
    principals: HashMap<EntityUid, PolicySet>,
}

impl Index {
    /// Adds a policy.
    ///
    /// # Errors
    /// Its id is taken.
    pub(super) fn add(&mut self, policy: Policy) -> Result<(), String> {
        let set = if let Some(resource) = resource(&policy) {
            self.resources.entry(resource).or_default()
        } else if let Some(principal) = principal(&policy) {
            self.principals.entry(principal).or_default()
        } else {
            &mut self.any
        };
        set.add(policy).map_err(|fault| fault.to_string())
    }

    /// All of them, in no order.
    pub(super) fn all(&self) -> impl Iterator<Item = &Policy> {
        let sets = std::iter::once(&self.any).chain(self.resources.values()).chain(self.principals.values());
        sets.flat_map(PolicySet::policies)
    }

    /// Every set with policies that can apply. `principals` and `resources` are each the entity itself and all that it
    /// is in.
    pub(super) fn candidates<'a>(
        &'a self,
        principals: &'a [EntityUid],
        resources: &'a [EntityUid],
    ) -> impl Iterator<Item = &'a PolicySet> {
        let by_principal = principals.iter().filter_map(|entity| self.principals.get(entity));
        let by_resource = resources.iter().filter_map(|entity| self.resources.get(entity));
        std::iter::once(&self.any).chain(by_principal).chain(by_resource)
    }
}

#[cfg(test)]
impl Index {
    /// One that looks at every policy, to compare with.
    pub(super) fn of_all(any: PolicySet) -> Self {
        Self { any, ..Self::default() }
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
