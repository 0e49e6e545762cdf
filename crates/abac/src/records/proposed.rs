//! Sets of policies that wait for approvals, or to be applied.

use super::principal::Principal;
use super::store;
use ledger::Context;
use ledger_contract::PolicyDigest;
use ledger_rejection::Rejection;
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

/// All of them, in order of ids.
pub(crate) fn all(ctx: &Context<'_>) -> Result<Vec<Proposed>, Rejection> {
    ctx.range(store::PROPOSED, usize::MAX).iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// Takes back what a revoked certificate has approved.
pub(crate) fn revoked(ctx: &mut Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Result<(), Rejection> {
    let serial = hex::encode(serial);
    let theirs = |approval: &Approval| approval.principal.issuer.0 == *issuer && approval.principal.serial == serial;
    for mut proposed in all(ctx)? {
        if proposed.approved.iter().any(theirs) {
            proposed.approved.retain(|approval| !theirs(approval));
            store::write(ctx, &store::proposed_key(&proposed.id), &proposed)?;
        }
    }
    Ok(())
}
