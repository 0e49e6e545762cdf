//! Keys and signatures: Ed25519 (the default for keys we make), ECDSA P-256 (accepted everywhere) and ECDSA P-384.
//!
//! Every signature has exactly one accepted encoding. For ECDSA that needs two rules that the curve alone does not
//! give: strict DER, and the lower of the two values of `s` that verify (see `key/ecdsa.rs`). For Ed25519 it needs the
//! rules of ZIP 215, so that each node gives the same answer however many signatures it checks at once (see
//! `key/ed25519.rs`).

mod ecdsa;
mod ed25519;
pub(crate) mod info;
mod sec1;

use ledger_base::shared_results::verified;
use ring::hmac;
use ring::rand::{SecureRandom, SystemRandom};
use ring::signature::{
    ECDSA_P256_SHA256_FIXED, ECDSA_P256_SHA256_FIXED_SIGNING, ECDSA_P384_SHA384_FIXED, ECDSA_P384_SHA384_FIXED_SIGNING,
    EcdsaKeyPair, EcdsaSigningAlgorithm, EcdsaVerificationAlgorithm, Ed25519KeyPair, KeyPair, UnparsedPublicKey,
};
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{PrivatePkcs8KeyDer, PrivateSec1KeyDer};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Largest private key file that is read, in bytes.
pub const KEY_BYTES_MAX: usize = 4 * 1024;

/// Everything before the 32 bytes of an Ed25519 key in its SubjectPublicKeyInfo (RFC 8410).
const ED25519_INFO: &[u8] = &[0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00];

/// Everything before the 65 bytes of an uncompressed P-256 point in its SubjectPublicKeyInfo (RFC 5480).
const P256_INFO: &[u8] = &[
    0x30, 0x59, 0x30, 0x13, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x08, 0x2a, 0x86, 0x48, 0xce,
    0x3d, 0x03, 0x01, 0x07, 0x03, 0x42, 0x00,
];

/// Everything before the 97 bytes of an uncompressed P-384 point in its SubjectPublicKeyInfo (RFC 5480).
const P384_INFO: &[u8] = &[
    0x30, 0x76, 0x30, 0x10, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x05, 0x2b, 0x81, 0x04, 0x00,
    0x22, 0x03, 0x62, 0x00,
];

/// Everything before the 32-byte seed of an Ed25519 key in PKCS#8 version 1, the form that every tool reads.
const ED25519_PKCS8: &[u8] =
    &[0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20];

/// The algorithm of a key.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum KeyKind {
    /// Ed25519 (RFC 8032).
    #[default]
    Ed25519,
    /// ECDSA over P-256 with SHA-256.
    P256,
    /// ECDSA over P-384 with SHA-384, as some CAs of other software use it.
    P384,
}

impl fmt::Display for KeyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ed25519 => "ed25519",
            Self::P256 => "p256",
            Self::P384 => "p384",
        })
    }
}

impl FromStr for KeyKind {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        match text {
            "ed25519" => Ok(Self::Ed25519),
            "p256" => Ok(Self::P256),
            "p384" => Ok(Self::P384),
            _ => Err(KeyError::UnknownKind { found: text.chars().take(32).collect() }),
        }
    }
}

