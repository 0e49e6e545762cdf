//! The person behind a name: what its certificate says, for chaincode that gives somebody a right who does not ask itself.

use super::certificates::verified;
use super::{find, is_revoked, issued_key};
use crate::chaincode::Context;
use crate::msp::store::{json, known_certificate_key};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Answer of `holder`: the owner of a certificate that counts now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CertifiedHolder {
    /// Its organisation.
    pub organisation: String,
    /// Its name.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// The attributes of its certificate.
    pub attributes: BTreeMap<String, String>,
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal: the content of the DER INTEGER.
    pub serial: String,
    /// SHA-256 of the certificate.
    pub fingerprint: Hash,
    /// Last valid microsecond since the UNIX epoch.
    pub not_after: u64,
}

/// `holder ORGANISATION/NAME`: the newest certificate of a name that is valid at block time and was not revoked.
pub(in super::super) fn holder(ctx: &Context<'_>, id: &Bytes) -> Result<Bytes, Rejection> {
    let unknown = |found: String| {
        Rejection::new(Code::NotFound, "no identity with a valid certificate has this name")
            .found(found)
            .wanted("ORGANISATION/NAME of an enrolled identity, such as Org1/Farhad")
            .next("check the name; an admin of that organisation lists names and certificates: ledgerctl identity list")
    };
    let id = std::str::from_utf8(id).map_err(|_| unknown("bytes that are not UTF-8".to_owned()))?;
    let shown: String = id.chars().take(80).collect();
    let record = match id.split_once('/') {
        Some((organisation, name)) => find(ctx, organisation, name)?,
        None => None,
    };
    let record = record.ok_or_else(|| unknown(format!("{shown:?}")))?;
    let now = ctx.block_time();
    for issued in record.certificates.iter().rev().filter(|issued| issued.not_before <= now && now <= issued.not_after)
    {
        // One that a CA issued before there was a ledger is here since its holder's first call.
        let der = ctx.get(&issued_key(&issued.fingerprint));
        let der = der.or_else(|| ctx.get(&known_certificate_key(&issued.fingerprint)));
        let Some(der) = der.filter(|_| !is_revoked(ctx, issued)) else {
            continue;
        };
        // An authority that left takes its certificates along.
        if let Ok(holder) = verified(ctx, &record.organisation, &der) {
            return json(&CertifiedHolder::of(holder));
        }
    }
    Err(unknown(format!("{} certificates of {shown}, none of them valid", record.certificates.len())))
}

impl CertifiedHolder {
    fn of(identity: Identity) -> Self {
        let Identity { organisation, name, role, attributes, issuer, serial, fingerprint, not_after, .. } = identity;
        let (issuer, fingerprint) = (Hash(issuer), Hash(fingerprint));
        Self { organisation, name, role, attributes, issuer, serial: hex::encode(&serial), fingerprint, not_after }
    }
}
