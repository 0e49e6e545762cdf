//! Certificate revocation lists (CRLs) of X.509, read within limits.
//!
//! Reading is not trusting: [`crate::msp::Msp::verify_list`] answers whether an authority of the organisation has signed one. Only
//! complete lists are read, because a part must not pass for the whole. Lists of changes, lists that speak for other issuers,
//! and lists with a critical extension that is not known here are refused.

use crate::certificate::{microseconds, name_text, serial_number};
use crate::der::{self, Element, SEQUENCE};
use crate::distinguished_name::DistinguishedName;
use crate::identity::{IdentityError, at_most, malformed};
use crate::signature::Signed;
use ledger_base::hash::Hash;
use std::collections::BTreeSet;
use x509_parser::extensions::{ParsedExtension, X509Extension};
use x509_parser::oid_registry::{
    OID_X509_EXT_CRL_NUMBER, OID_X509_EXT_ISSUER_DISTRIBUTION_POINT, OID_X509_EXT_REASON_CODE, Oid,
};
use x509_parser::prelude::FromDer;
use x509_parser::revocation_list::{CertificateRevocationList, RevokedCertificate};
use x509_parser::x509::ReasonCode;

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
    /// The issuer's distinguished name.
    pub issuer_name: DistinguishedName,
    /// When it was made, microseconds since the UNIX epoch.
    pub this_update: u64,
    /// Last microsecond since the UNIX epoch before which the next one should have come; none if it does not say.
    pub next_update: Option<u64>,
    /// Its number, big-endian without leading zeros; none if it has none, as those of Fabric.
    pub number: Option<Vec<u8>>,
    /// The serial numbers that it revokes, as [`crate::certificate::Certificate::serial`].
    pub serials: BTreeSet<Vec<u8>>,
    /// The certificates that it speaks about.
    pub scope: Scope,
    signed: Signed,
}

/// The certificates that a list speaks about: of these it names all that are revoked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scope {
    /// SHA-256 of the issuing distribution point; none: all certificates of its issuer. Lists of one scope replace each other.
    pub point: Option<Hash>,
    /// It leaves out the certificates of people, or some reasons to revoke them.
    pub leaves_out_people: bool,
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
        if !der::is_strict(der) {
            return Err(malformed("an encoding that is not DER".into(), wanted));
        }
        let signed = Signed::of(der).ok_or_else(|| {
            malformed("a signature in another form".into(), "one algorithm inside and outside, and whole bytes")
        })?;
        let tbs = &parsed.tbs_cert_list;
        at_most("certificates in a revocation list", tbs.revoked_certificates.len(), LISTED_MAX)?;
        check_extensions(tbs.extensions(), &[OID_X509_EXT_CRL_NUMBER, OID_X509_EXT_ISSUER_DISTRIBUTION_POINT])?;
        let next_update = tbs.next_update.map(|time| microseconds(time).saturating_add(999_999));
        let this_update = microseconds(tbs.this_update);
        if next_update.is_some_and(|next| next < this_update) {
            return Err(malformed("a next update before this one".into(), "a next update after this one"));
        }
        let issuer_name = DistinguishedName::parse(parsed.issuer().as_raw())?;
        let mut serials = BTreeSet::new();
        for entry in &tbs.revoked_certificates {
            serials.extend(listed(entry)?);
        }
        Ok(Self {
            issuer: name_text(&issuer_name),
            issuer_name,
            this_update,
            next_update,
            number: number(tbs.extensions())?,
            serials,
            scope: scope(tbs.extensions())?,
            signed,
        })
    }

    /// The part that its issuer has signed, and the signature.
    pub(crate) fn signed(&self) -> &Signed {
        &self.signed
    }
}

/// Refuses extensions that cannot be read, stand twice, or are critical and not known here.
fn check_extensions(extensions: &[X509Extension<'_>], known: &[Oid<'_>]) -> Result<(), IdentityError> {
    let mut seen = BTreeSet::new();
    for extension in extensions {
        let oid = &extension.oid;
        if extension.parsed_extension().error().is_some() || !seen.insert(oid.to_id_string()) {
            return Err(malformed(
                format!("an extension {oid} of a revocation list that is unreadable or duplicate"),
                "each extension once, in its form",
            ));
        }
        if extension.critical && !known.contains(oid) {
            return Err(malformed(
                format!("an unknown critical extension {oid} of a revocation list"),
                "a complete list of one issuer; no list of changes, and none that speaks for others",
            ));
        }
    }
    Ok(())
}

/// The serial number of an entry; none if it takes back what another list revoked, which nothing does here.
fn listed(entry: &RevokedCertificate<'_>) -> Result<Option<Vec<u8>>, IdentityError> {
    check_extensions(entry.extensions(), &[OID_X509_EXT_REASON_CODE])?;
    let is_removed = |extension: &X509Extension<'_>| {
        matches!(extension.parsed_extension(), ParsedExtension::ReasonCode(ReasonCode::RemoveFromCRL))
    };
    let serial = serial_number(entry.raw_serial())?;
    Ok((!entry.extensions().iter().any(is_removed)).then_some(serial))
}

/// The scope that the issuing distribution point gives a list.
fn scope(extensions: &[X509Extension<'_>]) -> Result<Scope, IdentityError> {
    let point = extensions.iter().find(|extension| extension.oid == OID_X509_EXT_ISSUER_DISTRIBUTION_POINT);
    let Some(point) = point else { return Ok(Scope::default()) };
    let refused = |found: &str, wanted| malformed(format!("an issuing distribution point {found}"), wanted);
    let parts = Element::inside(point.value, SEQUENCE);
    let (mut people, mut authorities, mut reasons) = (false, false, false);
    for part in parts.ok_or_else(|| refused("that cannot be read", "the form of RFC 5280 section 5.2.5"))? {
        match (part.tag, part.content) {
            // Where it lies: lists of another place are of another scope.
            (0xa0, _) | (0x81 | 0x82 | 0x84 | 0x85, [0]) => {}
            (0x81, [_]) => people = true,
            (0x82, [_]) => authorities = true,
            (0x83, _) => reasons = true,
            (0x84, [_]) => {
                return Err(refused(
                    "of an indirect list",
                    "a list of the authority's own certificates alone (indirectCRL false)",
                ));
            }
            (0x85, [_]) => {
                return Err(refused(
                    "of attribute certificates",
                    "a list of public key certificates, which people have",
                ));
            }
            _ => return Err(refused("with an unknown part", "the form of RFC 5280 section 5.2.5")),
        }
    }
    if people && authorities {
        return Err(refused("of people alone and of authorities alone", "one of them, or neither"));
    }
    Ok(Scope { point: Some(Hash::of(&[point.value])), leaves_out_people: authorities || reasons })
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
