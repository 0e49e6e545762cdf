//! Why a certificate, or an authority, is refused.

use crate::key::KeyError;
use ledger_base::rejection::{Code, Rejection};
use thiserror::Error;
use x509_parser::time::ASN1Time;

/// Characters of a name from a certificate that a message repeats.
const PRINTABLE_CHARS_MAX: usize = 160;

/// Why a certificate is refused. The text of each says what was found and what was wanted; [`IdentityError::remedy`]
/// says what to do. Names that came from outside are escaped and cut, so that they cannot forge log lines.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum IdentityError {
    /// The bytes are not a usable X.509 version 3 certificate.
    #[error("the certificate is malformed: found {found}, wanted {wanted}")]
    Malformed {
        /// The value that was found.
        found: String,
        /// The value that was wanted.
        wanted: &'static str,
    },
    /// More than is ever read.
    #[error("the certificate is too large: found {found} {unit}, wanted at most {max} {unit}")]
    TooLarge {
        /// The counted things.
        unit: &'static str,
        /// How many there are.
        found: usize,
        /// How many are accepted.
        max: usize,
    },
    /// No organisation of the network has the issuer as one of its authorities.
    #[error("the certificate is not trusted: found issuer {issuer}, wanted a CA of {}", list(.wanted))]
    Untrusted {
        /// The issuer's distinguished name.
        issuer: String,
        /// The organisations that are known.
        wanted: Vec<String>,
    },
    /// The issuer's name is an authority's, the signature is not: a forgery, or a CA that was made anew.
    #[error(
        "the certificate of {subject} is not signed by the key it names: found issuer {issuer}, wanted a signature by \
         the CA of {organisation} with this name"
    )]
    BadSignature {
        /// The subject's distinguished name.
        subject: String,
        /// The issuer's distinguished name.
        issuer: String,
        /// The organisation whose authority has this name.
        organisation: String,
    },
    /// Too early.
    #[error("the certificate of {subject} is not valid yet: found time {}, wanted {} or later", time(*.at), time(*.not_before))]
    NotYetValid {
        /// The owner of the certificate: the holder or an authority.
        subject: String,
        /// Start of validity, in microseconds since the UNIX epoch.
        not_before: u64,
        /// The time of the check, in microseconds since the UNIX epoch.
        at: u64,
    },
    /// Too late.
    #[error("the certificate of {subject} has expired: found time {}, wanted {} or earlier", time(*.at), time(*.not_after))]
    Expired {
        /// The owner of the certificate: the holder or an authority.
        subject: String,
        /// Last valid microsecond since the UNIX epoch.
        not_after: u64,
        /// The time of the check, in microseconds since the UNIX epoch.
        at: u64,
    },
    /// A certificate that should be an authority's is not one.
    #[error("the certificate of {subject} is not that of a CA: found {found}, wanted {wanted}")]
    NotAnAuthority {
        /// The subject's distinguished name.
        subject: String,
        /// The value that was found.
        found: &'static str,
        /// The value that was wanted.
        wanted: &'static str,
    },
    /// An authority's certificate was presented as somebody's identity.
    #[error("the certificate of {subject} is that of a CA: found CA:TRUE, wanted the certificate of an identity")]
    Authority {
        /// The subject's distinguished name.
        subject: String,
    },
    /// The certificate was issued for something else.
    #[error("the certificate of {subject} was issued for another purpose: found {found}, wanted {wanted}")]
    WrongUsage {
        /// The subject's distinguished name.
        subject: String,
        /// The uses that the certificate allows.
        found: String,
        /// The use that it should allow.
        wanted: &'static str,
    },
    /// The public key is of a kind that nobody here verifies.
    #[error("the certificate of {subject} has an unusable key: {reason}")]
    UnsupportedKey {
        /// The subject's distinguished name.
        subject: String,
        /// Found and wanted.
        reason: KeyError,
    },
    /// A name that cannot be used.
    #[error(
        "a name in the certificate is not usable, {reason}: found {found}, wanted 1 to 128 bytes without \"/\" or control characters"
    )]
    BadName {
        /// The name, escaped.
        found: String,
        /// Its fault.
        reason: &'static str,
    },
    /// Every signature holds, but a rule of the path does not.
    #[error("the path of {subject} to {organisation} is rejected: found {found}, wanted a path that RFC 5280 accepts")]
    BadPath {
        /// The subject's distinguished name.
        subject: String,
        /// The organisation whose root ends the path.
        organisation: String,
        /// The rule that is broken.
        found: String,
    },
    /// A signature that nobody here verifies.
    #[error("the signature of {what} cannot be verified: found {found}, wanted {wanted}")]
    UnsupportedSignature {
        /// A certificate or a list, and whose.
        what: String,
        /// Its algorithm, and the key that made it.
        found: String,
        /// The algorithms that are verified.
        wanted: &'static str,
    },
    /// An authority that nobody could sign in by.
    #[error("the CA {subject} cannot be used here: found {found}, wanted {wanted}")]
    UnusableAuthority {
        /// The authority's distinguished name.
        subject: String,
        /// Its fault.
        found: String,
        /// The properties that are wanted instead.
        wanted: &'static str,
    },
    /// Two organisations claim the same authority, so it could not be told whose identities it issues.
    #[error(
        "the CA {subject} is shared: found it in {first} and {second}, wanted each name and key in one organisation"
    )]
    SharedAuthority {
        /// The authority's distinguished name.
        subject: String,
        /// The organisation that has it.
        first: String,
        /// The organisation that wants it too.
        second: String,
    },
}

