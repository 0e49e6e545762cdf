//! `policy_proposal`: one proposed set with its texts.

use crate::arguments::Arguments;
use crate::lifecycle::policy_proposals;
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyProposalTexts;

/// `policy_proposal ID`: one with its texts.
pub(crate) fn show(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let proposed = policy_proposals::find(ctx, Arguments::new("policy_proposal ID", args, 1, 1)?)?;
    let policies = policy_set::texts(ctx, &proposed.organisation, &proposed.policies)?;
    store::json(&PolicyProposalTexts { proposal: policy_proposals::told(ctx, &proposed)?, policies })
}
