//! A certificate authority for tests, and contexts of its users.

use crate::fake::Fake;
use bytes::Bytes;
use ledger_api::Context;
use ledger_api::tls::TlsIdentity;
use ledger_base::hash::Hash;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::{Msp, Msps};
use rcgen::{
    BasicConstraints, CertificateParams, CertificateSigningRequestParams, CertifiedIssuer, DistinguishedName, DnType,
    IsCa, KeyPair, KeyUsagePurpose, date_time_ymd,
};
use ring::rand::SystemRandom;
use rustls::pki_types::{CertificateDer, CertificateSigningRequestDer};
use std::sync::Arc;

/// The network of all tests.
pub(crate) const NETWORK: Hash = Hash([7; 32]);

/// The CA of Org1.
pub(crate) struct Authority(CertifiedIssuer<'static, KeyPair>);

fn params(name: &str, unit: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    params.not_before = date_time_ymd(2020, 1, 1);
    params.not_after = date_time_ymd(2100, 1, 1);
    params
}

impl Authority {
    pub(crate) fn new() -> Self {
        let mut params = params("Org1 CA", "ca");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256).unwrap();
        Self(CertifiedIssuer::self_signed(params, key).unwrap())
    }

    pub(crate) fn der(&self) -> Bytes {
        Bytes::copy_from_slice(self.0.der())
    }

    pub(crate) fn fingerprint(&self) -> Hash {
        Hash::of(&[self.0.der()])
    }

    pub(crate) fn msps(&self) -> Arc<Msps> {
        let none: [&[u8]; 0] = [];
        let mut msps = Msps::new();
        msps.insert(Msp::new("Org1", &[self.0.der()], &none).unwrap()).unwrap();
        Arc::new(msps)
    }

    fn issue(&self, params: &CertificateParams) -> (CertificateDer<'static>, SigningKey) {
        let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
        let pair = KeyPair::from_pem(&key.to_pkcs8_pem()).unwrap();
        (params.signed_by(&pair, &self.0).unwrap().der().clone(), key)
    }

    pub(crate) fn node(&self) -> TlsIdentity {
        self.node_named("node1")
    }

    pub(crate) fn node_named(&self, name: &str) -> TlsIdentity {
        let (own, key) = self.issue(&params(name, "node"));
        TlsIdentity::new(vec![own, self.0.der().clone()], key.into()).unwrap()
    }

    /// The CA's answer to a signing request: a certificate of its public key.
    pub(crate) fn certify(&self, name: &str, request: &[u8]) -> Bytes {
        let request = CertificateSigningRequestDer::from(request.to_vec());
        let request = CertificateSigningRequestParams::from_der(&request).unwrap();
        let own = params(name, "member").signed_by(&request.public_key, &self.0).unwrap();
        Bytes::copy_from_slice(own.der())
    }

    /// A context of Salma at these nodes.
    pub(crate) fn context(&self, nodes: &[&Fake]) -> Context {
        self.context_at(nodes.iter().map(|node| node.address()).collect(), &params("Salma", "member"))
    }

    /// A context of Salma at these addresses.
    pub(crate) fn context_of(&self, nodes: Vec<String>) -> Context {
        self.context_at(nodes, &params("Salma", "member"))
    }

    /// A context whose certificate has expired.
    pub(crate) fn expired(&self, nodes: &[&Fake]) -> Context {
        let mut params = params("Salma", "member");
        params.not_after = date_time_ymd(2021, 1, 1);
        self.context_at(nodes.iter().map(|node| node.address()).collect(), &params)
    }

    /// A context whose certificate has this validity, in years.
    pub(crate) fn valid(&self, nodes: &[&Fake], (from, to): (i32, i32)) -> Context {
        let mut params = params("Salma", "member");
        (params.not_before, params.not_after) = (date_time_ymd(from, 1, 1), date_time_ymd(to, 1, 1));
        self.context_at(nodes.iter().map(|node| node.address()).collect(), &params)
    }

    /// The same for an admin.
    pub(crate) fn expired_admin(&self, nodes: &[&Fake]) -> Context {
        let mut params = params("Amal", "admin");
        params.not_after = date_time_ymd(2021, 1, 1);
        self.context_at(nodes.iter().map(|node| node.address()).collect(), &params)
    }

    pub(crate) fn context_at(&self, nodes: Vec<String>, params: &CertificateParams) -> Context {
        let (own, key) = self.issue(params);
        Context {
            name: "Salma".into(),
            organisation: "Org1".into(),
            network: NETWORK,
            label: "fleet".into(),
            nodes,
            chain: vec![own],
            key: Arc::new(key),
            msps: self.msps(),
            renew: ledger_api::context::RenewalRule::default(),
            memory: ledger_api::context::Memory::default(),
        }
    }

    pub(crate) fn stored(&self) -> Context {
        self.context_at(vec!["127.0.0.1:7450".into()], &params("Salma", "member"))
    }
}
