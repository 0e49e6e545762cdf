//! An organisation's CA and the people and nodes to whom it gives certificates, valid from 2029 to 2031.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "a test that cannot make a certificate has failed")]

use bytes::Bytes;
use ledger_identity::certificate::{ATTRIBUTES_OID, encode_attributes};
use ledger_identity::key::{KeyKind, SigningKey};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, CustomExtension, DnType, IsCa, KeyPair, KeyUsagePurpose,
};
use ring::rand::SystemRandom;

/// An organisation's CA.
pub struct Ca(CertifiedIssuer<'static, KeyPair>);

fn params(name: &str, unit: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    params.not_before = rcgen::date_time_ymd(2029, 1, 1);
    params.not_after = rcgen::date_time_ymd(2031, 1, 1);
    params
}

fn authority(name: &str) -> CertificateParams {
    let mut params = params(name, "ca");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

impl Ca {
    /// A CA with a certificate that it signed itself.
    pub fn new(name: &str) -> Self {
        Self::with_key(name, KeyKind::Ed25519)
    }

    /// The same with a key of that kind.
    pub fn with_key(name: &str, kind: KeyKind) -> Self {
        let kind = match kind {
            KeyKind::Ed25519 => &rcgen::PKCS_ED25519,
            KeyKind::P256 => &rcgen::PKCS_ECDSA_P256_SHA256,
            KeyKind::P384 => &rcgen::PKCS_ECDSA_P384_SHA384,
        };
        Self(CertifiedIssuer::self_signed(authority(name), KeyPair::generate_for(kind).unwrap()).unwrap())
    }

    /// A CA above so many others at most in each path.
    pub fn above(name: &str, most: u8) -> Self {
        let mut params = authority(name);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(most));
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        Self(CertifiedIssuer::self_signed(params, key).unwrap())
    }

    /// A CA below this one.
    pub fn below(&self, name: &str) -> Self {
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        Self(CertifiedIssuer::signed_by(authority(name), key, &self.0).unwrap())
    }

    /// Its certificate.
    pub fn root(&self) -> Bytes {
        Bytes::copy_from_slice(self.0.der())
    }

    /// Somebody with a key of that kind; the unit is the role.
    pub fn user(&self, name: &str, unit: &str, kind: KeyKind) -> User {
        self.issue(params(name, unit), kind)
    }

    /// Somebody with attributes, each of them `true`.
    pub fn user_with(&self, name: &str, unit: &str, attributes: &[&str]) -> User {
        let attributes = attributes.iter().map(|name| ((*name).to_owned(), "true".to_owned())).collect();
        let extension = CustomExtension::from_oid_content(ATTRIBUTES_OID, encode_attributes(&attributes).unwrap());
        let mut params = params(name, unit);
        params.custom_extensions.push(extension);
        self.issue(params, KeyKind::Ed25519)
    }

    /// Somebody with whatever this makes of a common certificate.
    pub fn user_as(&self, [name, unit]: [&str; 2], kind: KeyKind, change: impl FnOnce(&mut CertificateParams)) -> User {
        let mut params = params(name, unit);
        change(&mut params);
        self.issue(params, kind)
    }

    /// The certificate of a public key (SubjectPublicKeyInfo in DER), whoever has the private one.
    pub fn certify_key(&self, [name, unit]: [&str; 2], public: &[u8]) -> Bytes {
        let public = rcgen::SubjectPublicKeyInfo::from_der(public).unwrap();
        Bytes::copy_from_slice(params(name, unit).signed_by(&public, &self.0).unwrap().der())
    }

    fn issue(&self, params: CertificateParams, kind: KeyKind) -> User {
        let key = key(kind);
        let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
        let certificate = params.signed_by(&public, &self.0).unwrap();
        User { key, certificate: Bytes::copy_from_slice(certificate.der()) }
    }

    /// Another certificate for somebody's key.
    pub fn certify(&self, name: &str, unit: &str, user: &User) -> User {
        let public = rcgen::SubjectPublicKeyInfo::from_der(&user.key.public_key().to_spki()).unwrap();
        let mut params = params(name, unit);
        // Otherwise the serial number follows from the key.
        let serial = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap().public_key();
        params.serial_number = Some(rcgen::SerialNumber::from_slice(&serial.bytes()[..16]));
        let certificate = params.signed_by(&public, &self.0).unwrap();
        let key = SigningKey::from_pkcs8_der(user.key.to_pkcs8_der()).unwrap();
        User { key, certificate: Bytes::copy_from_slice(certificate.der()) }
    }

    /// The key of the CA itself.
    pub fn key(&self) -> SigningKey {
        SigningKey::from_pkcs8_der(&self.0.key().serialize_der()).unwrap()
    }
}

/// Somebody with a certificate and its key.
pub struct User {
    /// The private key.
    pub key: SigningKey,
    /// The certificate, DER.
    pub certificate: Bytes,
}

/// A new private key.
pub fn key(kind: KeyKind) -> SigningKey {
    SigningKey::generate(kind, &SystemRandom::new()).unwrap()
}
