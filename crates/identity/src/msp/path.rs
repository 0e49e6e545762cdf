//! The path from a certificate to a root of one organisation.

use super::{Authority, Msp, Usage};
use crate::certificate::Certificate;
use crate::identity::{IdentityError, printable};
use crate::key::{KeyKind, PublicKey};
use crate::revocation_list::RevocationList;
use ledger_base::hash::Hash;
use rustls_pki_types::{CertificateDer, SignatureVerificationAlgorithm, UnixTime};
use std::time::Duration;
use webpki::ring::{ECDSA_P256_SHA256, ECDSA_P384_SHA384, ED25519};
use webpki::{EndEntityCert, ExtendedKeyUsageValidator, KeyPurposeId, KeyPurposeIdIter};

/// Algorithms with which authorities may sign. P-384 is common for the keys of a CA.
const ALGORITHMS: &[&dyn SignatureVerificationAlgorithm] = &[ED25519, ECDSA_P256_SHA256, ECDSA_P384_SHA384];

const ANY_USAGE: KeyPurposeId<'_> = KeyPurposeId::new(&[0x55, 0x1d, 0x25, 0x00]);
const SERVER_AUTH: KeyPurposeId<'_> = KeyPurposeId::new(&[0x2b, 0x06, 0x01, 0x05, 0x05, 0x07, 0x03, 0x01]);
const CLIENT_AUTH: KeyPurposeId<'_> = KeyPurposeId::new(&[0x2b, 0x06, 0x01, 0x05, 0x05, 0x07, 0x03, 0x02]);

/// A certificate whose path is looked for.
pub(super) struct Leaf<'a> {
    pub(super) der: CertificateDer<'a>,
    pub(super) certificate: &'a Certificate,
    pub(super) usage: Usage,
    /// The time of the check, in microseconds since the UNIX epoch.
    pub(super) at: u64,
}

/// A path that was found.
#[derive(Debug)]
pub(super) struct Path {
    /// SHA-256 of the certificate that has issued the leaf.
    pub(super) issuer: Hash,
    /// Since when every certificate of it is valid, in microseconds since the UNIX epoch.
    pub(super) not_before: u64,
    /// Until when every certificate of it is valid, in microseconds since the UNIX epoch.
    pub(super) not_after: u64,
}

impl Path {
    fn narrow(&mut self, certificate: &Certificate) {
        self.not_before = self.not_before.max(certificate.not_before);
        self.not_after = self.not_after.min(certificate.not_after);
    }
}

impl Leaf<'_> {
    /// Looks for a path to any root of the organisation.
    pub(super) fn path_to(&self, msp: &Msp, presented: &[Authority]) -> Result<Path, IdentityError> {
        let issuers: Vec<_> = msp.intermediates.iter().chain(presented).map(|found| found.der.clone()).collect();
        let mut refused = self.untrusted(msp);
        for root in &msp.roots {
            match self.path_to_root(msp, root, &issuers) {
                Ok(path) => return Ok(path),
                Err(error) => refused = more_telling(refused, error),
            }
        }
        Err(refused)
    }

    fn path_to_root(&self, msp: &Msp, root: &Authority, issuers: &[CertificateDer<'_>]) -> Result<Path, IdentityError> {
        let leaf = EndEntityCert::try_from(&self.der).map_err(|error| self.explain(msp, &error))?;
        // webpki reads neither the path length nor the validity of an anchor.
        let length_max = root.certificate.path_length_max().and_then(|max| usize::try_from(max).ok());
        let within_length = |path: &webpki::VerifiedPath<'_>| match length_max {
            Some(max) if path.intermediate_certificates().count() > max => {
                Err(webpki::Error::PathLenConstraintViolated)
            }
            _ => Ok(()),
        };
        let path = leaf
            .verify_for_usage(
                ALGORITHMS,
                std::slice::from_ref(&root.anchor),
                issuers,
                UnixTime::since_unix_epoch(Duration::from_micros(self.at)),
                self.usage,
                None,
                Some(&within_length),
            )
            .map_err(|error| self.explain(msp, &error))?;
        root.certificate.check_validity(self.at)?;
        // The intermediates stand in the order from the leaf to the root.
        let direct = path.intermediate_certificates().next().map(|issuer| Hash::of(&[issuer.der().as_ref()]));
        let mut found = Path {
            issuer: direct.unwrap_or_else(|| Hash::of(&[root.der.as_ref()])),
            not_before: self.certificate.not_before,
            not_after: self.certificate.not_after,
        };
        found.narrow(&root.certificate);
        for issuer in path.intermediate_certificates() {
            found.narrow(&Certificate::parse(&issuer.der())?);
        }
        Ok(found)
    }

    fn untrusted(&self, msp: &Msp) -> IdentityError {
        IdentityError::Untrusted { issuer: printable(&self.certificate.issuer), wanted: vec![msp.organisation.clone()] }
    }

    /// The verdict of webpki, in our words. The certificate's own validity was checked before, so that an expired one
    /// here is an issuer's.
    fn explain(&self, msp: &Msp, error: &webpki::Error) -> IdentityError {
        let issuer = || format!("an intermediate authority of {}", msp.organisation);
        let subject = printable(&self.certificate.subject);
        match error {
            webpki::Error::UnknownIssuer => self.untrusted(msp),
            webpki::Error::CertExpired { not_after, .. } => IdentityError::Expired {
                subject: issuer(),
                not_after: not_after.as_secs().saturating_mul(1_000_000).saturating_add(999_999),
                at: self.at,
            },
            webpki::Error::CertNotValidYet { not_before, .. } => IdentityError::NotYetValid {
                subject: issuer(),
                not_before: not_before.as_secs().saturating_mul(1_000_000),
                at: self.at,
            },
            webpki::Error::InvalidSignatureForPublicKey
            | webpki::Error::UnsupportedSignatureAlgorithmForPublicKeyContext(_) => IdentityError::BadSignature {
                subject,
                issuer: printable(&self.certificate.issuer),
                organisation: msp.organisation.clone(),
            },
            webpki::Error::EmptyEkuExtension => IdentityError::WrongUsage {
                subject,
                found: "an extended key usage without this use, in the certificate or an issuer's".into(),
                wanted: match self.usage {
                    Usage::Client => "clientAuth, or no extended key usage",
                    Usage::Server => "serverAuth, or no extended key usage",
                },
            },
            webpki::Error::BadDer
            | webpki::Error::BadDerTime
            | webpki::Error::ExtensionValueInvalid
            | webpki::Error::InvalidCertValidity
            | webpki::Error::InvalidSerialNumber
            | webpki::Error::MalformedExtensions
            | webpki::Error::SignatureAlgorithmMismatch
            | webpki::Error::TrailingData(_)
            | webpki::Error::UnsupportedCertVersion => {
                IdentityError::Malformed { found: error.to_string(), wanted: "an X.509 version 3 certificate in DER" }
            }
            _ => IdentityError::BadPath { subject, organisation: msp.organisation.clone(), found: broken_rule(error) },
        }
    }
}

