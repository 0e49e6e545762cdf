//! The policies on the ledger: every organisation keeps its own, and they decide about its robots only.

use super::Texts;
use super::defaults::Defaults;
use crate::records::store;
use ledger::Context;
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};

/// Most policies of one organisation.
pub(crate) const POLICIES_MAX: usize = 64;
/// The id under which the built-in policy is listed.
pub(crate) const DEFAULT_ID: &str = "default";

/// The policies that decide about the robots of an organisation.
pub(crate) fn in_force(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
    let own = own(ctx, organisation)?;
    let default = || (DEFAULT_ID.to_owned(), Defaults::of(ctx.rules()).policy.to_owned());
    Ok(if own.is_empty() { vec![default()] } else { own })
}

/// The hash that names them.
pub(crate) fn version(ctx: &Context<'_>, organisation: &str) -> Result<Hash, Rejection> {
    match ctx.get(&store::version_key(organisation)) {
        None => Ok(Defaults::of(ctx.rules()).version),
        Some(value) => Hash::from_slice(&value).ok_or_else(|| {
            Rejection::new(Code::Corrupt, format!("policy version of {organisation} is not readable"))
                .found(format!("{} bytes", value.len()))
                .wanted("32 bytes")
        }),
    }
}

/// The policies that an organisation has put itself.
pub(crate) fn own(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
    let prefix = store::policies_prefix(organisation);
    ctx.range(&prefix, POLICIES_MAX)
        .into_iter()
        .map(|(key, value)| {
            let id = key.strip_prefix(prefix.as_slice()).unwrap_or_default().to_vec();
            match (String::from_utf8(id), String::from_utf8(value.to_vec())) {
                (Ok(id), Ok(text)) => Ok((id, text)),
                _ => Err(Rejection::new(Code::Corrupt, format!("a policy of {organisation} is not text"))),
            }
        })
        .collect()
}

/// Every part is preceded by its length, so that no two sets have the same bytes.
pub(crate) fn hash(texts: &Texts) -> Hash {
    let mut parts: Vec<Vec<u8>> = Vec::with_capacity(texts.len() * 4);
    for part in texts.iter().flat_map(|(id, text)| [id, text]) {
        parts.push((part.len() as u64).to_be_bytes().to_vec());
        parts.push(part.as_bytes().to_vec());
    }
    Hash::of(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
}
