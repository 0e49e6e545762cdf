//! Everything of a name is revoked in one step: its certificates, and secrets that were not used yet.

use super::super::caller::{admin, object};
use super::super::organisations;
use super::super::revocations::{check_reason, revoke_certificate};
use super::super::store::json;
use super::registration::{unknown, void};
use super::{IssuedCertificate, find, imported, is_revoked};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Argument of `revoke_identity`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RevokeIdentity {
    /// The name.
    pub name: String,
    /// Why; stays on the ledger.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// Answer of `revoke_identity`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RevokedIdentity {
    /// The certificates that were revoked now.
    pub certificates: Vec<IssuedCertificate>,
    /// A secret that could still be used is void.
    pub cancelled: bool,
    /// Only of a CA that is not ours. Certificates of the name that begin at this block time or before are refused, also unknown
    /// ones. Microseconds since the UNIX epoch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub barred: Option<u64>,
}

/// `revoke_identity {name, reason?}`: by an admin of the organisation, through any node; no CA is needed.
pub(in super::super) fn revoke(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let RevokeIdentity { name, reason } = object("revoke_identity", argument, "{\"name\": NAME, \"reason\": TEXT}")?;
    let reason = check_reason("revoke_identity", reason.as_bytes())?;
    let caller = admin(ctx, "revoke identities")?;
    let Some(record) = find(ctx, &caller.organisation, &name)? else {
        if organisations::find(ctx, &caller.organisation)?.is_some_and(|organisation| organisation.units.is_some()) {
            let (certificates, barred) = imported::revoke(ctx, caller, &name, reason)?;
            return json(&RevokedIdentity { certificates, cancelled: false, barred: Some(barred) });
        }
        return Err(unknown(&caller.organisation, &name));
    };
    let live: Vec<_> = record.certificates.iter().filter(|issued| !is_revoked(ctx, issued)).cloned().collect();
    let cancelled = record.pending(ctx.block_time()).is_some();
    if live.is_empty() && !cancelled {
        return Err(Rejection::new(Code::NotFound, format!("{} has nothing to revoke", record.id()))
            .found("no valid certificate, and no open registration")
            .next(format!("ledgerctl identity show {name}")));
    }
    for issued in &live {
        let serial = hex::decode(&issued.serial).unwrap_or_default();
        revoke_certificate(ctx, caller, &record.organisation, (&issued.issuer, &serial), reason)?;
    }
    void(ctx, record, true)?;
    json(&RevokedIdentity { certificates: live, cancelled, barred: None })
}
