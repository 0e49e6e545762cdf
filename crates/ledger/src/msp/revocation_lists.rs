//! Revocation lists (CRLs) of authorities: those of organisations whose CA is another software.
//!
//! A list says which certificates an authority no longer stands for. It is a transaction, so what it revokes ends in one
//! block at every node. A list never takes a revocation back: a certificate that was listed once stays revoked, and the answer
//! names those that a newer list leaves out. The ledger keeps the newest list of each key of an authority and each scope.
//!
//! A list that has ended says nothing about today. Its organisation decides what follows: a warning, or that its
//! people are refused until a new one comes. Its nodes are not: the network must not stop for a file that is late.

mod current;
mod due;
mod follows;

pub(super) use current::current;
pub(crate) use due::{Due, due, publishes_list};
pub use follows::LIST_AHEAD_MAX;
pub(super) use follows::check_time;

use super::caller::{admin, bad, object};
use super::revocations::{Ground, put_revocation};
use super::store::{self, LISTS, json, list_key, listed_key, lists_of, stale_key};
use super::{authorities, organisations};
use crate::chaincode::{Context, Revocation};
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use current::{LISTS_OF_AUTHORITY_MAX, superfluous};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{INTERMEDIATES_MAX, ListIssuer, ROOTS_MAX};
use ledger_identity::revocation_list::{LIST_BYTES_MAX, RevocationList};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most lists that are kept.
pub(super) const LISTS_MAX: usize =
    organisations::ORGANISATIONS_MAX * (ROOTS_MAX + INTERMEDIATES_MAX) * LISTS_OF_AUTHORITY_MAX;

/// Argument of `record_revocation_list`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordList {
    /// The list, DER in hexadecimal.
    pub list: String,
}

/// The newest list of a key of an authority and a scope, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListRecord {
    /// Organisation of the authority.
    pub organisation: String,
    /// SHA-256 of the authority's distinguished name.
    pub issuer: Hash,
    /// SHA-256 of the public key that has signed the list. A CA that is founded again has another one, and counts from one again.
    pub key_fingerprint: Hash,
    /// SHA-256 of the issuing distribution point; none: the list is about all certificates of the authority.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scope: Option<Hash>,
    /// It leaves out people, or some reasons to revoke them: its age says nothing about theirs.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub partial: bool,
    /// The authority's name, for people.
    pub subject: String,
    /// When the list was made, microseconds since the UNIX epoch.
    pub this_update: u64,
    /// Until when the next one should have come, microseconds since the UNIX epoch; none: it never becomes stale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_update: Option<u64>,
    /// Its number in hexadecimal; none if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<String>,
    /// How many certificates it names.
    pub listed: u64,
    /// SHA-256 of the list.
    pub fingerprint: Hash,
    /// Height of the block that recorded it.
    pub height: u64,
    /// Block time of it, microseconds since the UNIX epoch.
    pub time: u64,
    /// The admin who brought it.
    pub by: String,
}

/// The consequence when a list has ended and no new one has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stale {
    /// Nodes and `ledgerctl` warn.
    #[default]
    Warn,
    /// The people of that authority are refused until a new one is recorded.
    Refuse,
}

/// Argument of `set_stale_lists`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetStale {
    /// The consequence.
    pub stale: Stale,
}

/// Answer of `revocation_lists`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KnownList {
    /// The list.
    #[serde(flatten)]
    pub list: ListRecord,
    /// The consequence when it has ended.
    pub stale: Stale,
}

/// Event of a recorded list, and answer of `record_revocation_list`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedList {
    /// The list.
    #[serde(flatten)]
    pub list: ListRecord,
    /// The serial numbers, in hexadecimal, that were not revoked before.
    pub serials: Vec<String>,
    /// The serial numbers, in hexadecimal, that the list before named and this one does not, though the certificates have not
    /// ended as far as the ledger knows. They stay revoked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
    /// Its number is not above that of the list before, though it was made later.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub restarted: bool,
}

