//! Asking a node for a certificate: the request, and how many nodes are asked for how long.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{KeyKind, SigningKey};
use rcgen::{
    CertificateParams, DistinguishedName, DnType, KeyPair, PKCS_ECDSA_P256_SHA256, PKCS_ECDSA_P384_SHA384, PKCS_ED25519,
};
use rustls_pki_types::PrivatePkcs8KeyDer;
use std::time::Duration;

/// Most nodes to which an enrolment is taken, one after another, until one carries the CA.
pub(crate) const DOORS_MAX: usize = 8;
/// How long connecting may take.
pub(crate) const CONNECT_MAX: Duration = Duration::from_secs(3);

/// A certificate signing request (PKCS #10) in DER.
pub(crate) fn request(name: &str, key: &SigningKey) -> Result<Bytes, Rejection> {
    let fault =
        |error: rcgen::Error| Rejection::new(Code::Internal, format!("cannot create a signing request: {error}"));
    let algorithm = match key.kind() {
        KeyKind::Ed25519 => &PKCS_ED25519,
        KeyKind::P256 => &PKCS_ECDSA_P256_SHA256,
        KeyKind::P384 => &PKCS_ECDSA_P384_SHA384,
    };
    let pair = KeyPair::from_pkcs8_der_and_sign_algo(&PrivatePkcs8KeyDer::from(key.to_pkcs8_der()), algorithm);
    let mut parameters = CertificateParams::default();
    parameters.distinguished_name = DistinguishedName::new();
    parameters.distinguished_name.push(DnType::CommonName, name);
    let request = parameters.serialize_request(&pair.map_err(fault)?).map_err(fault)?;
    Ok(Bytes::copy_from_slice(request.der()))
}
