//! `set_policy_approvals`: the rule of the network about who must agree to policies.

use crate::arguments::Arguments;
use crate::lifecycle::policy_approvals;
use crate::lifecycle::policy_approvals::{NO_RULE, OF_NETWORK};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// The function that sets the rule of the network. It needs approval.
pub(crate) const SET: &str = "set_policy_approvals";

/// `set_policy_approvals QUORUM|none`: the rule of the network, by a proposal.
pub(crate) fn set(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("set_policy_approvals QUORUM|none", args, 1, 1)?;
    let text = args.text(0, "QUORUM")?;
    let quorum = match text {
        NO_RULE => None,
        text => Some(policy_approvals::quorum(ctx, args, text)?.to_string()),
    };
    match &quorum {
        Some(quorum) => store::write(ctx, store::APPROVALS, quorum)?,
        None => ctx.delete(store::APPROVALS),
    }
    let told = store::json(&quorum)?;
    ctx.emit("policy_approvals", OF_NETWORK, told.clone());
    Ok(told)
}
