//! Confidential services: who reads them, the keys that publishers share, and the envelope of a message.

use serde::{Deserialize, Serialize};

/// Most readers of one confidential service.
pub const READERS_MAX: usize = 64;
/// Length of a reading key, in bytes: the public half of an X25519 pair.
pub const READING_KEY_BYTES: usize = 32;
/// Length of a content key that is wrapped for a reader, in bytes: what HPKE puts in front, the key, and its tag.
pub const WRAPPED_BYTES: usize = 32 + 32 + 16;

/// The first bytes of an envelope. No CDR begins so: its first byte is zero.
const MARK: [u8; 2] = [0xe5, 0x01];
/// Length of a nonce, in bytes.
pub const NONCE_BYTES: usize = 12;
/// Length of what stands before the ciphertext, in bytes.
const HEAD_BYTES: usize = MARK.len() + 8 + NONCE_BYTES;
/// Length of the tag at the end of a ciphertext, in bytes.
const TAG_BYTES: usize = 16;

/// A message of a confidential service, as it stands in the transaction in the place of its CDR.
///
/// ```text
/// 0        2          10         22
/// +--------+----------+----------+------------------+
/// | e5 01  | key      | nonce    | ciphertext, tag  |
/// +--------+----------+----------+------------------+
/// ```
/// `key` is the height of the block in which the publisher shared the content key, big endian: with the service and the publisher
/// it names that key. The ciphertext is ChaCha20-Poly1305, with 16 bytes of tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope<'a> {
    /// The height at which the content key was shared.
    pub key: u64,
    /// The nonce.
    pub nonce: [u8; NONCE_BYTES],
    /// The ciphertext with its tag.
    pub sealed: &'a [u8],
}

impl<'a> Envelope<'a> {
    /// Reads an envelope; none if the bytes are none.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let (head, sealed) = bytes.split_at_checked(HEAD_BYTES)?;
        let rest = head.strip_prefix(&MARK)?;
        let (key, nonce) = rest.split_first_chunk::<8>()?;
        let nonce = *nonce.first_chunk::<NONCE_BYTES>()?;
        (sealed.len() >= TAG_BYTES).then_some(Self { key: u64::from_be_bytes(*key), nonce, sealed })
    }

    /// The bytes before the ciphertext.
    pub fn head(key: u64, nonce: &[u8; NONCE_BYTES]) -> Vec<u8> {
        [&MARK[..], &key.to_be_bytes(), nonce].concat()
    }
}

/// A reader of a confidential service, as `readers` lists them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reader {
    /// The identity, e.g. `Org1/Salma`.
    pub reader: String,
    /// Its reading key, in hexadecimal digits.
    pub key: String,
    /// The serial number of the certificate with which it entered, in hexadecimal digits.
    pub serial: String,
    /// May it read now? One that may not gets no content key.
    pub may_read: bool,
}

/// The block in which a publisher shared its content key last.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyPlace {
    /// The publisher, e.g. `Org1/Salma`.
    pub publisher: String,
    /// The height: the name of the key in envelopes.
    pub key: u64,
}

/// Answer of `readers`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Readers {
    /// The service.
    pub service: String,
    /// All that have entered, in order of their names.
    pub readers: Vec<Reader>,
    /// The newest content key of each publisher.
    pub keys: Vec<KeyPlace>,
}

/// A content key for one reader: an element of [`Share`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wrapped {
    /// The reader.
    pub reader: String,
    /// The reading key for which it was wrapped, in hexadecimal digits.
    pub key: String,
    /// The content key in HPKE, in hexadecimal digits.
    pub wrapped: String,
}

/// The argument of `share`: a content key, wrapped for everybody who may read now, in order of their names.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Share {
    /// One for each reader.
    pub readers: Vec<Wrapped>,
}

/// Answer of `share`, and payload of the event `keyed`, whose subject is the service; the wrapped keys are an argument of the
/// transaction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Keyed {
    /// The height of its block: the name of the key in envelopes.
    pub key: u64,
    /// When it must be replaced at the latest (block time, microseconds).
    pub until: u64,
    /// For how many readers it is.
    pub readers: u64,
}

/// Answer of `reader`, and payload of the event `reader`, whose subject is the service: its readers have changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReaderTold {
    /// The service.
    pub service: String,
    /// The reader.
    pub reader: String,
    /// `entered` or `left`.
    pub change: String,
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_is_read_as_it_was_written_and_nothing_shorter_is_one() {
        let nonce = [7; NONCE_BYTES];
        let bytes = [Envelope::head(0x0102_0304, &nonce), vec![9; TAG_BYTES]].concat();
        let read = Envelope::parse(&bytes).unwrap();
        assert_eq!(read, Envelope { key: 0x0102_0304, nonce, sealed: &[9; TAG_BYTES] });
        assert!((0..bytes.len()).all(|cut| Envelope::parse(bytes.get(..cut).unwrap()).is_none()));
        for (at, byte) in [(0, 0), (1, 2)] {
            let mut other = bytes.clone();
            *other.get_mut(at).unwrap() = byte;
            assert_eq!(Envelope::parse(&other), None, "no mark");
        }
    }
}