/// Why a key cannot be made, read or used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum KeyError {
    /// No such algorithm.
    #[error("found key kind {found:?}, wanted \"ed25519\", \"p256\" or \"p384\"")]
    UnknownKind {
        /// The requested kind, cut to 32 characters.
        found: String,
    },
    /// The text holds no private key in PEM.
    #[error(
        "found no private key ({reason}), wanted a section \"BEGIN PRIVATE KEY\" or \"BEGIN EC PRIVATE KEY\" without a \
         passphrase; try `openssl pkey -in OLD -out NEW`"
    )]
    NoPrivateKey {
        /// The words of the PEM reader.
        reason: String,
    },
    /// The text holds no private key in PKCS#8 PEM.
    #[error(
        "found no PKCS#8 private key ({reason}), wanted a section \"BEGIN PRIVATE KEY\"; \
         try `openssl pkcs8 -topk8 -nocrypt -in OLD -out NEW`"
    )]
    NotPem {
        /// The words of the PEM reader.
        reason: String,
    },
    /// The bytes are not a private key of ours.
    #[error("found a private key that is not usable ({reason}), wanted Ed25519, ECDSA P-256 or P-384 in PKCS#8")]
    Rejected {
        /// The words of the key reader.
        reason: String,
    },
    /// The public key of a certificate is of another kind.
    #[error(
        "found {found}, wanted Ed25519 or an uncompressed point of ECDSA P-256 or P-384; \
         try a new key of kind ed25519 or p256"
    )]
    UnsupportedPublicKey {
        /// The key in words.
        found: String,
    },
    /// An Ed25519 key of small order, which says nothing about who signed.
    #[error(
        "found an Ed25519 public key of small order, under which one signature fits every message, wanted the key of a \
         freshly made pair"
    )]
    WeakPublicKey,
    /// Larger than any private key.
    #[error("found {found} bytes, wanted a private key of at most {KEY_BYTES_MAX} bytes")]
    TooLarge {
        /// Size in bytes.
        found: usize,
    },
    /// The source of randomness failed.
    #[error("the system's source of randomness failed, wanted 32 random bytes for a new key")]
    Random,
}

/// Why a signature is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SignatureError {
    /// An Ed25519 signature has another length.
    #[error("found a signature of {found} bytes, wanted 64 bytes of Ed25519")]
    Length {
        /// Size in bytes.
        found: usize,
    },
    /// An ECDSA signature is not in strict DER.
    #[error("found a signature of {found} bytes that is not strict DER, wanted a SEQUENCE of two positive INTEGERs")]
    Encoding {
        /// Size in bytes.
        found: usize,
    },
    /// The second of the two valid forms of an ECDSA signature, which anybody can make from the first.
    #[error("found an ECDSA signature with high s, wanted s <= n/2; try replacing s with n - s when signing")]
    HighS,
    /// The signature is not of this message by this key.
    #[error("found a signature that does not verify, wanted one of this message by this {0} key")]
    Mismatch(KeyKind),
}

/// A private key that signs transactions, requests and TLS handshakes. Its `Debug` never shows the secret.
pub struct SigningKey {
    /// The key as the algorithm's implementation holds it.
    pair: Pair,
    /// The same key as it is stored: PKCS#8 in DER.
    pkcs8: PrivatePkcs8KeyDer<'static>,
}

enum Pair {
    Ed25519(Ed25519KeyPair),
    /// With the source of the nonce of each signature. ring derives the nonce from key and message too, so a weak
    /// source does not reveal the key.
    P256(EcdsaKeyPair, SystemRandom),
    /// As P-256.
    P384(EcdsaKeyPair, SystemRandom),
}

impl SigningKey {
    /// Makes a new key from the given source of randomness.
    ///
    /// # Errors
    /// [`KeyError::Random`] if the source fails.
    pub fn generate(kind: KeyKind, random: &dyn SecureRandom) -> Result<Self, KeyError> {
        match kind {
            KeyKind::Ed25519 => {
                let mut seed = [0; 32];
                random.fill(&mut seed).map_err(|_| KeyError::Random)?;
                Self::from_seed(&seed)
            }
            KeyKind::P256 => Self::generate_on(&ECDSA_P256_SHA256_FIXED_SIGNING, random),
            KeyKind::P384 => Self::generate_on(&ECDSA_P384_SHA384_FIXED_SIGNING, random),
        }
    }

    fn generate_on(curve: &'static EcdsaSigningAlgorithm, random: &dyn SecureRandom) -> Result<Self, KeyError> {
        let pkcs8 = EcdsaKeyPair::generate_pkcs8(curve, random).map_err(|_| KeyError::Random)?;
        Self::from_pkcs8_der(pkcs8.as_ref())
    }

