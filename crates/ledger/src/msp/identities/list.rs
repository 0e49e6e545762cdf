//! `identities`: the registry of an organisation, for its admins.

use super::super::caller::{admin, bad, object};
use super::super::store::{self, IDENTITIES, identity_key, json};
use super::{IdentityRecord, find, is_revoked};
use crate::chaincode::Context;
use crate::page::{Page, Paging};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::NAME_BYTES_MAX;
use serde::{Deserialize, Serialize};

/// Most names that `identities` answers with as a transaction, which it was before rules 3.
const EXECUTED_MAX: usize = 200;

/// The deed, in the refusal of somebody who is no admin.
const READ: &str = "read the registered identities";

/// The argument of a query for one name.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    name: String,
}

/// The argument of a transaction.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Executed {
    /// Only this name.
    name: Option<String>,
    /// Only names behind this one.
    after: Option<String>,
}

/// The answer of a transaction.
#[derive(Serialize)]
struct Listed {
    identities: Vec<IdentityRecord>,
    /// There are more behind the last one.
    more: bool,
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
    let paging =
        Paging::of(ctx, "msp identities", args)?.ok_or_else(|| bad("identities", "PAGE_JSON", "JSON of a page"))?;
    let read = |key: &[u8], value: &[u8]| Ok(Some(shown(ctx, store::parse(key, value)?)));
    paging.answer(&paging.page(ctx, identity_key(organisation, "").as_bytes(), read)?)
}

/// `identities {name?, after?}` as a transaction.
pub(in super::super) fn executed(ctx: &Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted: Executed = object("identities", argument, "{\"name\": NAME} or {\"after\": NAME} or {}")?;
    let organisation = &admin(ctx, READ)?.organisation;
    if let Some(name) = wanted.name {
        let found = find(ctx, organisation, &name)?.map(|found| shown(ctx, found));
        return json(&Listed { identities: found.into_iter().collect(), more: false });
    }
    let prefix = identity_key(organisation, "");
    let after =
        wanted.after.filter(|after| after.len() <= NAME_BYTES_MAX).map(|name| identity_key(organisation, &name));
    let names = ctx.range_after(prefix.as_bytes(), after.as_ref().map(String::as_bytes), EXECUTED_MAX + 1);
    let listed = names.iter().take(EXECUTED_MAX);
    let identities =
        listed.map(|(key, value)| Ok(shown(ctx, store::parse(key, value)?))).collect::<Result<_, Rejection>>()?;
    json(&Listed { identities, more: names.len() > EXECUTED_MAX })
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
