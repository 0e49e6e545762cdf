//! Sharing and sealing with random bytes that the caller makes: a simulation must be the same again from the same seed. A reader
//! that can guess these bytes reads everything, so no product uses this.

use super::content::{CONTENT_KEY_BYTES, ContentKey};
use super::sealer::{Fresh, Sealer};
use bytes::Bytes;
use hpke::rand_core::CryptoRng;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{NONCE_BYTES, Readers, Share};

impl Sealer {
    /// As [`Sealer::share`], with random bytes from there.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Internal`]: never for a key of this length.
    pub fn share_with(
        random: &mut impl CryptoRng,
        network: &Hash,
        publisher: &str,
        readers: &Readers,
    ) -> Result<(Share, Fresh), Rejection> {
        let mut bytes = [0; CONTENT_KEY_BYTES];
        random.fill_bytes(&mut bytes);
        let content = ContentKey::of(bytes)?;
        Ok(Self::share_by(content, network, publisher, readers, |wrap, public, content| {
            wrap.wrap_with(random, public, content)
        }))
    }

    /// As [`Sealer::seal`], with random bytes from there.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Internal`] for a message that is too long to be encrypted.
    pub fn seal_with(
        &self,
        random: &mut impl CryptoRng,
        epoch: u64,
        sequence: u64,
        message: &[u8],
    ) -> Result<Bytes, Rejection> {
        let mut nonce = [0; NONCE_BYTES];
        random.fill_bytes(&mut nonce);
        self.seal_by(nonce, epoch, sequence, message)
    }
}