    /// The Ed25519 key of a seed: whoever has the seed has the key.
    ///
    /// # Errors
    /// [`KeyError::Rejected`], which no seed causes.
    pub fn from_seed(seed: &[u8; 32]) -> Result<Self, KeyError> {
        Self::from_pkcs8_der(&[ED25519_PKCS8, seed].concat())
    }

    /// Reads a key from PKCS#8 in DER.
    ///
    /// # Errors
    /// [`KeyError::Rejected`] with the reason, [`KeyError::TooLarge`].
    pub fn from_pkcs8_der(der: &[u8]) -> Result<Self, KeyError> {
        if der.len() > KEY_BYTES_MAX {
            return Err(KeyError::TooLarge { found: der.len() });
        }
        let pkcs8 = PrivatePkcs8KeyDer::from(der.to_vec());
        let ed25519 = match Ed25519KeyPair::from_pkcs8_maybe_unchecked(der) {
            Ok(pair) => return Ok(Self { pair: Pair::Ed25519(pair), pkcs8 }),
            Err(error) => error.to_string(),
        };
        let random = SystemRandom::new();
        let p256 = match EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, der, &random) {
            Ok(pair) => return Ok(Self { pair: Pair::P256(pair, random), pkcs8 }),
            Err(p256) => p256,
        };
        match EcdsaKeyPair::from_pkcs8(&ECDSA_P384_SHA384_FIXED_SIGNING, der, &random) {
            Ok(pair) => Ok(Self { pair: Pair::P384(pair, random), pkcs8 }),
            Err(p384) => {
                Err(KeyError::Rejected { reason: format!("as ed25519: {ed25519}, as p256: {p256}, as p384: {p384}") })
            }
        }
    }

    /// Reads the private key of a PEM text in either form that other software writes: PKCS#8, or SEC1 with the curve P-256 or
    /// P-384.
    ///
    /// # Errors
    /// [`KeyError::NoPrivateKey`], [`KeyError::TooLarge`], and what [`SigningKey::from_pkcs8_der`] says.
    pub fn from_pem(pem: &str) -> Result<Self, KeyError> {
        let reason = match Self::from_pkcs8_pem(pem) {
            Err(KeyError::NotPem { reason }) => reason,
            read => return read,
        };
        let sec1 = PrivateSec1KeyDer::from_pem_slice(pem.as_bytes()).map_err(|_| KeyError::NoPrivateKey { reason })?;
        let forms = sec1::as_pkcs8(sec1.secret_sec1_der());
        let mut refused = KeyError::Rejected { reason: "it is too long for SEC1".into() };
        for pkcs8 in forms {
            match Self::from_pkcs8_der(&pkcs8) {
                Err(error) => refused = error,
                read => return read,
            }
        }
        Err(refused)
    }

    /// Reads the first PKCS#8 private key of a PEM text.
    ///
    /// # Errors
    /// [`KeyError::NotPem`], [`KeyError::TooLarge`], and what [`SigningKey::from_pkcs8_der`] says.
    pub fn from_pkcs8_pem(pem: &str) -> Result<Self, KeyError> {
        if pem.len() > KEY_BYTES_MAX {
            return Err(KeyError::TooLarge { found: pem.len() });
        }
        let key = PrivatePkcs8KeyDer::from_pem_slice(pem.as_bytes())
            .map_err(|error| KeyError::NotPem { reason: error.to_string() })?;
        Self::from_pkcs8_der(key.secret_pkcs8_der())
    }

    /// The secret as PKCS#8 in DER. Keep it secret.
    pub fn to_pkcs8_der(&self) -> &[u8] {
        self.pkcs8.secret_pkcs8_der()
    }

    /// The secret as PKCS#8 in PEM. Keep it secret: mode 0600 at most.
    pub fn to_pkcs8_pem(&self) -> String {
        let section = pem::Pem::new("PRIVATE KEY", self.to_pkcs8_der());
        pem::encode_config(&section, pem::EncodeConfig::new().set_line_ending(pem::LineEnding::LF))
    }

    /// A secret for one purpose that follows from this key: the same after every start, and of no use for another purpose
    /// (HMAC with SHA-256, RFC 2104). Keep it secret.
    pub fn secret_for(&self, purpose: &[u8]) -> [u8; 32] {
        let key = hmac::Key::new(hmac::HMAC_SHA256, self.to_pkcs8_der());
        let (mut secret, tag) = ([0; 32], hmac::sign(&key, purpose));
        secret.copy_from_slice(tag.as_ref());
        secret
    }

    /// The algorithm.
    pub fn kind(&self) -> KeyKind {
        match self.pair {
            Pair::Ed25519(_) => KeyKind::Ed25519,
            Pair::P256(..) => KeyKind::P256,
            Pair::P384(..) => KeyKind::P384,
        }
    }

    /// The public half.
    pub fn public_key(&self) -> PublicKey {
        match &self.pair {
            Pair::Ed25519(pair) => PublicKey::new(KeyKind::Ed25519, pair.public_key().as_ref()),
            Pair::P256(pair, _) => PublicKey::new(KeyKind::P256, pair.public_key().as_ref()),
            Pair::P384(pair, _) => PublicKey::new(KeyKind::P384, pair.public_key().as_ref()),
        }
    }

    /// Signs a message: 64 bytes for Ed25519, strict DER with low s for ECDSA.
    ///
    /// Should the system's source of randomness fail (ECDSA only), the signature is empty, which every verifier
    /// refuses: the signer learns of it at once and nothing weak is ever signed.
    pub fn sign(&self, message: &[u8]) -> Vec<u8> {
        match &self.pair {
            Pair::Ed25519(pair) => {
                let signature = pair.sign(message);
                // The nodes of a simulated cluster, which this key belongs to, need not compute it.
                verified(&[pair.public_key().as_ref(), message, signature.as_ref()], || true);
                signature.as_ref().to_vec()
            }
            Pair::P256(pair, random) => match pair.sign(random, message) {
                Ok(signature) => ecdsa::P256.encode(signature.as_ref()).unwrap_or_default(),
                Err(ring::error::Unspecified) => Vec::new(),
            },
            Pair::P384(pair, random) => match pair.sign(random, message) {
                Ok(signature) => ecdsa::P384.encode(signature.as_ref()).unwrap_or_default(),
                Err(ring::error::Unspecified) => Vec::new(),
            },
        }
    }
}

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SigningKey").field("public_key", &self.public_key()).finish_non_exhaustive()
    }
}

