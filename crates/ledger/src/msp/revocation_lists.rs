//! Revocation lists (CRLs) of authorities: those of organisations whose CA is another software.
//!
//! A list says which certificates an authority no longer stands for. It is a transaction, so what it revokes ends in one
//! block at every node. The ledger keeps the newest list of each authority. A list never takes a revocation back: a certificate
//! that was listed once stays revoked, and a list that leaves one out is refused unless that certificate has ended.
//!
//! A list that has ended says nothing about today. Its organisation decides what follows: a warning, or that its
//! people are refused until a new one comes. Its nodes are not: the network must not stop for a file that is late.

mod due;
mod follows;

pub(crate) use due::{Due, due, publishes_list};
pub use follows::LIST_AHEAD_MAX;

use super::caller::{admin, bad, object};
use super::identities::verified;
use super::revocations::{Ground, put_revocation};
use super::store::{self, LISTS, json, list_key, listed_key, stale_key};
use super::{authorities, organisations};
use crate::chaincode::{Context, Revocation};
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use follows::Kept;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger_identity::msp::{INTERMEDIATES_MAX, ROOTS_MAX};
use ledger_identity::revocation_list::{LIST_BYTES_MAX, RevocationList};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most certificates that may come along with a list, to prove that they have ended.
pub const ENDED_MAX: usize = 64;
/// Most lists that are answered with: one for each authority of each organisation.
pub(super) const LISTS_MAX: usize = organisations::ORGANISATIONS_MAX * (ROOTS_MAX + INTERMEDIATES_MAX);

/// Argument of `record_revocation_list`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordList {
    /// The list, DER in hexadecimal.
    pub list: String,
    /// Certificates that have ended, DER in hexadecimal: the list may leave them out, though the ledger does not know them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ended: Vec<String>,
}

/// The newest list of an authority, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListRecord {
    /// Organisation of the authority.
    pub organisation: String,
    /// SHA-256 of the authority's distinguished name.
    pub issuer: Hash,
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
}

/// `revocation_lists`: the newest of each authority.
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let records: Vec<ListRecord> = store::list(ctx, LISTS.as_bytes(), LISTS_MAX)?;
    let known = |list: ListRecord| {
        let stale = store::read(ctx, &stale_key(&list.organisation))?.unwrap_or_default();
        Ok(KnownList { list, stale })
    };
    json(&records.into_iter().map(known).collect::<Result<Vec<_>, Rejection>>()?)
}

/// `set_stale_lists {stale}`: an admin decides for their own organisation.
pub(super) fn set_stale(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let set: SetStale = object("set_stale_lists", argument, "{\"stale\": \"warn\" or \"refuse\"}")?;
    let caller = admin(ctx, "decide what follows a revocation list that has ended")?;
    store::write(ctx, &stale_key(&caller.organisation), &set.stale)?;
    let event = json(&set)?;
    ctx.emit("stale_lists_set", &caller.organisation, event.clone());
    Ok(event)
}

/// `record_revocation_list {list, ended?}`: by an admin of the authority's organisation.
pub(super) fn record(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"list\": DER in hexadecimal, \"ended\": [DER in hexadecimal]}";
    let RecordList { list, ended } = object("record_revocation_list", argument, wanted)?;
    let caller = admin(ctx, "record revocation lists")?;
    let organisation = organisations::find(ctx, &caller.organisation)?
        .ok_or_else(|| Rejection::new(Code::NotFound, "the network has no such organisation"))?;
    let der = decoded(&list, LIST_BYTES_MAX)?;
    if ended.len() > ENDED_MAX {
        return Err(bad("record_revocation_list", "ended", "at most 64 certificates"));
    }
    let ended = ended.iter().map(|text| decoded(text, CERTIFICATE_BYTES_MAX)).collect::<Result<Vec<_>, _>>()?;
    json(&take(ctx, &organisation, (&der, &ended), &caller.id())?)
}

