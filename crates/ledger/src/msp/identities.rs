//! The registered identities of the organisations: who may receive a certificate, and which ones were issued.
//!
//! The registry stands on the ledger and not at a CA. So names are registered, listed and revoked through any node, and
//! every node that carries the CA's key issues by the same registry. Of a one-time secret only its hash is here.
//!
//! A registration is *open* until its secret was used, has expired or is cancelled. The first key that comes with the
//! secret takes it. A caller that comes again with the same key soon after receives the same certificate, because an answer can
//! be lost. Nobody receives one for a secret whose certificate was revoked or has signed something.

mod certificates;
mod holder;
mod imported;
mod list;
mod registrar;
mod registration;
mod revocation;

pub use certificates::{Ground, KnownIdentity, RecordCertificate, Recorded};
pub use holder::CertifiedHolder;
pub use imported::BarredName;
pub use registrar::{AFFILIATION, REGISTRARS_MAX, SetRegistrar};
pub use registration::{CancelRegistration, Register};
pub use revocation::{RevokeIdentity, RevokedIdentity};

pub(super) use certificates::{adopt, record};
pub(super) use holder::holder;
pub(crate) use imported::{check_barred, seen};
use list::shown;
pub(super) use list::{enrolled, list};
pub(super) use registrar::{registrars, set as set_registrar};
pub(super) use registration::{cancel, register};
pub(super) use revocation::revoke;

use super::store::{self, REVOKED, identity_key, issued_key, registered_key};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::{NAME_BYTES_MAX, Role};
use ledger_storage::state::StateRead;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Most certificates of one name that are kept; beyond it those that have expired are forgotten.
pub const CERTIFICATES_MAX: usize = 64;
/// Longest life of a one-time secret, in microseconds of block time: a year.
pub const REGISTRATION_LIFE_MAX: u64 = 365 * 24 * 3600 * 1_000_000;
/// For how long after its first use a secret answers the same key with the same certificate, microseconds of block
/// time.
pub const ENROLMENT_REPEAT_MAX: u64 = 15 * 60 * 1_000_000;
/// Shortest time between a name's last certificate and a renewal, microseconds of block time.
pub const RENEWAL_PAUSE: u64 = 60 * 1_000_000;

/// A registered identity, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct IdentityRecord {
    /// Its organisation.
    pub organisation: String,
    /// Its name.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// The attributes of its next certificate.
    pub attributes: BTreeMap<String, String>,
    /// Since when it is registered, block time in microseconds; 0 if it was known at a node before it came to the
    /// ledger.
    pub registered: u64,
    /// The registrar: an admin, or the node at whose machine it happened.
    pub by: String,
    /// The newest secret that an admin has made; none if it was cancelled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub secret: Option<Secret>,
    /// A secret that was made at a node's own machine and is known only there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub local: Option<LocalSecret>,
    /// Block time at which everything of this name was last revoked, or a secret at a node cancelled, microseconds; 0 = never.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub voided: u64,
    /// It cannot become free for others: some of its certificates were forgotten, so what they have signed is unknown, or a
    /// secret that lies at a node was voided.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stays: bool,
    /// Block time at which its attributes were last changed, microseconds; 0 = never.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub changed: u64,
    /// The certificates it has received, oldest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub certificates: Vec<IssuedCertificate>,
}

/// A one-time secret that an admin has made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Secret {
    /// SHA-256 of the secret's text; zero in answers.
    pub sha256: Hash,
    /// Last block time at which it can be used, microseconds.
    pub expires: u64,
    /// The key that has used it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub used: Option<Use>,
    /// The certificate by which it was made; none in answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maker: Option<Maker>,
}

/// The certificate by which a secret was made. The name of its holder is that of the registration's author.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Maker {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal.
    pub serial: String,
    /// Had it the right of a registrar, and not that of an admin?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub registrar: bool,
}

/// The state of a secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Use {
    /// SHA-256 of the public key (SPKI) that came with it.
    pub key: Hash,
    /// The certificate that it received.
    pub fingerprint: Hash,
    /// Block time, microseconds.
    pub time: u64,
}

