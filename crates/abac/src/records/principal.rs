//! The caller, as the records keep it.

use super::robot::Robot;
use ledger_base::hash::Hash;
use ledger_identity::{Identity, Role};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The part of an identity that decides. Kept with a grant, so that the grant can be judged again when policies change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Principal {
    pub(crate) organisation: String,
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) attributes: BTreeMap<String, String>,
    /// SHA-256 of the issuer's name: with `serial` it names the certificate for revocation.
    pub(crate) issuer: Hash,
    /// Hexadecimal.
    pub(crate) serial: String,
    /// SHA-256 of the certificate: names the identity in caches.
    pub(crate) fingerprint: Hash,
    /// End of the certificate's validity (microseconds).
    pub(crate) not_after: u64,
}

impl Principal {
    /// The part of that identity that decides.
    pub(crate) fn of(identity: &Identity) -> Self {
        Self {
            organisation: identity.organisation.clone(),
            name: identity.name.clone(),
            role: identity.role,
            attributes: identity.attributes.clone(),
            issuer: Hash(identity.issuer),
            serial: hex::encode(&identity.serial),
            fingerprint: Hash(identity.fingerprint),
            not_after: identity.not_after,
        }
    }

    /// `Org1/Salma`.
    pub(crate) fn id(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// Is it an admin of the organisation that owns the robot?
    pub(crate) fn governs(&self, robot: &Robot) -> bool {
        self.role == Role::Admin && self.organisation == robot.organisation
    }

    /// The same certificate, as revocation would name it?
    pub(crate) fn same_certificate(&self, other: &Self) -> bool {
        self.issuer == other.issuer && self.serial == other.serial
    }
}