/// Takes a list that an authority of this organisation has signed, if it follows the one before. The certificates in it are revoked, and the
/// rights of its holders end in this block.
pub(super) fn take(
    ctx: &mut Context<'_>,
    organisation: &FoundingOrganisation,
    (der, ended): (&[u8], &[Vec<u8>]),
    by: &str,
) -> Result<RecordedList, Rejection> {
    let list = organisation.msp()?.verify_list(der).map_err(unusable)?;
    let (issuer, fingerprint) = (Hash::of(&[&list.issuer_name]), Hash::of(&[der]));
    let key = list_key(&issuer);
    let known: Option<ListRecord> = store::read(ctx, &key)?;
    if let Some(known) = known.as_ref().filter(|known| known.fingerprint == fingerprint) {
        // An answer that was lost is asked for again.
        return Ok(RecordedList { list: known.clone(), serials: Vec::new() });
    }
    follows::check_time(&list, ctx.block_time())?;
    if let Some(known) = &known {
        let serials: Vec<String> = store::read(ctx, &listed_key(&issuer))?.unwrap_or_default();
        let ends = Ends::of(ctx, organisation, &issuer, ended)?;
        let serials = serials.into_iter().filter_map(|serial| hex::decode(serial).ok()).collect();
        let kept = Kept { this_update: known.this_update, number: known.number.clone(), serials };
        follows::check(&kept, &list, &|serial| ends.have(ctx, serial))?;
    }
    let record = ListRecord {
        organisation: organisation.name.clone(),
        issuer,
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
    store::write(ctx, &key, &record)?;
    store::write(ctx, &listed_key(&issuer), &list.serials.iter().map(hex::encode).collect::<Vec<_>>())?;
    let serials = revoke(ctx, organisation, &list, by)?;
    forget_intermediates(ctx, organisation, &list)?;
    let recorded = RecordedList { list: record, serials };
    ctx.emit("revocation_list", &recorded.list.subject, json(&recorded)?);
    Ok(recorded)
}

/// Revokes what a list names and was not revoked before; answers with those serial numbers in hexadecimal.
fn revoke(
    ctx: &mut Context<'_>,
    organisation: &FoundingOrganisation,
    list: &RevocationList,
    by: &str,
) -> Result<Vec<String>, Rejection> {
    let issuer = Hash::of(&[&list.issuer_name]);
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

/// The certificates of an authority that are known to have ended.
struct Ends {
    issuer: Hash,
    /// Serial numbers of those that came along.
    shown: BTreeSet<Vec<u8>>,
}

impl Ends {
    fn of(
        ctx: &Context<'_>,
        organisation: &FoundingOrganisation,
        issuer: &Hash,
        ended: &[Vec<u8>],
    ) -> Result<Self, Rejection> {
        let mut shown = BTreeSet::new();
        for der in ended {
            let holder = verified(ctx, &organisation.name, der)?;
            if holder.issuer != issuer.0 || holder.not_after >= ctx.block_time() {
                return Err(Rejection::new(Code::OldList, "a certificate that came along proves nothing")
                    .found(format!("the certificate of {} with serial {}", holder.id(), hex::encode(&holder.serial)))
                    .wanted("certificates of the list's issuer that have ended")
                    .next("leave it out, or take the certificate that the list no longer names"));
            }
            shown.insert(holder.serial);
        }
        Ok(Self { issuer: *issuer, shown })
    }

    /// Is it known that the certificate with this serial number has ended?
    fn have(&self, ctx: &Context<'_>, serial: &[u8]) -> bool {
        let noted = || {
            let end = ctx.get(&store::end_key(&[&self.issuer.0[..], serial].concat()))?;
            Some(u64::from_be_bytes(end[..].try_into().ok()?) < ctx.block_time())
        };
        self.shown.contains(serial) || noted().unwrap_or(false)
    }
}

fn decoded(text: &str, most: usize) -> Result<Vec<u8>, Rejection> {
    hex::decode(text).ok().filter(|der| der.len() <= most).ok_or_else(|| {
        bad("record_revocation_list", "LIST_JSON", "DER in hexadecimal")
            .found(format!("{} characters", text.len()))
            .wanted(format!("DER in hexadecimal, at most {most} bytes"))
    })
}

/// The refusal of a list that cannot be read or that nobody of the organisation has signed.
fn unusable(error: ledger_identity::IdentityError) -> Rejection {
    Rejection::from(error).prefix("the revocation list is refused: ").next(
        "fetch the list again from the CA of your organisation; ledgerctl network organisations shows its authorities",
    )
}