/// `revocation_lists`: those that say something about today.
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let records: Vec<ListRecord> = current(store::list(ctx, LISTS.as_bytes(), LISTS_MAX)?);
    let known = |list: ListRecord| {
        let stale = store::read(ctx, &stale_key(&list.organisation))?.unwrap_or_default();
        Ok(KnownList { list, stale })
    };
    json(&records.into_iter().map(known).collect::<Result<Vec<_>, Rejection>>()?)
}

/// `set_stale_lists {stale}`: an admin decides for their own organisation.
pub(super) fn set_stale(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let set: SetStale = object("set_stale_lists", argument, "{\"stale\": \"warn\" or \"refuse\"}")?;
    let caller = admin(ctx, "set the consequence of an expired revocation list")?;
    store::write(ctx, &stale_key(&caller.organisation), &set.stale)?;
    let event = json(&set)?;
    ctx.emit("stale_lists_set", &caller.organisation, event.clone());
    Ok(event)
}

/// `record_revocation_list {list}`: by an admin of the authority's organisation.
pub(super) fn record(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let RecordList { list } = object("record_revocation_list", argument, "{\"list\": DER in hexadecimal}")?;
    let caller = admin(ctx, "record revocation lists")?;
    let organisation = organisations::find(ctx, &caller.organisation)?
        .ok_or_else(|| Rejection::new(Code::NotFound, "the network has no such organisation"))?;
    let der = hex::decode(&list).ok().filter(|der| der.len() <= LIST_BYTES_MAX).ok_or_else(|| {
        bad("record_revocation_list", "LIST_JSON", "DER in hexadecimal")
            .found(format!("{} characters", list.len()))
            .wanted(format!("DER in hexadecimal, at most {LIST_BYTES_MAX} bytes"))
    })?;
    json(&take(ctx, &organisation, &der, &caller.id(), Age::Current)?)
}

/// How old a list may be.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Age {
    /// Good now, and newer than the one before.
    Current,
    /// Any: it was good when its organisation was proposed. It revokes, and once it has ended it counts as ended.
    Any,
}

/// Takes a list that an authority of this organisation has signed. The certificates in it are revoked, and the rights of its
/// holders end in this block.
pub(super) fn take(
    ctx: &mut Context<'_>,
    organisation: &FoundingOrganisation,
    der: &[u8],
    by: &str,
    age: Age,
) -> Result<RecordedList, Rejection> {
    let (list, issuer) = organisation.msp()?.verify_list(der).map_err(unusable)?;
    let (key, listed) = (list_key(&issuer, list.scope.point), listed_key(&issuer, list.scope.point));
    let fingerprint = Hash::of(&[der]);
    let before: Option<ListRecord> = store::read(ctx, &key)?;
    if let Some(known) = before.as_ref().filter(|known| known.fingerprint == fingerprint) {
        // An answer that was lost is asked for again.
        return Ok(RecordedList { list: known.clone(), serials: Vec::new(), left_out: Vec::new(), restarted: false });
    }
    if age == Age::Current {
        check_time(&list, ctx.block_time())?;
    }
    let follows = before.as_ref().map_or(Ok(()), |before| follows::check(before, &list));
    let is_newest = match (follows, age) {
        (Err(older), Age::Current) => return Err(older),
        (follows, _) => follows.is_ok(),
    };
    let mut record = ListRecord {
        organisation: organisation.name.clone(),
        issuer: issuer.name,
        key_fingerprint: issuer.key,
        scope: list.scope.point,
        partial: list.scope.leaves_out_people,
        subject: list.issuer.clone(),
        this_update: list.this_update,
        next_update: list.next_update,
        number: list.number.as_ref().map(hex::encode),
        listed: list.serials.len() as u64,
        fingerprint,
        height: ctx.height(),
        time: ctx.block_time(),
        by: by.to_owned(),
    };
    let restarted = before.as_ref().is_some_and(|before| !follows::grows(before, &list));
    let mut left_out = Vec::new();
    match before {
        Some(newer) if !is_newest => record = newer,
        _ => {
            left_out = names_no_longer(ctx, &issuer.name, &listed, &list)?;
            store::write(ctx, &key, &record)?;
            store::write(ctx, &listed, &list.serials.iter().map(hex::encode).collect::<Vec<_>>())?;
            forget_oldest(ctx, &issuer.name)?;
        }
    }
    let serials = revoke(ctx, organisation, (&issuer.name, &list), by)?;
    forget_intermediates(ctx, organisation, &list)?;
    let recorded = RecordedList { list: record, serials, left_out, restarted: restarted && is_newest };
    ctx.emit("revocation_list", &recorded.list.subject, json(&recorded)?);
    Ok(recorded)
}

