//! The publisher's side.

use super::content::{ContentKey, Place};
use super::reading::Wrap;
use bytes::Bytes;
use ledger_contract::{Readers, Share, Wrapped};
use ledger_hash::Hash;
use ledger_rejection::Rejection;

/// Encrypts the messages of one publisher on one service, under a content key that was shared.
#[derive(Clone, Debug)]
pub struct Sealer {
    fresh: Fresh,
    key: u64,
}

/// A content key that is not shared yet.
#[derive(Clone, Debug)]
pub struct Fresh {
    network: Hash,
    service: String,
    publisher: String,
    content: ContentKey,
}

impl Sealer {
    /// A new content key, and the argument of `share` that gives it to everybody who may read.
    ///
    /// # Errors
    /// [`ledger_rejection::Code::Internal`] if the operating system gives no random bytes.
    pub fn share(network: &Hash, publisher: &str, readers: &Readers) -> Result<(Share, Fresh), Rejection> {
        let (content, service) = (ContentKey::generate()?, &readers.service);
        let mut share = Share::default();
        for reader in readers.readers.iter().filter(|reader| reader.may_read) {
            let wrap = Wrap { network, service, publisher, reader: &reader.reader };
            let wrapped = wrap.wrap(&hex::decode(&reader.key).unwrap_or_default(), &content);
            let (reader, key, wrapped) = (reader.reader.clone(), reader.key.clone(), hex::encode(wrapped));
            share.readers.push(Wrapped { reader, key, wrapped });
        }
        let fresh = Fresh { network: *network, service: service.clone(), publisher: publisher.to_owned(), content };
        Ok((share, fresh))
    }

    /// The height at which the content key was shared: its name in envelopes.
    pub fn key(&self) -> u64 {
        self.key
    }

    /// The envelope of a message with this epoch and sequence number.
    ///
    /// # Errors
    /// [`ledger_rejection::Code::Internal`] if the operating system gives no random bytes.
    pub fn seal(&self, epoch: u64, sequence: u64, message: &[u8]) -> Result<Bytes, Rejection> {
        let Fresh { network, service, publisher, content } = &self.fresh;
        content.seal(&Place { network, service, publisher, epoch, sequence }, self.key, message)
    }
}

impl Fresh {
    /// The key is good since the block of this height.
    pub fn shared_at(self, height: u64) -> Sealer {
        Sealer { fresh: self, key: height }
    }
}
