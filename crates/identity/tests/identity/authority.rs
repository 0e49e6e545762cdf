//! A certification authority that issues whatever a test asks for, also what no honest one would.

use ledger_identity::certificate::{ATTRIBUTES_OID, encode_attributes};
use ledger_identity::msp::{Msp, Msps};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, CustomExtension, DnType, IsCa, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};
use rustls_pki_types::CertificateDer;
use std::collections::BTreeMap;

/// 2030-01-01, in microseconds since the UNIX epoch: every certificate here is valid from 2029 to 2031.
pub(crate) const NOW: u64 = 1_893_456_000_000_000;
/// A year and some days.
pub(crate) const YEAR: u64 = 370 * 24 * 3600 * 1_000_000;

pub(crate) const NONE: &[CertificateDer<'_>] = &[];

pub(crate) struct Ca(pub(crate) CertifiedIssuer<'static, KeyPair>);

pub(crate) fn ca_params(name: &str) -> CertificateParams {
    let mut params = params(name, None);
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

pub(crate) fn params(name: &str, unit: Option<&str>) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    if let Some(unit) = unit {
        params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    }
    params.not_before = date_time_ymd(2029, 1, 1);
    params.not_after = date_time_ymd(2031, 1, 1);
    params
}

pub(crate) fn with_attributes(mut params: CertificateParams, json: &[u8]) -> CertificateParams {
    params.custom_extensions.push(CustomExtension::from_oid_content(ATTRIBUTES_OID, json.to_vec()));
    params
}

pub(crate) fn attributes(pairs: &[(&str, &str)]) -> Vec<u8> {
    let map: BTreeMap<_, _> = pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    encode_attributes(&map).unwrap()
}

impl Ca {
    pub(crate) fn new(name: &str) -> Self {
        Self::from_params(ca_params(name))
    }

    pub(crate) fn from_params(params: CertificateParams) -> Self {
        Self(CertifiedIssuer::self_signed(params, KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap()).unwrap())
    }

    pub(crate) fn with_algorithm(name: &str, algorithm: &'static rcgen::SignatureAlgorithm) -> Self {
        Self(CertifiedIssuer::self_signed(ca_params(name), KeyPair::generate_for(algorithm).unwrap()).unwrap())
    }

    pub(crate) fn below(&self, params: CertificateParams) -> Self {
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256).unwrap();
        Self(CertifiedIssuer::signed_by(params, key, &self.0).unwrap())
    }

    pub(crate) fn der(&self) -> CertificateDer<'static> {
        self.0.der().clone()
    }

    pub(crate) fn issue(&self, params: &CertificateParams) -> CertificateDer<'static> {
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        params.signed_by(&key, &self.0).unwrap().der().clone()
    }

    pub(crate) fn user(&self, name: &str) -> CertificateDer<'static> {
        self.issue(&params(name, Some("member")))
    }

    pub(crate) fn msp(&self, organisation: &str) -> Msp {
        Msp::new(organisation, &[self.der()], NONE).unwrap()
    }
}

pub(crate) fn network(msps: impl IntoIterator<Item = Msp>) -> Msps {
    let mut network = Msps::new();
    for msp in msps {
        network.insert(msp).unwrap();
    }
    network
}
