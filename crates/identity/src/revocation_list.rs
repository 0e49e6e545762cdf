//! Certificate revocation lists (CRLs) of X.509, read within limits.
//!
//! Reading is not trusting: [`crate::msp::Msp::verify_list`] answers whether an authority of the organisation has signed one. Only
//! complete lists are read, because a part must not pass for the whole. Lists of changes, lists that speak for other issuers,
//! and lists with a critical extension that is not known here are refused.

use crate::certificate::{at_most, malformed, microseconds, serial_number};
use crate::identity::IdentityError;
use std::collections::BTreeSet;
use x509_parser::extensions::{ParsedExtension, X509Extension};
use x509_parser::oid_registry::{OID_X509_EXT_CRL_NUMBER, OID_X509_EXT_REASON_CODE};
use x509_parser::prelude::FromDer;
use x509_parser::revocation_list::{CertificateRevocationList, RevokedCertificate};

/// Largest list that is read, in bytes of DER.
pub const LIST_BYTES_MAX: usize = 128 * 1024;

/// Most certificates in a list.
pub const LISTED_MAX: usize = 2_000;

/// Longest number of a list, in bytes (RFC 5280).
const NUMBER_BYTES_MAX: usize = 20;

/// The content of a list; nothing of it is verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RevocationList {
    /// The issuer, for people.
    pub issuer: String,
    /// The issuer's distinguished name in DER.
    pub issuer_name: Vec<u8>,
    /// When it was made, microseconds since the UNIX epoch.
    pub this_update: u64,
    /// Last microsecond since the UNIX epoch before which the next one should have come; none if it does not say.
    pub next_update: Option<u64>,
    /// Its number, big-endian without leading zeros; none if it has none, as those of Fabric.
    pub number: Option<Vec<u8>>,
    /// The serial numbers that it revokes, as [`crate::certificate::Certificate::serial`].
    pub serials: BTreeSet<Vec<u8>>,
    /// The bytes that are signed.
    signed: Vec<u8>,
    /// The algorithm of the signature: content of its object identifier.
    algorithm: Vec<u8>,
    signature: Vec<u8>,
}

impl RevocationList {
    /// Reads one list in DER and nothing after it.
    ///
    /// # Errors
    /// [`IdentityError::TooLarge`], [`IdentityError::Malformed`].
    pub fn parse(der: &[u8]) -> Result<Self, IdentityError> {
        at_most("bytes of a revocation list", der.len(), LIST_BYTES_MAX)?;
        let wanted = "an X.509 revocation list in DER";
        let (rest, parsed) =
            CertificateRevocationList::from_der(der).map_err(|error| malformed(error.to_string(), wanted))?;
        if !rest.is_empty() {
            return Err(malformed(format!("{} bytes after it", rest.len()), "a revocation list and nothing after it"));
        }
        let tbs = &parsed.tbs_cert_list;
        if tbs.signature != parsed.signature_algorithm {
            return Err(malformed("two algorithms of its signature".into(), "the same one inside and outside"));
        }
        if parsed.signature_value.unused_bits != 0 {
            return Err(malformed("a signature that ends within a byte".into(), "a signature of whole bytes"));
        }
        at_most("certificates in a revocation list", tbs.revoked_certificates.len(), LISTED_MAX)?;
        check_extensions(tbs.extensions(), &OID_X509_EXT_CRL_NUMBER)?;
        let next_update = tbs.next_update.map(|time| microseconds(time).saturating_add(999_999));
        let this_update = microseconds(tbs.this_update);
        if next_update.is_some_and(|next| next < this_update) {
            return Err(malformed("a next update before this one".into(), "a next update after this one"));
        }
        Ok(Self {
            issuer: crate::certificate::name_text(parsed.issuer()),
            issuer_name: parsed.issuer().as_raw().to_vec(),
            this_update,
            next_update,
            number: number(tbs.extensions())?,
            serials: tbs.revoked_certificates.iter().map(listed).collect::<Result<_, _>>()?,
            signed: tbs.as_ref().to_vec(),
            algorithm: parsed.signature_algorithm.algorithm.as_bytes().to_vec(),
            signature: parsed.signature_value.data.to_vec(),
        })
    }

    /// The signed bytes, the algorithm (content of its object identifier) and the signature.
    pub(crate) fn signature(&self) -> (&[u8], &[u8], &[u8]) {
        (&self.signed, &self.algorithm, &self.signature)
    }
}

/// Refuses extensions that cannot be read, stand twice, or are critical and not known here.
fn check_extensions(
    extensions: &[X509Extension<'_>],
    known: &x509_parser::oid_registry::Oid<'_>,
) -> Result<(), IdentityError> {
    let mut seen = BTreeSet::new();
    for extension in extensions {
        let oid = &extension.oid;
        if extension.parsed_extension().error().is_some() || !seen.insert(oid.to_id_string()) {
            return Err(malformed(
                format!("an extension {oid} of a revocation list that is unreadable or stands twice"),
                "each extension once, in its form",
            ));
        }
        if extension.critical && oid != known {
            return Err(malformed(
                format!("a critical extension {oid} of a revocation list that is not known here"),
                "a complete list of one issuer; no list of changes, and none that speaks for others",
            ));
        }
    }
    Ok(())
}

/// The serial number of an entry.
fn listed(entry: &RevokedCertificate<'_>) -> Result<Vec<u8>, IdentityError> {
    check_extensions(entry.extensions(), &OID_X509_EXT_REASON_CODE)?;
    serial_number(entry.raw_serial())
}

/// The number of a list, if it has one.
fn number(extensions: &[X509Extension<'_>]) -> Result<Option<Vec<u8>>, IdentityError> {
    let numbers = extensions.iter().find_map(|extension| match extension.parsed_extension() {
        ParsedExtension::CRLNumber(number) => Some(number.to_bytes_be()),
        _ => None,
    });
    let Some(number) = numbers else { return Ok(None) };
    at_most("bytes of a list's number", number.len(), NUMBER_BYTES_MAX)?;
    Ok(Some(number))
}