/// The public key of an identity.
#[derive(Clone, PartialEq, Eq)]
pub struct PublicKey {
    /// The algorithm.
    kind: KeyKind,
    /// 32 bytes of Ed25519, or the uncompressed point of P-256 (65 bytes) or P-384 (97 bytes).
    bytes: Vec<u8>,
    /// The point behind the bytes of an Ed25519 key.
    point: Option<ed25519::Point>,
}

impl PublicKey {
    fn new(kind: KeyKind, bytes: &[u8]) -> Self {
        let of_ed25519 = (kind == KeyKind::Ed25519).then(|| bytes.try_into().ok()).flatten();
        Self { kind, bytes: bytes.to_vec(), point: of_ed25519.and_then(ed25519::point) }
    }

    /// Reads a SubjectPublicKeyInfo in DER, as certificates and signing requests hold it.
    ///
    /// # Errors
    /// [`KeyError::UnsupportedPublicKey`] for other algorithms, bytes that stand for no point, compressed points and
    /// superfluous bytes; [`KeyError::WeakPublicKey`].
    pub fn from_spki(der: &[u8]) -> Result<Self, KeyError> {
        let unsupported = || KeyError::UnsupportedPublicKey { found: info::key_text(der) };
        let (kind, bytes) = if let Some(bytes) = der.strip_prefix(ED25519_INFO) {
            (KeyKind::Ed25519, bytes)
        } else if let Some(bytes) = der.strip_prefix(P256_INFO) {
            (KeyKind::P256, bytes)
        } else if let Some(bytes) = der.strip_prefix(P384_INFO) {
            (KeyKind::P384, bytes)
        } else {
            return Err(unsupported());
        };
        let key = Self::new(kind, bytes);
        match (&key.point, bytes) {
            (Some(point), _) if ed25519::is_weak(point) => Err(KeyError::WeakPublicKey),
            (Some(_), _) => Ok(key),
            (None, [0x04, ..]) if kind == KeyKind::P256 && bytes.len() == 65 => Ok(key),
            (None, [0x04, ..]) if kind == KeyKind::P384 && bytes.len() == 97 => Ok(key),
            (None, _) => Err(unsupported()),
        }
    }

