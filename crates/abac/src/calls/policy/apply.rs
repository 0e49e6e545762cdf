//! `policy apply`: a set takes the place of the one in force.

use crate::arguments::Arguments;
use crate::lifecycle::policy_sets::Draft;
use crate::lifecycle::policy_sets::Made;
use crate::lifecycle::{policy_approvals, policy_sets, reachable, robots};
use crate::policy::decider::Decider;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyChange;

/// `policy apply SET_JSON`: the set takes the place of the one in force, if an admin may decide that alone.
pub(crate) fn apply(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy apply SET_JSON", args, 1, 1)?;
    let caller = robots::admin(ctx, "change policies")?;
    let organisation = &caller.organisation;
    let draft = policy_sets::read(ctx, decider, organisation, args)?;
    policy_approvals::check_alone(ctx, caller)?;
    if draft.is_in_force {
        return store::json(&PolicyChange {
            organisation: organisation.clone(),
            id: String::new(),
            change: "unchanged".to_owned(),
            default_in_force: draft.texts.is_empty(),
            ended: Vec::new(),
            version: draft.base,
            by: caller.id(),
            message: draft.message,
        });
    }
    reachable::check(ctx, decider, organisation, &draft.texts, draft.means_it)?;
    let Draft { texts, message, restores, rule, .. } = draft;
    let made = Made { by: caller.id(), message, restores, rule, ..Made::default() };
    policy_sets::replace(ctx, decider, organisation, &texts, policy_sets::done(restores), made)
}
