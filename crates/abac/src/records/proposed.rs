//! Sets of policies that wait for approvals, or to be applied.

use super::principal::Principal;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyDigest;
use serde::{Deserialize, Serialize};

/// A proposed set, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Proposed {
    pub(crate) id: String,
    pub(crate) organisation: String,
    /// The number of the set that it replaces.
    pub(crate) base: u64,
    pub(crate) by: String,
    pub(crate) message: String,
    /// Block time, microseconds.
    pub(crate) created: u64,
    pub(crate) height: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) restores: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) approvals: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) means_it: bool,
    /// Over its texts.
    pub(crate) hash: String,
    pub(crate) policies: Vec<PolicyDigest>,
    pub(crate) approved: Vec<Approval>,
}

/// One who agrees.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Approval {
    /// Without its attributes: nothing asks for them, and they may be long.
    pub(crate) principal: Principal,
    /// Until when it counts (block time, microseconds).
    pub(crate) until: u64,
}

impl Proposed {
    /// The approvals that count at this block time (microseconds).
    pub(crate) fn counted(&self, now: u64) -> impl Iterator<Item = &Approval> {
        self.approved.iter().filter(move |approval| now <= approval.until.min(approval.principal.not_after))
    }
}

/// One of them.
pub(crate) fn find(ctx: &Context<'_>, id: &str) -> Result<Option<Proposed>, Rejection> {
    store::read(ctx, &store::proposed_key(id))
}

/// Writes one, and with which certificates it is approved now.
pub(crate) fn write(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<(), Rejection> {
    remove(ctx, &proposed.id)?;
    proposed.approved.iter().for_each(|approval| ctx.put(&approving_key(approval, &proposed.id), Bytes::new()));
    store::write(ctx, &store::proposed_key(&proposed.id), proposed)
}

/// Removes one.
pub(crate) fn remove(ctx: &mut Context<'_>, id: &str) -> Result<(), Rejection> {
    let approved = find(ctx, id)?.map(|before| before.approved).unwrap_or_default();
    approved.iter().for_each(|approval| ctx.delete(&approving_key(approval, id)));
    ctx.delete(&store::proposed_key(id));
    Ok(())
}

fn approving_key(Approval { principal, .. }: &Approval, id: &str) -> Vec<u8> {
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    [store::approving_prefix(&principal.issuer.0, &serial).as_slice(), id.as_bytes()].concat()
}

/// All of them, in order of ids.
pub(crate) fn all(ctx: &Context<'_>) -> Result<Vec<Proposed>, Rejection> {
    ctx.range(store::PROPOSED, usize::MAX).iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// Takes back what a revoked certificate has approved.
pub(crate) fn revoked(ctx: &mut Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Result<(), Rejection> {
    let prefix = store::approving_prefix(issuer, serial);
    let serial = hex::encode(serial);
    let theirs = |approval: &Approval| approval.principal.issuer.0 == *issuer && approval.principal.serial == serial;
    for (key, _) in ctx.range(&prefix, usize::MAX) {
        let id = key.strip_prefix(&prefix[..]).and_then(|id| std::str::from_utf8(id).ok());
        if let Some(mut proposed) = id.map(|id| find(ctx, id)).transpose()?.flatten() {
            proposed.approved.retain(|approval| !theirs(approval));
            store::write(ctx, &store::proposed_key(&proposed.id), &proposed)?;
        }
        ctx.delete(&key);
    }
    Ok(())
}
