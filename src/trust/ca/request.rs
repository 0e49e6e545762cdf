//! Certificate signing requests (PKCS #10). Of a request only the public key is used.

use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{PublicKey, SigningKey};
use rcgen::{
    CertificateParams, DistinguishedName, DnType, KeyPair, PKCS_ECDSA_P256_SHA256, PKCS_ECDSA_P384_SHA384, PKCS_ED25519,
};
use rustls_pki_types::PrivatePkcs8KeyDer;
use x509_parser::certification_request::X509CertificationRequest;
use x509_parser::prelude::FromDer;

/// Largest request that is read, in bytes of DER.
pub const REQUEST_BYTES_MAX: usize = 8 * 1024;

/// The public key of a request whose sender has shown to hold the private one.
pub(crate) fn public_key(der: &[u8]) -> Result<PublicKey, Rejection> {
    let refused = |found: String| {
        Rejection::new(Code::BadArgument, "the certificate signing request is not usable")
            .found(found)
            .wanted("a PKCS #10 request in DER, signed by the key in it, of kind ed25519, p256 or p384")
            .next("generate a new key and request, for example with `ledgerctl enroll`")
    };
    if der.len() > REQUEST_BYTES_MAX {
        return Err(refused(format!("{} bytes, more than {REQUEST_BYTES_MAX}", der.len())));
    }
    let (rest, request) = X509CertificationRequest::from_der(der).map_err(|error| refused(error.to_string()))?;
    if !rest.is_empty() {
        return Err(refused(format!("{} bytes after the request", rest.len())));
    }
    let key = PublicKey::from_spki(request.certification_request_info.subject_pki.raw)
        .map_err(|error| refused(error.to_string()))?;
    request.verify_signature().map_err(|error| refused(error.to_string()))?;
    Ok(key)
}

/// A request for a key that was just made here.
pub(crate) fn make(key: &SigningKey, name: &str) -> Result<Vec<u8>, Rejection> {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    let request = signer(key).and_then(|signer| params.serialize_request(&signer));
    let request = request.map_err(|error| failed("a signing request", &error))?;
    Ok(request.der().to_vec())
}

/// The key, as rcgen wants it.
pub(super) fn signer(key: &SigningKey) -> Result<KeyPair, rcgen::Error> {
    let algorithm = match key.kind() {
        ledger_identity::key::KeyKind::Ed25519 => &PKCS_ED25519,
        ledger_identity::key::KeyKind::P256 => &PKCS_ECDSA_P256_SHA256,
        ledger_identity::key::KeyKind::P384 => &PKCS_ECDSA_P384_SHA384,
    };
    KeyPair::from_pkcs8_der_and_sign_algo(&PrivatePkcs8KeyDer::from(key.to_pkcs8_der()), algorithm)
}

/// Something that rcgen could not make.
pub(super) fn failed(what: &str, error: &rcgen::Error) -> Rejection {
    Rejection::new(Code::Internal, format!("{what} cannot be created: {error}"))
}
