//! The authorities of an organisation (MSP, as in Fabric), and the check of a certificate against
//! those of all organisations.
//!
//! The path is checked as RFC 5280 section 6 says, a root like any other authority, without policies. Beyond that no
//! certificate passes for two organisations.

mod entry;
mod path;

pub use crate::certificate::Usage;

use crate::certificate::Certificate;
use crate::distinguished_name::DistinguishedName;
use crate::identity::{Identity, IdentityError, at_most, check_name, malformed, printable};
use crate::key::PublicKey;
use crate::revocation_list::RevocationList;
use crate::signature::{Fault, WANTED};
use crate::units::Units;
use ledger_base::hash::Hash;
use rustls_pki_types::CertificateDer;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Most roots of one organisation.
pub const ROOTS_MAX: usize = 8;

/// Most intermediate authorities that one organisation declares.
pub const INTERMEDIATES_MAX: usize = 8;

/// Most certificates that may come along with a certificate, its issuers and their root.
pub const PRESENTED_MAX: usize = 4;

/// The authorities of one organisation.
#[derive(Clone, Debug)]
pub struct Msp {
    organisation: String,
    roots: Vec<Authority>,
    intermediates: Vec<Authority>,
    /// SHA-256 of the distinguished name of each authority that leads to a root.
    standing: BTreeSet<[u8; 32]>,
    /// The units that name roles; none: our own words.
    units: Option<Units>,
}

/// The certificate of an authority.
#[derive(Clone, Debug)]
struct Authority {
    der: CertificateDer<'static>,
    certificate: Certificate,
}

/// The authority that has signed a revocation list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListIssuer {
    /// SHA-256 of its distinguished name, as its own certificate writes it.
    pub name: Hash,
    /// SHA-256 of its public key (SubjectPublicKeyInfo).
    pub key: Hash,
}

impl Authority {
    fn new(der: &[u8]) -> Result<Self, IdentityError> {
        let certificate = Certificate::parse(der)?;
        certificate.check_authority()?;
        Ok(Self { der: CertificateDer::from(der.to_vec()), certificate })
    }

    fn all(ders: &[impl AsRef<[u8]>]) -> Result<Vec<Self>, IdentityError> {
        ders.iter().map(|der| Self::new(der.as_ref())).collect()
    }
}

impl Msp {
    /// An organisation with its roots and, if its roots do not sign identities themselves, the intermediates that
    /// do. Certificates are in DER. Their validity is checked at each use, not here.
    ///
    /// # Errors
    /// [`IdentityError::BadName`], [`IdentityError::TooLarge`], [`IdentityError::NotAnAuthority`], and
    /// [`IdentityError::Malformed`] if a certificate cannot be read or there is no root.
    pub fn new(
        organisation: &str,
        roots: &[impl AsRef<[u8]>],
        intermediates: &[impl AsRef<[u8]>],
    ) -> Result<Self, IdentityError> {
        check_name(organisation)?;
        at_most("roots", roots.len(), ROOTS_MAX)?;
        at_most("intermediates", intermediates.len(), INTERMEDIATES_MAX)?;
        if roots.is_empty() {
            return Err(malformed(format!("no root of {organisation}"), "at least one root of each organisation"));
        }
        let (roots, intermediates) = (Authority::all(roots)?, Authority::all(intermediates)?);
        let standing = standing(&roots, &intermediates);
        Ok(Self { organisation: organisation.to_owned(), roots, intermediates, standing, units: None })
    }

    /// The authorities that vouch for somebody, each by the SHA-256 of its distinguished name: the roots, and the declared
    /// intermediates whose issuer is one of these.
    pub fn standing(&self) -> &BTreeSet<[u8; 32]> {
        &self.standing
    }

    /// The same with units of its own that name roles; none: our own words.
    ///
    /// # Errors
    /// [`IdentityError::TooLarge`], [`IdentityError::Malformed`] if a unit cannot be used.
    pub fn with_units(self, units: Option<Units>) -> Result<Self, IdentityError> {
        units.as_ref().map_or(Ok(()), Units::check)?;
        Ok(Self { units, ..self })
    }

    /// The units that name roles; none: our own words.
    pub fn units(&self) -> Option<&Units> {
        self.units.as_ref()
    }

    /// The organisation's name.
    pub fn organisation(&self) -> &str {
        &self.organisation
    }

    /// The roots, in DER.
    pub fn roots(&self) -> impl Iterator<Item = &[u8]> {
        self.roots.iter().map(|root| root.der.as_ref())
    }

    /// The declared intermediates, in DER.
    pub fn intermediates(&self) -> impl Iterator<Item = &[u8]> {
        self.intermediates.iter().map(|intermediate| intermediate.der.as_ref())
    }

