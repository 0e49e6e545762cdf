//! The end of an organisation's membership.

use super::arguments::RemoveOrganisation;
use super::caller::{admin, object};
use super::organisations::{describe, find, names, unknown};
use super::own_call::own_call;
use super::proposals::{self, decide};
use super::store::{self, former_key, json, organisation_key};
use super::{REMOVE_ORGANISATION, allowance, certificate_rule, invitations, node_roles, quorums, quotas};
use crate::chaincode::Context;
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};

/// `remove_organisation {name}`: needs approval. Its nodes become removed, the rights of its members end in this block, and its
/// certificates count no longer behind this transaction.
pub(super) fn remove(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let remove: RemoveOrganisation = object("remove_organisation", argument, "{\"name\": NAME}")?;
    if ctx.approved_by().is_some() {
        return execute_remove(ctx, &remove.name);
    }
    let caller = admin(ctx, "remove organisations")?;
    check_removable(ctx, &remove.name)?;
    json(&decide(ctx, caller, own_call(REMOVE_ORGANISATION, &remove)?)?)
}

/// Does what was approved.
fn execute_remove(ctx: &mut Context<'_>, name: &str) -> Result<Bytes, Rejection> {
    let organisation = check_removable(ctx, name)?;
    node_roles::remove_all_of(ctx, name)?;
    store::write(ctx, &former_key(name), &organisation)?;
    ctx.delete(organisation_key(name).as_bytes());
    proposals::forget_approvals(ctx, |approval| approval.organisation == name)?;
    invitations::forget_organisation(ctx, name)?;
    quorums::forget_organisation(ctx, name)?;
    allowance::forget(ctx, name);
    quotas::forget_organisation(ctx, name);
    certificate_rule::forget_organisation(ctx, name)?;
    let answer = json(&describe(&organisation)?)?;
    ctx.emit("organisation_removed", name, answer.clone());
    ctx.tell_organisation_removed(name)?;
    Ok(answer)
}

fn check_removable(ctx: &Context<'_>, name: &str) -> Result<FoundingOrganisation, Rejection> {
    let organisation = find(ctx, name)?.ok_or_else(|| unknown(ctx, name))?;
    if names(ctx)?.len() == 1 {
        return Err(
            Rejection::new(Code::LastOne, format!("{name} is the last organisation")).wanted("another organisation")
        );
    }
    Ok(organisation)
}
