//! Certificates that their organisations no longer stand for.

use super::caller::{bad, submitter};
use super::organisations;
use super::store::{self, REVOKED, json};
use crate::chaincode::{Context, Revocation};
use crate::page::Paging;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::{Identity, Role};
use serde::{Deserialize, Serialize};

/// Most bytes of a reason.
const REASON_BYTES_MAX: usize = 512;

/// A revoked certificate, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RevocationRecord {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal.
    pub serial: String,
    /// Organisation of the issuer.
    pub organisation: String,
    /// Height of the block that revoked it.
    pub height: u64,
    /// Block time of it, microseconds since the UNIX epoch.
    pub time: u64,
    /// The admin who revoked it.
    pub by: String,
    /// Why; may be empty.
    pub reason: String,
}

/// `revocations [PAGE_JSON]`
pub(super) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let paging = Paging::of("msp revocations", args)?;
    let read = |key: &[u8], value: &[u8]| store::parse::<RevocationRecord>(key, value).map(Some);
    paging.answer(&paging.page(ctx, REVOKED, read)?)
}

/// `revoke ISSUER SERIAL [REASON]`: by an admin of the organisation that issued it.
pub(super) fn revoke(ctx: &mut Context<'_>, issuer: &[u8], serial: &[u8], reason: &[u8]) -> Result<Bytes, Rejection> {
    let issuer = std::str::from_utf8(issuer)
        .ok()
        .and_then(Hash::from_hex)
        .ok_or_else(|| bad("revoke", "ISSUER", "SHA-256 of the issuer's distinguished name, 64 hex digits"))?;
    let serial_text = std::str::from_utf8(serial).map_or_else(|_| String::new(), str::to_ascii_lowercase);
    let serial = hex::decode(&serial_text)
        .ok()
        .filter(|serial| !serial.is_empty() && serial.len() <= 64)
        .ok_or_else(|| bad("revoke", "SERIAL", "the certificate's serial number, 2 to 128 hex digits"))?;
    let reason = check_reason("revoke", reason)?;

    let organisation = issued_by(ctx, &issuer)?;
    let caller = submitter(ctx)?;
    if caller.role != Role::Admin || caller.organisation != organisation {
        return Err(Rejection::new(
            Code::NotAdmin,
            format!("{} may not revoke certificates of {organisation}", caller.id()),
        )
        .found(format!("role {} of {}", caller.role, caller.organisation))
        .wanted(format!("an admin of {organisation}, which issued it")));
    }
    revoke_certificate(ctx, caller, &organisation, (&issuer, &serial), reason)
}

/// Revokes a certificate that an authority of this organisation has issued; answers with the record, also when it was
/// revoked before.
///
/// # Errors
/// [`Code::LastOne`] for the certificate that the caller signs with: so an organisation keeps its last admin.
pub(super) fn revoke_certificate(
    ctx: &mut Context<'_>,
    caller: &Identity,
    organisation: &str,
    (issuer, serial): (&Hash, &[u8]),
    reason: &str,
) -> Result<Bytes, Rejection> {
    let revoked = Revocation { issuer: issuer.0, serial: serial.to_vec() };
    let key = [REVOKED, &revoked.issuer[..], &revoked.serial].concat();
    if let Some(known) = ctx.get(&key) {
        return Ok(known);
    }
    if revoked.issuer == caller.issuer && revoked.serial == caller.serial {
        return Err(Rejection::new(
            Code::LastOne,
            format!("{} may not revoke the certificate with which it signs", caller.id()),
        )
        .wanted(format!("another admin of {organisation}, so that at least one remains"))
        .next("register another admin, who can revoke this one: ledgerctl identity register NAME --role admin"));
    }
    let by = caller.id();
    let record = put_revocation(ctx, &revoked, &Ground { organisation, by: &by, reason })?.unwrap_or_default();
    ctx.emit("revoked", &hex::encode(&revoked.serial), record.clone());
    ctx.tell_revoked(&revoked)?;
    Ok(record)
}

/// Why a certificate is revoked.
pub(super) struct Ground<'a> {
    pub(super) organisation: &'a str,
    /// The author.
    pub(super) by: &'a str,
    pub(super) reason: &'a str,
}

/// Writes a revocation; answers with the record, or with nothing if there was one.
pub(super) fn put_revocation(
    ctx: &mut Context<'_>,
    revoked: &Revocation,
    ground: &Ground<'_>,
) -> Result<Option<Bytes>, Rejection> {
    let key = [REVOKED, &revoked.issuer[..], &revoked.serial].concat();
    if ctx.get(&key).is_some() {
        return Ok(None);
    }
    let record = json(&RevocationRecord {
        issuer: Hash(revoked.issuer),
        serial: hex::encode(&revoked.serial),
        organisation: ground.organisation.to_owned(),
        height: ctx.height(),
        time: ctx.block_time(),
        by: ground.by.to_owned(),
        reason: ground.reason.to_owned(),
    })?;
    ctx.put(&key, record.clone());
    Ok(Some(record))
}

/// A reason as it may stand on the ledger.
pub(super) fn check_reason<'a>(function: &str, reason: &'a [u8]) -> Result<&'a str, Rejection> {
    std::str::from_utf8(reason)
        .ok()
        .filter(|reason| reason.len() <= REASON_BYTES_MAX)
        .ok_or_else(|| bad(function, "REASON", "text of at most 512 bytes"))
}

/// The organisation one of whose authorities has this name.
fn issued_by(ctx: &Context<'_>, issuer: &Hash) -> Result<String, Rejection> {
    let organisations = organisations::all(ctx)?;
    for organisation in &organisations {
        for der in organisation.roots.iter().chain(&organisation.intermediates) {
            if Certificate::parse(der).is_ok_and(|ca| ca.subject_name.hash() == *issuer) {
                return Ok(organisation.name.clone());
            }
        }
    }
    let names: Vec<_> = organisations.into_iter().map(|organisation| organisation.name).collect();
    Err(Rejection::new(Code::NotFound, "no organisation has a CA with this name")
        .found(format!("issuer {issuer}"))
        .wanted(format!("SHA-256 of the distinguished name of a CA of {}", names.join(" or "))))
}
