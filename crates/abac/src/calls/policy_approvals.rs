//! `policy_approvals`: who must agree to the policies of an organisation.

use crate::arguments::Arguments;
use crate::lifecycle::policy_approvals;
use crate::records::store;
use bytes::Bytes;
use ledger::{Context, Quorum};
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyApprovals;

/// `policy_approvals ORGANISATION`: who must agree to its policies.
pub(crate) fn show(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy_approvals ORGANISATION", args, 1, 1)?;
    let organisation = args.text(0, "ORGANISATION")?.to_owned();
    let text = |quorum: Option<Quorum>| quorum.map(|quorum| quorum.to_string());
    let (network, own) = (text(policy_approvals::network(ctx)?), text(policy_approvals::own(ctx, &organisation)?));
    store::json(&PolicyApprovals { organisation, network, own })
}