    /// Reads a revocation list and verifies that one of these authorities has issued it. Whether it is still current, and
    /// newer than another one, is not asked.
    ///
    /// # Errors
    /// As [`RevocationList::parse`]; [`IdentityError::Untrusted`] if its issuer is none of them,
    /// [`IdentityError::BadSignature`], [`IdentityError::UnsupportedSignature`], [`IdentityError::WrongUsage`] if that
    /// authority may not sign lists.
    pub fn verify_list(&self, der: &[u8]) -> Result<(RevocationList, ListIssuer), IdentityError> {
        let list = RevocationList::parse(der)?;
        let mut refused =
            IdentityError::Untrusted { issuer: printable(&list.issuer), wanted: vec![self.organisation.clone()] };
        // An authority that was renewed stands here twice, with one name and two keys.
        let mut signer = None;
        for Authority { certificate, .. } in self.named(&list.issuer_name) {
            match self.check_list(certificate, &list) {
                Ok(()) => signer = signer.or(Some(certificate)),
                Err(error) => refused = path::more_telling(refused, error),
            }
        }
        let signer = signer.ok_or(refused)?;
        let issuer = ListIssuer { name: signer.subject_name.hash(), key: Hash::of(&[&signer.public_key_info]) };
        Ok((list, issuer))
    }

    /// Checks that this authority, which has the name that the list gives, has signed it.
    fn check_list(&self, authority: &Certificate, list: &RevocationList) -> Result<(), IdentityError> {
        authority.check_signs_lists()?;
        list.signed().verify(&authority.public_key_info).map_err(|fault| match fault {
            Fault::Unsupported(found) => IdentityError::UnsupportedSignature {
                what: format!("the revocation list of {}", printable(&list.issuer)),
                found,
                wanted: WANTED,
            },
            Fault::Mismatch => IdentityError::BadSignature {
                subject: "a revocation list".into(),
                issuer: printable(&list.issuer),
                organisation: self.organisation.clone(),
            },
        })
    }

    /// SHA-256 of the distinguished name of the authority that has this name, as its own certificate writes it: what names the
    /// issuer of a certificate on the ledger.
    pub fn issuer(&self, name: &DistinguishedName) -> Option<Hash> {
        self.named(name).next().map(|authority| authority.certificate.subject_name.hash())
    }

    fn named(&self, name: &DistinguishedName) -> impl Iterator<Item = &Authority> {
        self.authorities().filter(move |found| found.certificate.subject_name == *name)
    }

    fn authorities(&self) -> impl Iterator<Item = &Authority> {
        self.roots.iter().chain(&self.intermediates)
    }
}

/// The names of the authorities that lead to a root.
fn standing(roots: &[Authority], intermediates: &[Authority]) -> BTreeSet<[u8; 32]> {
    let mut names: BTreeSet<&DistinguishedName> = roots.iter().map(|root| &root.certificate.subject_name).collect();
    loop {
        let below = intermediates.iter().map(|found| &found.certificate);
        let below = below.filter(|found| names.contains(&found.issuer_name));
        let more: BTreeSet<_> = below.map(|found| &found.subject_name).collect();
        if more.is_subset(&names) {
            return names.into_iter().map(|name| name.hash().0).collect();
        }
        names.extend(more);
    }
}

/// The authorities of all organisations of a network. Cheap to clone, so that a changed set replaces the old one
/// while checks against the old one finish.
#[derive(Clone, Debug, Default)]
pub struct Msps {
    organisations: BTreeMap<String, Arc<Msp>>,
    /// Name of each declared authority -> its organisation.
    names: HashMap<DistinguishedName, String>,
    /// Public key (DER) of each declared authority -> its organisation.
    keys: HashMap<Vec<u8>, String>,
}

impl Msps {
    /// No organisation yet: every certificate is refused.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an organisation, or replaces it if there is one of this name.
    ///
    /// # Errors
    /// [`IdentityError::SharedAuthority`] if another organisation has an authority of the same name or key. Nothing
    /// is changed then.
    pub fn insert(&mut self, msp: Msp) -> Result<(), IdentityError> {
        let mut changed = self.clone();
        changed.remove(&msp.organisation);
        for authority in msp.authorities() {
            let Certificate { subject, subject_name, public_key_info, .. } = &authority.certificate;
            let own = || msp.organisation.clone();
            let of_name = changed.names.entry(subject_name.clone()).or_insert_with(own);
            let of_key = changed.keys.entry(public_key_info.clone()).or_insert_with(own);
            if let Some(owner) = [of_name, of_key].into_iter().find(|owner| **owner != msp.organisation) {
                return Err(IdentityError::SharedAuthority {
                    subject: printable(subject),
                    first: owner.clone(),
                    second: msp.organisation.clone(),
                });
            }
        }
        changed.organisations.insert(msp.organisation.clone(), Arc::new(msp));
        *self = changed;
        Ok(())
    }

    /// Removes an organisation; its certificates are refused from then on. False if there was none of this name.
    pub fn remove(&mut self, organisation: &str) -> bool {
        self.names.retain(|_, owner| owner != organisation);
        self.keys.retain(|_, owner| owner != organisation);
        self.organisations.remove(organisation).is_some()
    }

