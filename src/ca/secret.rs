//! One-time secrets: what an admin hands to somebody, so that they can enrol once.

use ledger::key::PublicKey;
use ledger::{Code, Hash, Rejection};
use ring::rand::{SecureRandom, SystemRandom};
use serde::{Deserialize, Serialize};

/// Random bytes of a secret: 128 bits, so that guessing is hopeless even before tries are counted.
const SECRET_BYTES: usize = 16;
/// Most bytes of what somebody presents as a secret.
pub const PRESENTED_BYTES_MAX: usize = 128;
/// Wrong tries after which a secret is void.
pub const WRONG_TRIES_MAX: u8 = 10;

/// A secret that was handed out and not used yet. The secret itself is not kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OneTimeSecret {
    /// SHA-256 of the secret's text. Its 128 random bits need no salt and no slow hash.
    sha256: Hash,
    /// Until when it can be used, microseconds since the UNIX epoch.
    expires: u64,
    /// Wrong tries so far.
    wrong: u8,
    /// SHA-256 of the public key that enrolled with it. That key may come again, because an answer can be lost; no
    /// other one can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    used_by: Option<Hash>,
}

impl OneTimeSecret {
    /// A new secret, and its text to hand out: 32 hexadecimal digits.
    pub(super) fn generate(expires: u64) -> Result<(Self, String), Rejection> {
        let mut random = [0; SECRET_BYTES];
        SystemRandom::new().fill(&mut random).map_err(|_| {
            Rejection::new(Code::Internal, "the system's source of randomness failed, so no secret can be made")
        })?;
        let text = hex::encode(random);
        Ok((Self { sha256: Hash::of(&[text.as_bytes()]), expires, wrong: 0, used_by: None }, text))
    }

    /// Does this text open it now? Takes as long for every wrong text. Spaces around it and capitals are forgiven.
    pub(super) fn opens(&self, presented: &str, now: u64) -> bool {
        let presented = Hash::of(&[presented.trim().to_ascii_lowercase().as_bytes()]);
        let difference = self.sha256.0.iter().zip(presented.0).fold(0, |sum, (a, b)| sum | (a ^ b));
        (difference == 0) & self.is_usable(now)
    }

    /// Neither expired nor void.
    pub(super) fn is_usable(&self, now: u64) -> bool {
        now <= self.expires && self.wrong < WRONG_TRIES_MAX
    }

    /// Gives it to the first key that comes with it. False if it belongs to another one already. That the same key
    /// comes again counts as a wrong try, so that it does not come without end.
    pub(super) fn bind(&mut self, key: &PublicKey) -> bool {
        let key = Hash::of(&[&key.to_spki()]);
        if self.used_by.is_some() {
            self.count_wrong();
        }
        *self.used_by.get_or_insert(key) == key
    }

    /// Counts a wrong try.
    pub(super) fn count_wrong(&mut self) {
        self.wrong = self.wrong.saturating_add(1);
    }
}