/// A one-time secret that only a node knows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LocalSecret {
    /// The node.
    pub at: String,
    /// When it was made, by the clock of that machine, microseconds since the UNIX epoch.
    pub made: u64,
    /// Until when it can be used, by the same clock.
    pub expires: u64,
}

/// A certificate that was issued, as lists and revocations need it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct IssuedCertificate {
    /// Serial number in hexadecimal: the content of the DER INTEGER.
    pub serial: String,
    /// SHA-256 of the issuer's distinguished name, as a revocation names it.
    pub issuer: Hash,
    /// SHA-256 of the certificate.
    pub fingerprint: Hash,
    /// Start of validity, microseconds since the UNIX epoch.
    pub not_before: u64,
    /// Last valid microsecond since the UNIX epoch.
    pub not_after: u64,
    /// The node that recorded it.
    pub via: String,
    /// Block time at which it was recorded, microseconds; 0 if it was issued before it came to the ledger.
    pub recorded: u64,
    /// Was it revoked? Only answers say so; on the ledger the revocation itself stands.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub revoked: bool,
}

impl IdentityRecord {
    /// The name that people see: `Org1/Salma`.
    pub fn id(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// Until when a secret of this name can still be used, if one can at this time (microseconds).
    pub fn pending(&self, now: u64) -> Option<u64> {
        let open = self.secret.as_ref().filter(|secret| secret.used.is_none()).map(|secret| secret.expires);
        open.into_iter().chain(self.local.as_ref().map(|local| local.expires)).filter(|end| *end >= now).max()
    }

    /// Its certificate with this fingerprint.
    pub fn certificate(&self, fingerprint: &Hash) -> Option<&IssuedCertificate> {
        self.certificates.iter().find(|issued| issued.fingerprint == *fingerprint)
    }
}

/// The record of a name.
pub(super) fn find(ctx: &Context<'_>, organisation: &str, name: &str) -> Result<Option<IdentityRecord>, Rejection> {
    if organisation.len() > NAME_BYTES_MAX || name.len() > NAME_BYTES_MAX {
        return Ok(None);
    }
    store::read(ctx, &identity_key(organisation, name))
}

/// The record of a name, from a state.
///
/// # Errors
/// A fault of the store, a record that cannot be read.
pub fn identity(state: &dyn StateRead, organisation: &str, name: &str) -> Result<Option<IdentityRecord>, Rejection> {
    if organisation.len() > NAME_BYTES_MAX || name.len() > NAME_BYTES_MAX {
        return Ok(None);
    }
    store::read_state(state, &identity_key(organisation, name))
}

/// The certificate with this fingerprint, DER, if a CA has issued it and it is kept.
///
/// # Errors
/// A fault of the store.
pub fn issued(state: &dyn StateRead, fingerprint: &Hash) -> Result<Option<Bytes>, Rejection> {
    state.get(&store::full(&issued_key(fingerprint)))
}

fn write(ctx: &mut Context<'_>, record: &IdentityRecord) -> Result<(), Rejection> {
    store::write(ctx, &identity_key(&record.organisation, &record.name), record)
}

/// How many names an organisation has registered, and one more or one less.
fn count(ctx: &mut Context<'_>, organisation: &str, change: impl Fn(u64) -> u64) -> Result<u64, Rejection> {
    let key = registered_key(organisation);
    let number = change(store::read::<u64>(ctx, &key)?.unwrap_or(0));
    store::write(ctx, &key, &number)?;
    Ok(number)
}

fn is_revoked(ctx: &Context<'_>, issued: &IssuedCertificate) -> bool {
    was_revoked(ctx, &issued.issuer, &issued.serial)
}

/// Was the certificate with this serial number (hexadecimal) revoked?
fn was_revoked(ctx: &Context<'_>, issuer: &Hash, serial: &str) -> bool {
    let serial = hex::decode(serial).unwrap_or_default();
    ctx.get(&[REVOKED, &issuer.0[..], &serial].concat()).is_some()
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
fn is_zero(number: &u64) -> bool {
    *number == 0
}
