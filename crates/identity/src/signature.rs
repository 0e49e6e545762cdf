//! Signatures of authorities: the algorithms that are verified, and the words for those that are not.
//!
//! Authorities sign with more algorithms than people do here: RSA, and either curve with the hash of the other. A key that
//! none of them fits is found before an organisation comes in, not when its people sign in.

use crate::der::{Element, SEQUENCE};
use crate::key::PublicKey;
use crate::key::info::{key_parts, key_text, named, rsa_bits};
use ledger_base::shared_results::verified;
use rustls_pki_types::{AlgorithmIdentifier, SignatureVerificationAlgorithm};
use webpki::ring::{
    ECDSA_P256_SHA256, ECDSA_P256_SHA384, ECDSA_P384_SHA256, ECDSA_P384_SHA384, ED25519, RSA_PKCS1_2048_8192_SHA256,
    RSA_PKCS1_2048_8192_SHA256_ABSENT_PARAMS, RSA_PKCS1_2048_8192_SHA384, RSA_PKCS1_2048_8192_SHA384_ABSENT_PARAMS,
    RSA_PKCS1_2048_8192_SHA512, RSA_PKCS1_2048_8192_SHA512_ABSENT_PARAMS, RSA_PSS_2048_8192_SHA256_LEGACY_KEY,
    RSA_PSS_2048_8192_SHA384_LEGACY_KEY, RSA_PSS_2048_8192_SHA512_LEGACY_KEY,
};

/// The algorithms that are verified, in words.
pub(crate) const WANTED: &str = "Ed25519, ECDSA on P-256 or P-384 with SHA-256 or SHA-384, or RSA of 2048 to 8192 bits with SHA-256, SHA-384 or SHA-512";

/// The keys that verify, in words.
pub(crate) const WANTED_KEY: &str =
    "a key of Ed25519, of ECDSA on P-256 or P-384 as an uncompressed point, or of RSA with 2048 to 8192 bits";

const ALGORITHMS: &[&dyn SignatureVerificationAlgorithm] = &[
    ED25519,
    ECDSA_P256_SHA256,
    ECDSA_P256_SHA384,
    ECDSA_P384_SHA256,
    ECDSA_P384_SHA384,
    RSA_PKCS1_2048_8192_SHA256,
    RSA_PKCS1_2048_8192_SHA384,
    RSA_PKCS1_2048_8192_SHA512,
    RSA_PKCS1_2048_8192_SHA256_ABSENT_PARAMS,
    RSA_PKCS1_2048_8192_SHA384_ABSENT_PARAMS,
    RSA_PKCS1_2048_8192_SHA512_ABSENT_PARAMS,
    RSA_PSS_2048_8192_SHA256_LEGACY_KEY,
    RSA_PSS_2048_8192_SHA384_LEGACY_KEY,
    RSA_PSS_2048_8192_SHA512_LEGACY_KEY,
];

const RSA_BITS_MIN: usize = 2048;
const RSA_BITS_MAX: usize = 8192;

/// Contents of object identifiers of signatures, and their names.
const SIGNATURES: [(&[u8], &str); 13] = [
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x01], "ECDSA with SHA-1"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x01], "ECDSA with SHA-224"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02], "ECDSA with SHA-256"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x03], "ECDSA with SHA-384"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x04], "ECDSA with SHA-512"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x04], "RSA with MD5"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x05], "RSA with SHA-1"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x0a], "RSA-PSS"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x0b], "RSA with SHA-256"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x0c], "RSA with SHA-384"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x0d], "RSA with SHA-512"),
    (&[0x2b, 0x65, 0x70], "Ed25519"),
    (&[0x2b, 0x65, 0x71], "Ed448"),
];

/// Something that an authority has signed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Signed {
    /// The bytes that are signed.
    pub(crate) bytes: Vec<u8>,
    /// The algorithm: content of its AlgorithmIdentifier.
    pub(crate) algorithm: Vec<u8>,
    pub(crate) signature: Vec<u8>,
}

/// Why a signature does not count.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// Nobody here verifies it: the algorithm and the key, in words.
    Unsupported(String),
    /// It is not one of this key.
    Mismatch,
}

impl Signed {
    /// Takes a certificate or a list apart: the signed part, and what it says about its signature. None if it has another form,
    /// or says different algorithms inside and outside.
    pub(crate) fn of(der: &[u8]) -> Option<Self> {
        let parts = Element::inside(der, SEQUENCE)?;
        let [signed, algorithm, signature] = parts.as_slice() else { return None };
        // The algorithm stands inside as well, in front of the issuer: the second or third element.
        let inside = Element::all(signed.content)?;
        let [0x03, ..] = signature.whole else { return None };
        let [0, signature @ ..] = signature.content else { return None };
        if algorithm.tag != SEQUENCE || !inside.iter().take(3).any(|element| element.whole == algorithm.whole) {
            return None;
        }
        Some(Self {
            bytes: signed.whole.to_vec(),
            algorithm: algorithm.content.to_vec(),
            signature: signature.to_vec(),
        })
    }

    /// Checks it with a public key (SubjectPublicKeyInfo in DER).
    pub(crate) fn verify(&self, key: &[u8]) -> Result<(), Fault> {
        let unsupported = || Fault::Unsupported(format!("{} by {}", self.algorithm_text(), key_text(key)));
        let (kind, bytes) = key_parts(key).ok_or_else(unsupported)?;
        let is = |found: AlgorithmIdentifier, wanted: &[u8]| found.as_ref() == wanted;
        let fits = |known: &&&dyn SignatureVerificationAlgorithm| {
            is(known.public_key_alg_id(), kind) && is(known.signature_alg_id(), &self.algorithm)
        };
        check_key(key).map_err(|_| unsupported())?;
        let Some(algorithm) = ALGORITHMS.iter().find(fits) else {
            // One that is verified with another kind of key was made by another key.
            let of_others = ALGORITHMS.iter().any(|known| is(known.signature_alg_id(), &self.algorithm));
            return Err(if of_others { Fault::Mismatch } else { unsupported() });
        };
        let made = verified(&[b"of an authority", key, &self.algorithm, &self.bytes, &self.signature], || {
            algorithm.verify_signature(bytes, &self.bytes, &self.signature).is_ok()
        });
        if made { Ok(()) } else { Err(Fault::Mismatch) }
    }

    /// The algorithm in words.
    pub(crate) fn algorithm_text(&self) -> String {
        let identifier = Element::first(&self.algorithm).map_or(&[][..], |(identifier, _)| identifier.content);
        named(&SIGNATURES, identifier)
    }
}

/// Checks that some algorithm verifies with this key (SubjectPublicKeyInfo in DER); answers with the key in words if not.
pub(crate) fn check_key(key: &[u8]) -> Result<(), String> {
    let is_usable = match rsa_bits(key) {
        Some(bits) => (RSA_BITS_MIN..=RSA_BITS_MAX).contains(&bits),
        None => PublicKey::from_spki(key).is_ok(),
    };
    if is_usable { Ok(()) } else { Err(key_text(key)) }
}
