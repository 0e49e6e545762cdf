//! The key in which a publisher encrypts, and the envelope of a message.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Envelope, NONCE_BYTES};
use ring::aead::{Aad, CHACHA20_POLY1305, LessSafeKey, Nonce, UnboundKey};
use ring::rand::{SecureRandom, SystemRandom};
use std::fmt;

/// Length of a content key, in bytes.
pub(crate) const CONTENT_KEY_BYTES: usize = 32;
/// Separates these ciphertexts from all others.
const DOMAIN: &[u8] = b"ledgerd confidential message v1\0";

/// A content key. Each is made for one publisher of one service and the readers of a moment.
#[derive(Clone)]
pub struct ContentKey {
    bytes: [u8; CONTENT_KEY_BYTES],
    key: LessSafeKey,
}

impl fmt::Debug for ContentKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ContentKey")
    }
}

/// The place of a message: a ciphertext that is brought to another one cannot be opened.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// The network.
    pub network: &'a Hash,
    /// The service's full id.
    pub service: &'a str,
    /// The publisher, e.g. `Org1/Salma`.
    pub publisher: &'a str,
    /// The epoch of its grant; 0 without one.
    pub epoch: u64,
    /// Its own sequence number, not that of the first message of its transaction.
    pub sequence: u64,
}

impl Place<'_> {
    fn associated(&self, key: u64) -> Vec<u8> {
        let mut data = DOMAIN.to_vec();
        data.extend_from_slice(&self.network.0);
        crate::parts(&mut data, &[self.service.as_bytes(), self.publisher.as_bytes()]);
        for number in [self.epoch, self.sequence, key] {
            data.extend_from_slice(&number.to_be_bytes());
        }
        data
    }
}

impl ContentKey {
    /// A new key.
    ///
    /// # Errors
    /// [`Code::Internal`] if the operating system gives no random bytes.
    pub fn generate() -> Result<Self, Rejection> {
        Self::of(random()?)
    }

    /// The key of these bytes.
    ///
    /// # Errors
    /// [`Code::Internal`]: never for a key of this length.
    pub(crate) fn of(bytes: [u8; CONTENT_KEY_BYTES]) -> Result<Self, Rejection> {
        let key = UnboundKey::new(&CHACHA20_POLY1305, &bytes).map_err(|_| internal("a content key"))?;
        Ok(Self { bytes, key: LessSafeKey::new(key) })
    }

    pub(crate) fn bytes(&self) -> &[u8; CONTENT_KEY_BYTES] {
        &self.bytes
    }

    /// The envelope of a message. `key` is the height at which this key was shared.
    ///
    /// # Errors
    /// [`Code::Internal`] if the operating system gives no random bytes.
    pub fn seal(&self, place: &Place<'_>, key: u64, message: &[u8]) -> Result<Bytes, Rejection> {
        self.seal_with(random()?, place, key, message)
    }

    pub(crate) fn seal_with(
        &self,
        nonce: [u8; NONCE_BYTES],
        place: &Place<'_>,
        key: u64,
        message: &[u8],
    ) -> Result<Bytes, Rejection> {
        let (mut envelope, mut sealed) = (Envelope::head(key, &nonce), message.to_vec());
        let (nonce, associated) = (Nonce::assume_unique_for_key(nonce), Aad::from(place.associated(key)));
        self.key
            .seal_in_place_append_tag(nonce, associated, &mut sealed)
            .map_err(|_| internal("an envelope of a message of this size"))?;
        envelope.extend_from_slice(&sealed);
        Ok(envelope.into())
    }

    /// The message of an envelope; none if it was not sealed with this key for this place.
    pub fn open(&self, place: &Place<'_>, envelope: &Envelope<'_>) -> Option<Bytes> {
        let (nonce, associated) =
            (Nonce::assume_unique_for_key(envelope.nonce), Aad::from(place.associated(envelope.key)));
        let mut message = envelope.sealed.to_vec();
        let length = self.key.open_in_place(nonce, associated, &mut message).ok()?.len();
        message.truncate(length);
        Some(message.into())
    }
}

fn random<const N: usize>() -> Result<[u8; N], Rejection> {
    let mut bytes = [0; N];
    SystemRandom::new().fill(&mut bytes).map_err(|_| internal("random bytes"))?;
    Ok(bytes)
}

fn internal(what: &str) -> Rejection {
    Rejection::new(Code::Internal, format!("{what} cannot be made")).next("look into the logs of the operating system")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const NETWORK: Hash = Hash([7; 32]);

    fn place() -> Place<'static> {
        let (service, publisher) = ("Turtlebot4/cmd_vel", "Org1/Salma");
        Place { network: &NETWORK, service, publisher, epoch: 3, sequence: 1000 }
    }

    /// The test vector of docs/format.md.
    #[test]
    fn the_bytes_of_an_envelope_never_change() {
        let key = ContentKey::of([1; 32]).unwrap();
        let sealed = key.seal_with([2; NONCE_BYTES], &place(), 42, b"\0\x01\0\0hello").unwrap();
        assert_eq!(hex::encode(&sealed), VECTOR);
        assert_eq!(key.open(&place(), &Envelope::parse(&sealed).unwrap()).unwrap(), &b"\0\x01\0\0hello"[..]);
    }

    const VECTOR: &str =
        "e501000000000000002a020202020202020202020202e61df22ee5c684b61e5544578957c17f0b1666373bd5db44fc";

    #[test]
    fn a_ciphertext_opens_at_its_own_place_alone_and_only_whole() {
        let key = ContentKey::generate().unwrap();
        let sealed = key.seal(&place(), 42, b"secret").unwrap();
        assert!(!sealed.windows(6).any(|part| part == b"secret"));
        let open = |place: &Place<'_>, bytes: &[u8]| Envelope::parse(bytes).and_then(|sealed| key.open(place, &sealed));
        assert_eq!(open(&place(), &sealed).unwrap(), &b"secret"[..]);
        let elsewhere = Hash([8; 32]);
        for other in [
            Place { network: &elsewhere, ..place() },
            Place { service: "Turtlebot4/cmd_ve", publisher: "lOrg1/Salma", ..place() },
            Place { service: "Husky/cmd_vel", ..place() },
            Place { publisher: "Org1/Farhad", ..place() },
            Place { epoch: 4, ..place() },
            Place { sequence: 1001, ..place() },
        ] {
            assert_eq!(open(&other, &sealed), None, "{other:?}");
        }
        for at in 0..sealed.len() {
            let mut changed = sealed.to_vec();
            *changed.get_mut(at).unwrap() ^= 1;
            assert_eq!(open(&place(), &changed), None, "changed at {at}");
        }
        let other = ContentKey::generate().unwrap();
        assert_eq!(other.open(&place(), &Envelope::parse(&sealed).unwrap()), None);
    }
}
