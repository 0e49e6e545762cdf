//! `policies`: the policies of every organisation.

use crate::arguments::Arguments;
use crate::policy::defaults::DEFAULT_POLICY;
use crate::policy::texts::DEFAULT_ID;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyEntry;

/// `policies [PAGE_JSON]`: those of every organisation, and the built-in one.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("policies [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("policies", args)?;
    let mut page = paging.page(ctx, b"policy/", |key, value| Ok(entry(key, value)))?;
    if paging.after.is_none() {
        page.items.insert(0, built_in());
    }
    paging.answer(&page)
}

fn built_in() -> PolicyEntry {
    PolicyEntry { organisation: String::new(), id: DEFAULT_ID.to_owned(), text: DEFAULT_POLICY.to_owned() }
}

fn entry(key: &[u8], text: &[u8]) -> Option<PolicyEntry> {
    let (organisation, id) = std::str::from_utf8(key).ok()?.strip_prefix("policy/")?.split_once('/')?;
    let text = String::from_utf8_lossy(text).into_owned();
    Some(PolicyEntry { organisation: organisation.to_owned(), id: id.to_owned(), text })
}
