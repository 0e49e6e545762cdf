//! The reader's side.

use super::content::{ContentKey, Place};
use super::reading::{ReadingKey, Wrap};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_contract::{Envelope, Share};
use std::collections::BTreeMap;
use std::fmt;

/// Most content keys that a reader keeps; the oldest make room.
const KEYS_MAX: usize = 1024;

/// The content keys that a reader has, for all services and publishers.
#[derive(Clone, Debug)]
pub struct Keyring {
    network: Hash,
    /// The reader's name, e.g. `Org2/Turtlebot4`.
    reader: String,
    own: ReadingKey,
    /// By height, service and publisher.
    keys: BTreeMap<(u64, String, String), ContentKey>,
}

/// Why a message cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unreadable {
    /// It is not encrypted.
    NotSealed,
    /// This reader has no content key of its publisher from this height.
    NoKey(u64),
    /// It was not sealed for this place, or has been changed.
    Changed,
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotSealed => f.write_str("it is not encrypted, as messages of a confidential service are"),
            Self::NoKey(key) => write!(f, "it is not for this reader: its content key of block {key} is for others"),
            Self::Changed => f.write_str("it was encrypted for another place, or with another key, or was changed"),
        }
    }
}

impl Keyring {
    /// A reader with its pair, and no content key yet.
    pub fn new(network: Hash, reader: String, own: ReadingKey) -> Self {
        Self { network, reader, own, keys: BTreeMap::new() }
    }

    /// The network.
    pub fn network(&self) -> Hash {
        self.network
    }

    /// The reader's name.
    pub fn reader(&self) -> &str {
        &self.reader
    }

    /// The public half of the reader's pair, as the ledger keeps it.
    pub fn public_hex(&self) -> String {
        self.own.public_hex()
    }

    /// Takes what a publisher has shared in the block of this height. True if this reader is among those who can read it.
    pub fn learn(&mut self, service: &str, publisher: &str, height: u64, share: &Share) -> bool {
        let Some(wrapped) = share.readers.iter().find(|wrapped| wrapped.reader == self.reader) else { return false };
        let wrap = Wrap { network: &self.network, service, publisher, reader: &self.reader };
        let Some(content) = hex::decode(&wrapped.wrapped).ok().and_then(|wrapped| self.own.unwrap(&wrap, &wrapped))
        else {
            return false;
        };
        self.keys.insert((height, service.to_owned(), publisher.to_owned()), content);
        if self.keys.len() > KEYS_MAX {
            self.keys.pop_first();
        }
        true
    }

    /// Is the content key of a publisher from this height here?
    pub fn has(&self, service: &str, publisher: &str, height: u64) -> bool {
        self.find(service, publisher, height).is_some()
    }

    fn find(&self, service: &str, publisher: &str, height: u64) -> Option<&ContentKey> {
        self.keys.get(&(height, service.to_owned(), publisher.to_owned()))
    }

    /// The message of an envelope.
    ///
    /// # Errors
    /// Why it cannot be read here.
    pub fn open(
        &self,
        service: &str,
        publisher: &str,
        epoch: u64,
        sequence: u64,
        payload: &[u8],
    ) -> Result<Bytes, Unreadable> {
        let envelope = Envelope::parse(payload).ok_or(Unreadable::NotSealed)?;
        let content = self.find(service, publisher, envelope.key).ok_or(Unreadable::NoKey(envelope.key))?;
        let place = Place { network: &self.network, service, publisher, epoch, sequence };
        content.open(&place, &envelope).ok_or(Unreadable::Changed)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::Sealer;
    use ledger_contract::{Reader, Readers};

    const SERVICE: &str = "Husky/front";
    const PUBLISHER: &str = "Org2/Husky";

    fn keyring(name: &str) -> Keyring {
        Keyring::new(Hash::ZERO, name.to_owned(), ReadingKey::generate())
    }

    fn readers(keyrings: &[&Keyring]) -> Readers {
        let reader = |keyring: &&Keyring| Reader {
            reader: keyring.reader().to_owned(),
            key: keyring.public_hex(),
            serial: String::new(),
            may_read: true,
        };
        Readers { service: SERVICE.to_owned(), readers: keyrings.iter().map(reader).collect(), keys: vec![] }
    }

    #[test]
    fn each_reader_of_a_share_reads_and_nobody_else_and_the_next_share_changes_that() {
        let (mut salma, mut farhad) = (keyring("Org1/Salma"), keyring("Org1/Farhad"));
        let both = readers(&[&salma, &farhad]);
        let (share, fresh) = Sealer::share(&Hash::ZERO, PUBLISHER, &both).unwrap();
        let before = fresh.shared_at(5).seal(1, 1, b"before").unwrap();
        assert!(salma.learn(SERVICE, PUBLISHER, 5, &share) && farhad.learn(SERVICE, PUBLISHER, 5, &share));

        let mut one = both;
        one.readers.last_mut().unwrap().may_read = false;
        let (share, fresh) = Sealer::share(&Hash::ZERO, PUBLISHER, &one).unwrap();
        let after = fresh.shared_at(9).seal(1, 2, b"after").unwrap();
        assert!(salma.learn(SERVICE, PUBLISHER, 9, &share) && !farhad.learn(SERVICE, PUBLISHER, 9, &share));

        assert_eq!(salma.open(SERVICE, PUBLISHER, 1, 2, &after).unwrap(), &b"after"[..]);
        assert_eq!(farhad.open(SERVICE, PUBLISHER, 1, 1, &before).unwrap(), &b"before"[..], "what it had it keeps");
        assert_eq!(farhad.open(SERVICE, PUBLISHER, 1, 2, &after), Err(Unreadable::NoKey(9)));
        assert_eq!(salma.open(SERVICE, PUBLISHER, 1, 3, &after), Err(Unreadable::Changed), "another number");
        assert_eq!(salma.open("Husky/rear", PUBLISHER, 1, 2, &after), Err(Unreadable::NoKey(9)), "another service");
        assert_eq!(salma.open(SERVICE, PUBLISHER, 1, 2, b"\0\x01\0\0x"), Err(Unreadable::NotSealed));
    }

    #[test]
    fn a_share_that_was_made_for_something_else_gives_no_key() {
        let mut salma = keyring("Org1/Salma");
        let (share, _) = Sealer::share(&Hash::ZERO, PUBLISHER, &readers(&[&salma])).unwrap();
        assert!(!salma.learn("Husky/rear", PUBLISHER, 5, &share));
        assert!(!salma.learn(SERVICE, "Org1/Farhad", 5, &share));
        let mut broken = share.clone();
        broken.readers.first_mut().unwrap().wrapped = "zz".to_owned();
        assert!(!salma.learn(SERVICE, PUBLISHER, 5, &broken) && !salma.has(SERVICE, PUBLISHER, 5));
        assert!(salma.learn(SERVICE, PUBLISHER, 5, &share) && salma.has(SERVICE, PUBLISHER, 5));
    }

    #[test]
    fn the_oldest_keys_make_room() {
        let mut salma = keyring("Org1/Salma");
        let (share, _) = Sealer::share(&Hash::ZERO, PUBLISHER, &readers(&[&salma])).unwrap();
        for height in 1..=KEYS_MAX as u64 + 1 {
            assert!(salma.learn(SERVICE, PUBLISHER, height, &share));
        }
        assert_eq!(salma.keys.len(), KEYS_MAX);
        assert!(!salma.has(SERVICE, PUBLISHER, 1) && salma.has(SERVICE, PUBLISHER, 2));
    }
}
