//! Identities: the content of an organisation's certificate, after it was verified.
//!
//! An [`Identity`] is only made by [`crate::msp::Msps::verify`]. Its organisation is the one whose root verified
//! the certificate; the subject's claim in its `O` is never read.

mod error;

pub use error::IdentityError;
pub(crate) use error::{at_most, malformed, printable};

use crate::key::PublicKey;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Longest name of an identity or an organisation, in bytes.
pub const NAME_BYTES_MAX: usize = 128;

/// The purpose of an identity. In a certificate it is an organisational unit (OU) of the subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// A user; also everybody whose certificate names no role.
    Member,
    /// May administrate its organisation: register, revoke, set up robots.
    Admin,
    /// A node; the only role that may present itself as a server.
    Node,
    /// A robot and its bridge.
    Robot,
}

impl Role {
    /// The name, as it is written in the certificates that we issue.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Member => "member",
            Self::Admin => "admin",
            Self::Node => "node",
            Self::Robot => "robot",
        }
    }

    /// The role that an organisational unit names, in our words or Fabric's; `None` for a department.
    pub fn from_unit(unit: &str) -> Option<Self> {
        match unit {
            "member" | "client" => Some(Self::Member),
            "admin" => Some(Self::Admin),
            "node" | "peer" | "orderer" => Some(Self::Node),
            "robot" => Some(Self::Robot),
            _ => None,
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A verified identity. Two are equal only if they come from the same certificate and path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The organisation whose root verified the certificate.
    pub organisation: String,
    /// The common name of the subject; see [`check_name`].
    pub name: String,
    /// Its role.
    pub role: Role,
    /// The attributes that its organisation signed into the certificate.
    pub attributes: BTreeMap<String, String>,
    /// SHA-256 of the issuer's distinguished name, as raw DER with its SEQUENCE header.
    pub issuer: [u8; 32],
    /// The serial number as in the certificate: the content of a DER INTEGER, never negative, unique per number.
    pub serial: Vec<u8>,
    /// SHA-256 of the certificate in DER. Names the certificate, but never use it to revoke: the issuer's signature,
    /// and so the fingerprint, can be rewritten.
    pub fingerprint: [u8; 32],
    /// Verifies what this identity signs.
    pub public_key: PublicKey,
    /// Since when the certificate itself is valid, whatever its path, in microseconds since the UNIX epoch (block time).
    pub valid_from: u64,
    /// Since when certificate and path are valid, in microseconds since the UNIX epoch (block time).
    pub not_before: u64,
    /// Until when certificate and path are valid: the last valid microsecond since the UNIX epoch (block time).
    pub not_after: u64,
}

impl Identity {
    /// The name that people see: `Org1/Salma`.
    pub fn id(&self) -> String {
        [&self.organisation, "/", &self.name].concat()
    }

    /// The name of a certificate in a revocation: the issuer (32 bytes), then the serial number.
    pub fn revocation_key(&self) -> Vec<u8> {
        [self.issuer.as_slice(), &self.serial].concat()
    }

    /// Checks a cached identity against block time, in microseconds since the UNIX epoch.
    ///
    /// # Errors
    /// [`IdentityError::NotYetValid`] or [`IdentityError::Expired`]. An authority of the organisation may have been
    /// renewed since: verify the certificate again before refusing it.
    pub fn check_validity(&self, at: u64) -> Result<(), IdentityError> {
        check_validity(|| self.id(), self.not_before, self.not_after, at)
    }
}

/// Checks that a name is usable: 1 to [`NAME_BYTES_MAX`] bytes, no `/` (it separates organisation and name) and no
/// control characters.
///
/// # Errors
/// [`IdentityError::BadName`] with the reason.
pub fn check_name(name: &str) -> Result<(), IdentityError> {
    let reason = if name.is_empty() {
        "it is empty"
    } else if name.len() > NAME_BYTES_MAX {
        "it is longer than 128 bytes"
    } else if name.contains('/') {
        "it contains \"/\", which separates organisation and name"
    } else if name.chars().any(char::is_control) {
        "it contains a control character"
    } else {
        return Ok(());
    };
    Err(IdentityError::BadName { found: printable(name), reason })
}

/// Longest name that is registered, in bytes: it is also the name of a directory on its owner's machine.
pub const NEW_NAME_BYTES_MAX: usize = 64;

/// Checks a name that is to be registered. More certificates have names that [`check_name`] accepts, those of other CAs
/// among them. But an enrolled machine keeps certificate and key in a directory of this name, so every shell and file
/// system has to take it. It has 1 to [`NEW_NAME_BYTES_MAX`] bytes of letters, digits, `-`, `_` and `.`, and none of
/// `-` and `.` in front.
///
/// # Errors
/// [`Code::BadArgument`] with what is wrong.
pub fn check_new_name(name: &str) -> Result<(), Rejection> {
    let usable = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    let fits = !name.is_empty() && name.len() <= NEW_NAME_BYTES_MAX && !name.starts_with(['.', '-']);
    if fits && name.chars().all(usable) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadArgument, format!("no identity can be registered as {}", printable(name)))
        .found(match name.chars().find(|c| !usable(*c)) {
            Some(odd) => format!("{odd:?} in it"),
            None => format!("a name of {} bytes, or one that starts with \"-\" or \".\"", name.len()),
        })
        .wanted(format!(
            "1 to {NEW_NAME_BYTES_MAX} bytes of letters, digits, \"-\", \"_\" and \".\", none of \"-\" and \".\" in front"
        ))
        .next("choose another name"))
}

/// The subject is only asked for when it is refused: this runs for every transaction.
pub(crate) fn check_validity(
    subject: impl FnOnce() -> String,
    not_before: u64,
    not_after: u64,
    at: u64,
) -> Result<(), IdentityError> {
    if at < not_before {
        return Err(IdentityError::NotYetValid { subject: printable(&subject()), not_before, at });
    }
    if at > not_after {
        return Err(IdentityError::Expired { subject: printable(&subject()), not_after, at });
    }
    Ok(())
}

const _: () = assert!(NAME_BYTES_MAX == 128, "the message of check_name states the limit");
