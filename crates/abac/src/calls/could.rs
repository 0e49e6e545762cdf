//! `could`: who of an organisation may do something?

use crate::arguments::{Arguments, shown};
use crate::calls::question;
use crate::calls::question::{ASK_BYTES_MAX, Case};
use crate::lifecycle::people;
use crate::policy::decider::Decider;
use crate::records::store;
use bytes::Bytes;
use ledger::{Context, Page};
use ledger_base::rejection::Rejection;
use ledger_contract::{Can, Could};
use serde::Deserialize;

/// `could ASK_JSON PAGE_JSON`: who of the caller's organisation may do that? For its admins.
pub(crate) fn could(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    /// The part of a registration that is of use here.
    #[derive(Deserialize)]
    struct Registered {
        organisation: String,
        name: String,
    }
    let args = Arguments::new("could ASK_JSON PAGE_JSON", args, 2, 2)?;
    let ask = question::read(args)?;
    let page = args.document(1, "PAGE_JSON", ASK_BYTES_MAX)?;
    if !page.starts_with('{') {
        return Err(args.bad(1, "PAGE_JSON", shown(page), "JSON of a page; {} is the first one"));
    }
    let case = Case::of(ctx, decider, &ask)?;
    let page = ctx.call("msp", "identities", &[Bytes::copy_from_slice(page.as_bytes())])?;
    let page: Page<Registered> = store::parse(b"msp identities", &page)?;
    let mut items = Vec::new();
    for Registered { organisation, name } in page.items {
        // Some have not enrolled yet, or no longer count.
        let Ok(principal) = people::certified(ctx, &format!("{organisation}/{name}")) else { continue };
        let Can { who, allowed, policies, .. } = case.judge(ctx, decider, &principal)?;
        items.push(Could { who, allowed, policies });
    }
    store::json(&Page { items, next: page.next })
}
