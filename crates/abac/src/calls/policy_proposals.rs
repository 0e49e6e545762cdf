//! `policy_proposals`: the proposed sets.

use crate::arguments::Arguments;
use crate::lifecycle::policy_proposals;
use crate::records::proposed::Proposed;
use crate::records::store;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyProposal;

/// `policy_proposals [PAGE_JSON]`
pub(crate) fn list(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("policy_proposals [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("policy_proposals", args)?;
    let page = paging.page(ctx, store::PROPOSED, |key, value| store::parse::<Proposed>(key, value).map(Some))?;
    let items: Vec<PolicyProposal> =
        page.items.iter().map(|proposed| policy_proposals::told(ctx, proposed)).collect::<Result<_, _>>()?;
    paging.answer(&ledger::Page { items, next: page.next })
}
