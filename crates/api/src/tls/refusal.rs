//! Why the other side of a connection is refused, and how the reason comes back out of a failed handshake.

use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{IdentityError, Role};
use rustls::{CertificateError, OtherError};
use std::error::Error as StdError;
use std::io;
use std::sync::Arc;
use thiserror::Error;

/// Why the certificate of the other side is refused. Both sides fail the handshake; this side knows why, the other
/// one receives an alert.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// The certificate does not verify.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// Somebody who is not a node presents itself as a server.
    #[error("it is no node: found the certificate of {id}, whose role is {role}, wanted the certificate of a node")]
    NotANode {
        /// The owner of the certificate.
        id: String,
        /// Its role.
        role: Role,
    },
    /// A node, but another one.
    #[error("it is another node: found {found}, wanted {wanted}")]
    OtherNode {
        /// The node that answers.
        found: String,
        /// The node that was expected.
        wanted: String,
    },
    /// No presented certificate has the pinned fingerprint.
    #[error("its CA is another one: found certificates with SHA-256 {}, wanted one with {wanted}", .found.join(", "))]
    Fingerprint {
        /// The fingerprints of what the server presents, in hexadecimal.
        found: Vec<String>,
        /// The pinned fingerprint, in hexadecimal.
        wanted: String,
    },
    /// The certificate was revoked.
    #[error("its certificate was revoked: found the certificate of {id}, wanted one that was not revoked")]
    Revoked {
        /// The owner of the certificate.
        id: String,
    },
    /// The server presents no certificate.
    #[error("it shows no certificate: found a server without one, wanted the certificate of a node")]
    NoCertificate,
}

impl Refusal {
    /// Advice for the next step, in one line.
    pub fn remedy(&self) -> String {
        match self {
            Self::Identity(error) => error.remedy(),
            Self::NotANode { .. } => "use a server with a certificate of role node, or check the address".into(),
            Self::OtherNode { .. } => "check the address, or the node that the context names".into(),
            Self::Fingerprint { .. } => "ask the operator of the node for the fingerprint of its CA".into(),
            Self::Revoked { .. } => "an admin of the organisation can enrol it again".into(),
            Self::NoCertificate => "check that the address is that of a node".into(),
        }
    }

    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Identity(error) => error.code(),
            Self::NotANode { .. } => Code::WrongRole,
            Self::Revoked { .. } => Code::Revoked,
            Self::OtherNode { .. } | Self::Fingerprint { .. } | Self::NoCertificate => Code::Untrusted,
        }
    }
}

impl From<Refusal> for Rejection {
    fn from(refusal: Refusal) -> Self {
        Self::told(refusal.code(), &refusal.to_string()).next(refusal.remedy())
    }
}

impl From<Refusal> for rustls::Error {
    fn from(refusal: Refusal) -> Self {
        Self::InvalidCertificate(CertificateError::Other(OtherError(Arc::new(refusal))))
    }
}

/// The reason inside the error of a failed handshake, if this side refused the other. `None` if it failed for
/// another reason, among them that the other side refused us: then only an alert arrived.
pub fn refusal<'a>(error: &'a (dyn StdError + 'static)) -> Option<&'a Refusal> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(found) = error.downcast_ref::<Refusal>() {
            return Some(found);
        }
        if let Some(rustls::Error::InvalidCertificate(CertificateError::Other(other))) = error.downcast_ref() {
            return other.0.downcast_ref();
        }
        // An io::Error is not the source of what it wraps: it is that error under another name.
        next = match error.downcast_ref::<io::Error>().and_then(io::Error::get_ref) {
            Some(inner) => Some(inner),
            None => error.source(),
        };
    }
    None
}
