//! Challenges: what a browser's key signs to open a session.
//!
//! The node remembers none that it gives. It knows one again by its code, so nobody can fill a table with challenges. Those that
//! opened a session are remembered until they end: each opens one.

use ring::hmac;
use ring::rand::{SecureRandom, SystemRandom};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Microseconds for which a challenge is good.
const LIFE: u64 = 60_000_000;
/// Bytes of randomness.
const NONCE_BYTES: usize = 16;
/// Bytes of the end, microseconds since the UNIX epoch.
const END_BYTES: usize = 8;

/// Makes challenges, and knows them again.
pub(super) struct Challenges {
    key: hmac::Key,
    /// Those that opened a session, and when they end.
    used: Mutex<HashMap<[u8; NONCE_BYTES], u64>>,
}

impl Challenges {
    /// With a key that no other process knows; none without randomness.
    pub(super) fn new() -> Option<Self> {
        let key = hmac::Key::generate(hmac::HMAC_SHA256, &SystemRandom::new()).ok()?;
        Some(Self { key, used: Mutex::default() })
    }

    /// A new one: randomness, its end, and the code over both.
    pub(super) fn make(&self, now: u64) -> Option<Vec<u8>> {
        let mut nonce = [0; NONCE_BYTES];
        SystemRandom::new().fill(&mut nonce).ok()?;
        let mut made = [&nonce[..], &now.saturating_add(LIFE).to_be_bytes()].concat();
        let code = hmac::sign(&self.key, &made);
        made.extend_from_slice(code.as_ref());
        Some(made)
    }

    /// Is it one of this process that is still good?
    pub(super) fn is_good(&self, challenge: &[u8], now: u64) -> bool {
        self.read(challenge, now).is_some()
    }

    /// Uses it up: false if it was used before, or is none.
    pub(super) fn spend(&self, challenge: &[u8], now: u64) -> bool {
        let Some((nonce, end)) = self.read(challenge, now) else { return false };
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        used.retain(|_, end| *end >= now);
        used.insert(nonce, end).is_none()
    }

    fn read(&self, challenge: &[u8], now: u64) -> Option<([u8; NONCE_BYTES], u64)> {
        let (told, code) = challenge.split_at_checked(NONCE_BYTES + END_BYTES)?;
        hmac::verify(&self.key, told, code).ok()?;
        let (nonce, end) = told.split_first_chunk::<NONCE_BYTES>()?;
        let end = u64::from_be_bytes(*end.first_chunk::<END_BYTES>()?);
        (now <= end && end <= now.saturating_add(LIFE)).then_some((*nonce, end))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const NOW: u64 = 1_800_000_000_000_000;

    #[test]
    fn a_challenge_is_good_once_for_a_minute_and_at_the_node_that_made_it() {
        let challenges = Challenges::new().unwrap();
        let made = challenges.make(NOW).unwrap();
        assert!(challenges.is_good(&made, NOW) && challenges.is_good(&made, NOW + LIFE));
        assert!(!challenges.is_good(&made, NOW + LIFE + 1) && !challenges.is_good(&made, NOW - 1));
        assert!(!Challenges::new().unwrap().is_good(&made, NOW));
        assert!(challenges.spend(&made, NOW) && !challenges.spend(&made, NOW));
        assert!(!challenges.spend(&challenges.make(NOW).unwrap(), NOW + LIFE + 1));
        assert_eq!(challenges.used.lock().unwrap().len(), 1);
        assert!(challenges.spend(&challenges.make(NOW + 2 * LIFE).unwrap(), NOW + 2 * LIFE));
        assert_eq!(challenges.used.lock().unwrap().len(), 1, "the first one is forgotten");
    }

    #[test]
    fn a_challenge_with_any_other_bit_is_none() {
        let challenges = Challenges::new().unwrap();
        let made = challenges.make(NOW).unwrap();
        for at in 0..made.len() {
            let mut other = made.clone();
            *other.get_mut(at).unwrap() ^= 1;
            assert!(!challenges.is_good(&other, NOW), "byte {at}");
            assert!(!challenges.is_good(made.get(..at).unwrap(), NOW), "{at} bytes");
        }
    }
}