/// The rules that people break, in words; the rest as webpki calls it.
fn broken_rule(error: &webpki::Error) -> String {
    match error {
        webpki::Error::PathLenConstraintViolated => "more authorities than a path length constraint allows".into(),
        webpki::Error::NameConstraintViolation => "a name that a name constraint excludes".into(),
        webpki::Error::UnsupportedCriticalExtension => "a critical extension that is not known here".into(),
        webpki::Error::UnsupportedSignatureAlgorithmContext(_) => {
            "a signature that is neither Ed25519 nor ECDSA P-256 with SHA-256 nor P-384 with SHA-384".into()
        }
        _ => error.to_string(),
    }
}

/// Absent extended key usages are accepted, as users of Fabric have none; if present, they must allow the use.
impl ExtendedKeyUsageValidator for Usage {
    fn validate(&self, found: KeyPurposeIdIter<'_, '_>) -> Result<(), webpki::Error> {
        let wanted = match self {
            Self::Client => CLIENT_AUTH,
            Self::Server => SERVER_AUTH,
        };
        let mut absent = true;
        for purpose in found {
            let purpose = purpose?;
            if purpose == wanted || purpose == ANY_USAGE {
                return Ok(());
            }
            absent = false;
        }
        // The error for "not this use" cannot be made outside of webpki; `explain` words this one for both.
        if absent { Ok(()) } else { Err(webpki::Error::EmptyEkuExtension) }
    }
}

/// Checks that an authority of this organisation, which has the name that a revocation list gives, has signed it.
pub(super) fn check_list(
    organisation: &str,
    authority: &Certificate,
    list: &RevocationList,
) -> Result<(), IdentityError> {
    authority.check_signs_lists()?;
    let (signed, algorithm, signature) = list.signature();
    let not_signed = || IdentityError::BadSignature {
        subject: "a revocation list".into(),
        issuer: printable(&list.issuer),
        organisation: organisation.to_owned(),
    };
    let key = PublicKey::from_spki(&authority.public_key_info).map_err(|_| not_signed())?;
    let algorithms: [(&dyn SignatureVerificationAlgorithm, &[u8], KeyKind); 3] = [
        (ED25519, &[0x2b, 0x65, 0x70], KeyKind::Ed25519),
        (ECDSA_P256_SHA256, &[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02], KeyKind::P256),
        (ECDSA_P384_SHA384, &[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x03], KeyKind::P384),
    ];
    let known = algorithms.iter().find(|(_, oid, kind)| *oid == algorithm && *kind == key.kind());
    match known {
        Some((verifier, ..)) => verifier.verify_signature(key.bytes(), signed, signature).map_err(|_| not_signed()),
        None => Err(not_signed()),
    }
}

/// Of two refusals, the one from further along the path: a root that verified but has expired says more than
/// another root that did not fit.
pub(super) fn more_telling(first: IdentityError, second: IdentityError) -> IdentityError {
    let rank = |error: &IdentityError| match error {
        IdentityError::Untrusted { .. } => 0,
        IdentityError::BadSignature { .. } => 1,
        IdentityError::Expired { .. } | IdentityError::NotYetValid { .. } => 3,
        _ => 2,
    };
    if rank(&second) > rank(&first) { second } else { first }
}