/// The serial numbers in hexadecimal that the list before names and this one does not, without those whose certificates are
/// known to have ended.
fn names_no_longer(
    ctx: &Context<'_>,
    issuer: &Hash,
    listed: &str,
    list: &RevocationList,
) -> Result<Vec<String>, Rejection> {
    let before: BTreeSet<String> = store::read(ctx, listed)?.unwrap_or_default();
    let names = |serial: &String| hex::decode(serial).is_ok_and(|serial| list.serials.contains(&serial));
    let has_ended = |serial: &String| {
        let serial = hex::decode(serial).ok()?;
        let end = ctx.get(&store::end_key(&[&issuer.0[..], &serial].concat()))?;
        Some(u64::from_be_bytes(end[..].try_into().ok()?) < ctx.block_time())
    };
    Ok(before.into_iter().filter(|serial| !names(serial) && !has_ended(serial).unwrap_or(false)).collect())
}

/// Keeps the lists of an authority few, however often its CA changes key or scope.
fn forget_oldest(ctx: &mut Context<'_>, issuer: &Hash) -> Result<(), Rejection> {
    let known: Vec<ListRecord> = store::list(ctx, lists_of(issuer).as_bytes(), LISTS_OF_AUTHORITY_MAX + 1)?;
    if let Some(oldest) = superfluous(known) {
        let issuer = ListIssuer { name: oldest.issuer, key: oldest.key_fingerprint };
        ctx.delete(list_key(&issuer, oldest.scope).as_bytes());
        ctx.delete(listed_key(&issuer, oldest.scope).as_bytes());
    }
    Ok(())
}

/// Revokes what a list names and was not revoked before; answers with those serial numbers in hexadecimal.
fn revoke(
    ctx: &mut Context<'_>,
    organisation: &FoundingOrganisation,
    (issuer, list): (&Hash, &RevocationList),
    by: &str,
) -> Result<Vec<String>, Rejection> {
    let mut new = Vec::new();
    for serial in &list.serials {
        let revoked = Revocation { issuer: issuer.0, serial: serial.clone() };
        let ground = Ground { organisation: &organisation.name, by, reason: "in a revocation list of its CA" };
        if put_revocation(ctx, &revoked, &ground)?.is_some() {
            ctx.tell_revoked(&revoked)?;
            new.push(hex::encode(serial));
        }
    }
    Ok(new)
}

/// An authority that its own issuer has revoked vouches for nobody: the organisation loses it.
fn forget_intermediates(
    ctx: &mut Context<'_>,
    organisation: &FoundingOrganisation,
    list: &RevocationList,
) -> Result<(), Rejection> {
    let stays = |der: &Bytes| {
        Certificate::parse(der)
            .map_or(true, |found| found.issuer_name != list.issuer_name || !list.serials.contains(&found.serial))
    };
    let mut changed = organisation.clone();
    changed.intermediates.retain(stays);
    if changed == *organisation {
        return Ok(());
    }
    authorities::replace(ctx, &changed).map(drop)
}

/// The refusal of a list that cannot be read or that nobody of the organisation has signed.
fn unusable(error: ledger_identity::IdentityError) -> Rejection {
    Rejection::from(error)
        .prefix("the revocation list is rejected: ")
        .next("fetch the list again from the CA of your organisation; ledgerctl network organisations shows its CAs")
}
