//! The publisher's side.

use super::content::{ContentKey, Place};
use super::reading::Wrap;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{NONCE_BYTES, Readers, Share, Wrapped};

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
    /// [`ledger_base::rejection::Code::Internal`] if the operating system gives no random bytes.
    pub fn share(network: &Hash, publisher: &str, readers: &Readers) -> Result<(Share, Fresh), Rejection> {
        let content = ContentKey::generate()?;
        Ok(Self::share_by(content, network, publisher, readers, |wrap, public, content| wrap.wrap(public, content)))
    }

    /// Shares a content key that `wrap` wraps.
    pub(crate) fn share_by(
        content: ContentKey,
        network: &Hash,
        publisher: &str,
        readers: &Readers,
        mut wrap: impl FnMut(&Wrap<'_>, &[u8], &ContentKey) -> Vec<u8>,
    ) -> (Share, Fresh) {
        let (mut share, service) = (Share::default(), &readers.service);
        for reader in readers.readers.iter().filter(|reader| reader.may_read) {
            let purpose = Wrap { network, service, publisher, reader: &reader.reader };
            let wrapped = wrap(&purpose, &hex::decode(&reader.key).unwrap_or_default(), &content);
            let (reader, key, wrapped) = (reader.reader.clone(), reader.key.clone(), hex::encode(wrapped));
            share.readers.push(Wrapped { reader, key, wrapped });
        }
        let fresh = Fresh { network: *network, service: service.clone(), publisher: publisher.to_owned(), content };
        (share, fresh)
    }

    /// The height at which the content key was shared: its name in envelopes.
    pub fn key(&self) -> u64 {
        self.key
    }

    /// The envelope of a message with this epoch and sequence number.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Internal`] if the operating system gives no random bytes.
    pub fn seal(&self, epoch: u64, sequence: u64, message: &[u8]) -> Result<Bytes, Rejection> {
        self.fresh.content.seal(&self.place(epoch, sequence), self.key, message)
    }

    /// The same with a nonce that the caller has made.
    pub(crate) fn seal_by(
        &self,
        nonce: [u8; NONCE_BYTES],
        epoch: u64,
        sequence: u64,
        message: &[u8],
    ) -> Result<Bytes, Rejection> {
        self.fresh.content.seal_with(nonce, &self.place(epoch, sequence), self.key, message)
    }

    fn place(&self, epoch: u64, sequence: u64) -> Place<'_> {
        let Fresh { network, service, publisher, .. } = &self.fresh;
        Place { network, service, publisher, epoch, sequence }
    }
}

impl Fresh {
    /// The key is good since the block of this height.
    pub fn shared_at(self, height: u64) -> Sealer {
        Sealer { fresh: self, key: height }
    }
}