    /// One organisation.
    pub fn get(&self, organisation: &str) -> Option<&Msp> {
        self.organisations.get(organisation).map(Arc::as_ref)
    }

    /// SHA-256 of the name that a certificate gives its issuer, as the ledger writes it ([`Msp::issuer`]).
    pub fn issuer(&self, name: &DistinguishedName) -> Hash {
        let declared = self.names.get(name).and_then(|organisation| self.get(organisation)?.issuer(name));
        declared.unwrap_or_else(|| name.hash())
    }

    /// All organisations, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = &Msp> {
        self.organisations.values().map(Arc::as_ref)
    }

    /// Verifies the certificate of somebody who signs or calls, at a time in microseconds since the UNIX epoch.
    ///
    /// `presented` are certificates that came along; declared intermediates need not be among them, and a root is
    /// ignored. Whether the certificate was revoked is asked elsewhere, by [`Identity::revocation_key`].
    ///
    /// The answer may be kept for as long as [`Identity::check_validity`] agrees and this set does not change.
    ///
    /// # Errors
    /// [`IdentityError`]: the first rule that is broken, in the order form, issuer, validity, use, signature, path.
    pub fn verify(&self, der: &[u8], presented: &[CertificateDer<'_>], at: u64) -> Result<Identity, IdentityError> {
        self.verify_for(Usage::Client, der, presented, at)
    }

    /// As [`Msps::verify`], for a given use of the certificate.
    ///
    /// # Errors
    /// As [`Msps::verify`].
    pub fn verify_for(
        &self,
        usage: Usage,
        der: &[u8],
        presented: &[CertificateDer<'_>],
        at: u64,
    ) -> Result<Identity, IdentityError> {
        let certificate = Certificate::parse(der)?;
        let presented = read_presented(presented)?;
        let candidates = self.candidates(&certificate, &presented);
        let mut refused = IdentityError::Untrusted {
            issuer: printable(&certificate.issuer),
            wanted: self.organisations.keys().cloned().collect(),
        };
        if candidates.is_empty() {
            return Err(refused);
        }
        certificate.check_validity(at)?;
        certificate.check_holder(usage)?;
        let name = certificate.name()?;
        let common = if candidates.iter().all(|msp| msp.units.is_none()) { Some(certificate.role()?) } else { None };
        let attributes = certificate.attributes()?;
        let public_key = PublicKey::from_spki(&certificate.public_key_info)
            .map_err(|reason| IdentityError::UnsupportedKey { subject: printable(&certificate.subject), reason })?;
        for msp in candidates {
            match path::find(msp, &presented, (&certificate, usage, at)) {
                Ok(path::Path { issuer, issuer_name, not_before, not_after }) => {
                    let role = match (common, &msp.units) {
                        (Some(role), _) => role,
                        (None, Some(units)) => units.role(certificate.units(), &issuer)?,
                        (None, None) => certificate.role()?,
                    };
                    return Ok(Identity {
                        organisation: msp.organisation.clone(),
                        name: name.to_owned(),
                        role,
                        attributes,
                        issuer: issuer_name.0,
                        serial: certificate.serial.clone(),
                        fingerprint: Hash::of(&[der]).0,
                        public_key,
                        valid_from: certificate.not_before,
                        not_before,
                        not_after,
                    });
                }
                Err(error) => refused = path::more_telling(refused, error),
            }
        }
        Err(refused)
    }

    /// The organisations whose authorities the certificate or its presented issuers name. If the issuer itself is
    /// declared, only the organisation that declared it: nobody else can speak in its name.
    fn candidates(&self, certificate: &Certificate, presented: &[Authority]) -> Vec<&Msp> {
        let names: BTreeSet<&String> = match self.names.get(&certificate.issuer_name) {
            Some(organisation) => BTreeSet::from([organisation]),
            None => presented.iter().filter_map(|found| self.names.get(&found.certificate.issuer_name)).collect(),
        };
        names.into_iter().filter_map(|name| self.get(name)).collect()
    }
}

/// Reads the certificates that came along. Roots are left out (they come from the MSP only), and each name may
/// occur once: otherwise a hostile peer could make the search for a path expensive.
fn read_presented(ders: &[CertificateDer<'_>]) -> Result<Vec<Authority>, IdentityError> {
    at_most("presented certificates", ders.len(), PRESENTED_MAX)?;
    let mut authorities = Authority::all(ders)?;
    authorities.retain(|found| found.certificate.subject_name != found.certificate.issuer_name);
    let names: BTreeSet<_> = authorities.iter().map(|found| &found.certificate.subject_name).collect();
    if names.len() < authorities.len() {
        return Err(malformed("two presented issuers of one name".into(), "each issuer of the path once"));
    }
    Ok(authorities)
}