    /// An Ed25519 key from its 32 bytes.
    pub fn from_ed25519(bytes: [u8; 32]) -> Self {
        Self::new(KeyKind::Ed25519, &bytes)
    }

    /// The bytes of the key: 32 of Ed25519, 65 of an uncompressed P-256 point, 97 of one of P-384.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The SubjectPublicKeyInfo in DER.
    pub fn to_spki(&self) -> Vec<u8> {
        let info = match self.kind {
            KeyKind::Ed25519 => ED25519_INFO,
            KeyKind::P256 => P256_INFO,
            KeyKind::P384 => P384_INFO,
        };
        [info, &self.bytes].concat()
    }

    /// The algorithm.
    pub fn kind(&self) -> KeyKind {
        self.kind
    }

    /// Checks that `signature` is the signature of `message` by this key, in its one accepted encoding.
    ///
    /// # Errors
    /// [`SignatureError`]: wrong form, high s, or simply not a signature of this message.
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> Result<(), SignatureError> {
        let found = signature.len();
        let verified = match self.kind {
            KeyKind::Ed25519 => {
                let signature: [u8; 64] = signature.try_into().map_err(|_| SignatureError::Length { found })?;
                verified(&[&self.bytes, message, &signature], || {
                    self.point.as_ref().is_some_and(|point| ed25519::verify(point, message, signature))
                })
            }
            KeyKind::P256 => {
                self.verify_ecdsa(&ECDSA_P256_SHA256_FIXED, message, &low(ecdsa::P256.decode(signature), found)?)
            }
            KeyKind::P384 => {
                self.verify_ecdsa(&ECDSA_P384_SHA384_FIXED, message, &low(ecdsa::P384.decode(signature), found)?)
            }
        };
        if verified { Ok(()) } else { Err(SignatureError::Mismatch(self.kind)) }
    }

    /// Do all these signatures verify, each of its message by its key? Much cheaper than one after the other, with the
    /// same answer. Only those of Ed25519 can be checked so: with another key among them the answer is no, as with a
    /// signature that does not verify. Each has to be checked by itself then.
    pub fn verify_together<'a>(signed: impl IntoIterator<Item = (&'a Self, &'a [u8], &'a [u8])>) -> bool {
        let of_ed25519 = |(key, message, signature): (&'a Self, &'a [u8], &'a [u8])| {
            Some((key.point.as_ref()?, message, signature.try_into().ok()?))
        };
        let signed: Option<Vec<_>> = signed.into_iter().map(of_ed25519).collect();
        signed.is_some_and(|signed| ed25519::verify_together(signed.into_iter()))
    }

    fn verify_ecdsa(&self, algorithm: &'static EcdsaVerificationAlgorithm, message: &[u8], r_and_s: &[u8]) -> bool {
        let key = UnparsedPublicKey::new(algorithm, &self.bytes);
        verified(&[&self.bytes, message, r_and_s], || key.verify(message, r_and_s).is_ok())
    }
}

/// r and s of a signature in its one accepted encoding.
fn low(decoded: Option<(Vec<u8>, bool)>, found: usize) -> Result<Vec<u8>, SignatureError> {
    match decoded {
        Some((r_and_s, true)) => Ok(r_and_s),
        Some((_, false)) => Err(SignatureError::HighS),
        None => Err(SignatureError::Encoding { found }),
    }
}

impl fmt::Debug for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PublicKey({} {})", self.kind, hex::encode(&self.bytes))
    }
}