impl IdentityError {
    /// Advice for the next step, in one line.
    pub fn remedy(&self) -> String {
        match self {
            Self::Malformed { .. } | Self::TooLarge { .. } | Self::BadName { .. } => {
                "have the certificate issued again by its organisation".into()
            }
            Self::Untrusted { .. } => {
                "enrol at one of these organisations, or add the organisation's root certificate to the network".into()
            }
            Self::BadSignature { organisation, .. } => {
                format!("enrol again at {organisation}, whose CA may have been replaced")
            }
            // Nearly always one of the two clocks is wrong, and then a new certificate does not help.
            Self::NotYetValid { .. } => {
                "compare the time found with a trusted clock, and set the clock that is wrong; otherwise wait".into()
            }
            Self::Expired { .. } => {
                "compare the time found with a trusted clock, and set the clock that is wrong; if it is right, have a \
                 new certificate issued"
                    .into()
            }
            Self::NotAnAuthority { .. } => "give the certificate of the CA itself, not one that it issued".into(),
            Self::Authority { .. } => "use a certificate that the CA issued to an identity".into(),
            Self::WrongUsage { .. } | Self::BadPath { .. } => "have a certificate issued for this purpose".into(),
            Self::UnsupportedKey { .. } => "enrol again with a key of kind ed25519 or p256".into(),
            Self::UnsupportedSignature { .. } => {
                "have it signed again with one of these (OpenSSL: -sha256), by a key that fits".into()
            }
            Self::UnusableAuthority { .. } => {
                "bring an authority that fits, such as an intermediate one with a key of P-256, or have this one issued again".into()
            }
            Self::SharedAuthority { .. } => "let each organisation operate its own CA with its own name and key".into(),
        }
    }

    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Malformed { .. }
            | Self::TooLarge { .. }
            | Self::UnsupportedKey { .. }
            | Self::BadName { .. }
            | Self::SharedAuthority { .. }
            | Self::UnusableAuthority { .. }
            | Self::NotAnAuthority { .. } => Code::CertificateMalformed,
            Self::NotYetValid { .. } => Code::CertificateNotYetValid,
            Self::Expired { .. } => Code::CertificateExpired,
            Self::Untrusted { .. }
            | Self::BadSignature { .. }
            | Self::Authority { .. }
            | Self::UnsupportedSignature { .. }
            | Self::WrongUsage { .. }
            | Self::BadPath { .. } => Code::Untrusted,
        }
    }
}

impl From<IdentityError> for Rejection {
    fn from(error: IdentityError) -> Self {
        Self::told(error.code(), &error.to_string()).next(error.remedy())
    }
}

/// The rejection of something in another form.
pub(crate) fn malformed(found: String, wanted: &'static str) -> IdentityError {
    IdentityError::Malformed { found, wanted }
}

/// Refuses more than is ever read.
pub(crate) fn at_most(unit: &'static str, found: usize, max: usize) -> Result<(), IdentityError> {
    if found > max { Err(IdentityError::TooLarge { unit, found, max }) } else { Ok(()) }
}

/// A name from a certificate, quoted, escaped and cut, fit for one line of a log.
pub(crate) fn printable(name: &str) -> String {
    let mut cut: String = name.chars().take(PRINTABLE_CHARS_MAX).collect();
    if cut.len() < name.len() {
        cut.push('…');
    }
    format!("{cut:?}")
}

fn list(organisations: &[String]) -> String {
    match organisations {
        [] => "an organisation (the network has none)".into(),
        names => names.join(" or "),
    }
}

/// A time for people, from microseconds since the UNIX epoch.
fn time(at: u64) -> String {
    let seconds = i64::try_from(at / 1_000_000).unwrap_or(i64::MAX);
    ASN1Time::from_timestamp(seconds).map_or_else(|_| format!("{at} µs"), |time| time.to_string())
}
