//! `policy_set`: one set with its texts.

use crate::arguments::Arguments;
use crate::lifecycle::policy_sets;
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::PolicySetTexts;

/// `policy_set ORGANISATION VERSION`: one of them with its texts.
pub(crate) fn show(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy_set ORGANISATION VERSION", args, 2, 2)?;
    let organisation = args.text(0, "ORGANISATION")?;
    let set = policy_sets::find(ctx, organisation, args.number(1, "VERSION")?)?;
    let policies = policy_set::texts(ctx, organisation, &set.policies)?;
    store::json(&PolicySetTexts { set, policies })
}
