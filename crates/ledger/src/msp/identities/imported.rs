//! People of an organisation whose CA is another software: no registry knows them, and an admin revokes them by name all the same.
//!
//! The ledger notes each of their certificates when it first signs something. Those are revoked one by one, so that everything that
//! follows a revocation happens. The name is barred as well: certificates of it that begin before that moment are refused,
//! also those that the ledger has never seen. Later certificates of the CA count.

use super::super::revocations::revoke_certificate;
use super::super::store::{self, barred_key, json, seen_of};
use super::{IssuedCertificate, is_revoked};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, check_name};
use ledger_storage::state::Overlay;
use serde::{Deserialize, Serialize};

/// Most certificates of one name that are revoked in one call. The bar holds for more.
const SEEN_MAX: usize = 500;

/// A name whose certificates were revoked, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BarredName {
    /// Its organisation.
    pub organisation: String,
    /// The name.
    pub name: String,
    /// Certificates that begin at this block time or before are refused, microseconds since the UNIX epoch.
    pub time: u64,
    /// Height of the block that revoked them.
    pub height: u64,
    /// The admin.
    pub by: String,
    /// Why; may be empty.
    pub reason: String,
}

/// The records of a certificate of such an organisation when it first signs something, by full keys.
pub(crate) fn seen(identity: &Identity, time: u64) -> Result<[(Bytes, Bytes); 2], Rejection> {
    let issued = IssuedCertificate {
        serial: hex::encode(&identity.serial),
        issuer: Hash(identity.issuer),
        fingerprint: Hash(identity.fingerprint),
        not_before: identity.valid_from,
        not_after: identity.not_after,
        via: String::new(),
        recorded: time,
        revoked: false,
    };
    let prefix = seen_of(&identity.organisation, &identity.name);
    let key = format!("{prefix}{}/{}", issued.issuer, issued.serial);
    Ok([store::end_of(identity), (store::full(key.as_bytes()), json(&issued)?)])
}

/// Revokes every certificate of a name, and bars the name until the CA issues another one. Answers with the revoked ones that the
/// ledger has seen, and the block time up to which certificates begin that are refused.
pub(super) fn revoke(
    ctx: &mut Context<'_>,
    caller: &Identity,
    name: &str,
    reason: &str,
) -> Result<(Vec<IssuedCertificate>, u64), Rejection> {
    check_name(name).map_err(|error| Rejection::from(error).code(Code::BadArgument))?;
    if name == caller.name {
        return Err(Rejection::new(Code::LastOne, format!("{} may not revoke itself", caller.id()))
            .wanted(format!("another admin of {}, so that at least one remains", caller.organisation)));
    }
    let organisation = &caller.organisation;
    let seen = ctx.range(seen_of(organisation, name).as_bytes(), SEEN_MAX);
    let mut certificates = Vec::new();
    for (key, value) in seen {
        let issued: IssuedCertificate = store::parse(&key, &value)?;
        ctx.delete(&key);
        if issued.not_after < ctx.block_time() || is_revoked(ctx, &issued) {
            continue;
        }
        let serial = hex::decode(&issued.serial).unwrap_or_default();
        revoke_certificate(ctx, caller, organisation, (&issued.issuer, &serial), reason)?;
        certificates.push(issued);
    }
    let barred = BarredName {
        organisation: organisation.clone(),
        name: name.to_owned(),
        time: ctx.block_time(),
        height: ctx.height(),
        by: caller.id(),
        reason: reason.to_owned(),
    };
    store::write(ctx, &barred_key(organisation, name), &barred)?;
    let event = json(&barred)?;
    ctx.emit("name_barred", &format!("{organisation}/{name}"), event);
    Ok((certificates, barred.time))
}

/// Refuses a certificate of a name that was barred since.
pub(crate) fn check_barred(identity: &Identity, overlay: &Overlay) -> Result<(), Rejection> {
    let key = barred_key(&identity.organisation, &identity.name);
    let Some(value) = overlay.get(&store::full(key.as_bytes())) else { return Ok(()) };
    let barred: BarredName = store::parse(key.as_bytes(), &value)?;
    if identity.valid_from > barred.time {
        return Ok(());
    }
    Err(Rejection::new(Code::Revoked, format!("the certificates of {} were revoked", identity.id()))
        .found(format!(
            "a certificate valid from {}; {} revoked the name at {}",
            rfc3339(identity.valid_from),
            barred.by,
            rfc3339(barred.time)
        ))
        .wanted("a certificate whose validity begins later")
        .next(format!("have the CA of {} issue a new one with a new key", identity.organisation)))
}
