//! One-time secrets that were made at this machine: what somebody receives so that they can enrol once.
//!
//! Guesses change nothing here: a secret has 128 random bits, and who guesses is slowed down where guesses come in.

use ledger::msp::ENROLMENT_REPEAT_MAX;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::PublicKey;
use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq;

/// Random bytes of a secret: 128 bits, so that guessing is hopeless.
const SECRET_BYTES: usize = 16;
/// Most bytes of what somebody presents as a secret.
pub const PRESENTED_BYTES_MAX: usize = 128;

/// A secret that was handed out. The secret itself is not kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OneTimeSecret {
    /// SHA-256 of the secret's text. Its 128 random bits need no salt and no slow hash.
    sha256: Hash,
    /// When it was made, microseconds since the UNIX epoch.
    pub(super) made: u64,
    /// Until when it can be used, microseconds since the UNIX epoch.
    pub(super) expires: u64,
    /// SHA-256 of the public key that enrolled with it. That key may come again, because an answer can be lost; no
    /// other one can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    used_by: Option<Hash>,
    /// The certificate that the key received, and the time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    received: Option<Received>,
}

/// The state of a secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Received {
    /// SHA-256 of the certificate.
    fingerprint: Hash,
    /// Microseconds since the UNIX epoch.
    time: u64,
}

impl OneTimeSecret {
    /// A new secret, and its text to hand out: 32 hexadecimal digits.
    pub(super) fn generate(made: u64, expires: u64) -> Result<(Self, String), Rejection> {
        let mut random = [0; SECRET_BYTES];
        SystemRandom::new().fill(&mut random).map_err(|_| {
            Rejection::new(Code::Internal, "the system's source of randomness failed, so no secret can be made")
        })?;
        let text = hex::encode(random);
        let sha256 = hash(&text);
        Ok((Self { sha256, made, expires, used_by: None, received: None }, text))
    }

    /// Does this text open it now? Takes as long for every wrong text. Spaces around it and capitals are forgiven.
    pub(super) fn opens(&self, presented: &str, now: u64) -> bool {
        equal(&self.sha256, &hash(presented)) & (now <= self.expires)
    }

    /// Can somebody still enrol with it?
    pub(super) fn is_open(&self, now: u64) -> bool {
        self.used_by.is_none() && now <= self.expires
    }

    /// Was it used?
    pub(super) fn is_used(&self) -> bool {
        self.used_by.is_some()
    }

    /// The certificate that this key received with it, if it comes again soon enough.
    pub(super) fn received_by(&self, key: &PublicKey, now: u64) -> Option<Hash> {
        let received = self.received.as_ref().filter(|_| self.used_by == Some(key_hash(key)))?;
        (now.saturating_sub(received.time) <= ENROLMENT_REPEAT_MAX).then_some(received.fingerprint)
    }

    /// Notes what a key has received: from now on it is good for nothing else.
    pub(super) fn give(&mut self, key: &PublicKey, fingerprint: Hash, time: u64) {
        self.used_by = Some(key_hash(key));
        self.received = Some(Received { fingerprint, time });
    }
}

/// SHA-256 of a secret's text, spaces around it and capitals forgiven.
pub(crate) fn hash(presented: &str) -> Hash {
    Hash::of(&[presented.trim().to_ascii_lowercase().as_bytes()])
}

/// Compares in a time that does not tell where two hashes differ.
pub(crate) fn equal(a: &Hash, b: &Hash) -> bool {
    a.0.as_slice().ct_eq(b.0.as_slice()).into()
}

fn key_hash(key: &PublicKey) -> Hash {
    Hash::of(&[&key.to_spki()])
}
