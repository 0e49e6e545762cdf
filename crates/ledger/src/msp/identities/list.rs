//! `identities`: the registry of an organisation, for its admins.

use super::super::caller::{admin, object};
use super::super::store::{self, IDENTITIES, identity_key, json};
use super::{IdentityRecord, find, is_revoked};
use crate::chaincode::Context;
use crate::page::{Page, Paging};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use serde::Deserialize;

/// The deed, in the refusal of somebody who is no admin.
const READ: &str = "read the registered identities";

/// The argument of a query for one name.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    name: String,
}

/// `identities [PAGE_JSON]`, `identities {name}`: of the caller's organisation.
pub(in super::super) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let organisation = &admin(ctx, READ)?.organisation;
    if let [argument] = args
        && let Ok(Named { name }) = serde_json::from_slice(argument)
    {
        let items = find(ctx, organisation, &name)?.map(|found| shown(ctx, found)).into_iter().collect();
        return json(&Page { items, next: None });
    }
    let paging = Paging::of("msp identities", args)?;
    let read = |key: &[u8], value: &[u8]| Ok(Some(shown(ctx, store::parse(key, value)?)));
    paging.answer(&paging.page(ctx, identity_key(organisation, "").as_bytes(), read)?)
}

/// `enrolled PAGE_JSON`: the names of all to whom a CA of the network has issued a certificate, for a chaincode that asks about
/// everybody. It must not tell them on: people outside of an organisation do not learn whom it registers.
pub(in super::super) fn enrolled(ctx: &Context<'_>, page: &Bytes) -> Result<Bytes, Rejection> {
    let paging: Paging = object("enrolled", page, "JSON of a page")?;
    let name = |key: &[u8], value: &[u8]| {
        let record: IdentityRecord = store::parse(key, value)?;
        Ok(if record.certificates.is_empty() { None } else { Some(record.id()) })
    };
    json(&paging.page(ctx, IDENTITIES.as_bytes(), name)?)
}

/// The record for readers: without hash and maker of the secret, and with what was revoked.
pub(super) fn shown(ctx: &Context<'_>, mut record: IdentityRecord) -> IdentityRecord {
    if let Some(secret) = &mut record.secret {
        (secret.sha256, secret.maker) = (Hash::ZERO, None);
    }
    for issued in &mut record.certificates {
        issued.revoked = is_revoked(ctx, issued);
    }
    record
}
