//! How the key of a CA travels from one node to another: sealed for a key that the receiver made for this purpose
//! (HPKE, RFC 9180: X25519, HKDF-SHA256, ChaCha20-Poly1305). A carrier between the two cannot read or change it.

use hpke::aead::ChaCha20Poly1305;
use hpke::kdf::HkdfSha256;
use hpke::kem::X25519HkdfSha256;
use hpke::{Deserializable, Kem, OpModeR, OpModeS, Serializable, single_shot_open, single_shot_seal};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

type Key = X25519HkdfSha256;

/// Length of a receiver's public key, and of the part in front of what is sealed, in bytes.
const KEY_BYTES: usize = 32;
/// Largest thing that is opened, in bytes.
const SEALED_BYTES_MAX: usize = 8 * 1024;
/// Separates this use of HPKE from all others.
const DOMAIN: &[u8] = b"ledgerd CA key for a node v1\0";

/// A key pair for one delivery.
pub(crate) struct Receiver {
    secret: <Key as Kem>::PrivateKey,
    public: <Key as Kem>::PublicKey,
}

/// The purpose and the receiver of a seal: both sides must say the same.
pub(crate) struct Delivery<'a> {
    /// The network.
    pub(crate) network: &'a Hash,
    /// The organisation of the CA.
    pub(crate) organisation: &'a str,
    /// The node that receives it, `ORGANISATION/NAME`.
    pub(crate) node: &'a str,
    /// The root certificate that belongs to the key, DER.
    pub(crate) root: &'a [u8],
}

impl Receiver {
    /// A new pair.
    pub(crate) fn generate() -> Self {
        let (secret, public) = Key::gen_keypair();
        Self { secret, public }
    }

    /// The public half.
    pub(crate) fn public(&self) -> Vec<u8> {
        self.public.to_bytes().to_vec()
    }

    /// Opens what was sealed for this pair.
    ///
    /// # Errors
    /// [`Code::BadSignature`] if it was sealed for somebody else, or changed on its way.
    pub(crate) fn open(&self, delivery: &Delivery<'_>, sealed: &[u8]) -> Result<Vec<u8>, Rejection> {
        let refused = |found: String| {
            Rejection::new(Code::BadSignature, "the encrypted key cannot be opened")
                .found(found)
                .wanted("a key that was just encrypted for this node")
                .next("ledgerctl ca carry NODE starts the transfer again")
        };
        if sealed.len() > SEALED_BYTES_MAX {
            return Err(refused(format!("{} bytes", sealed.len())));
        }
        let (front, content) =
            sealed.split_at_checked(KEY_BYTES).ok_or_else(|| refused(format!("{} bytes", sealed.len())))?;
        let front = <Key as Kem>::EncappedKey::from_bytes(front).map_err(|error| refused(error.to_string()))?;
        let info = delivery.info();
        single_shot_open::<ChaCha20Poly1305, HkdfSha256, Key>(
            &OpModeR::Base,
            &self.secret,
            &front,
            &info,
            content,
            delivery.root,
        )
        .map_err(|error| refused(error.to_string()))
    }
}

impl Delivery<'_> {
    /// Seals a secret for the pair with this public half.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if it is no such key.
    pub(crate) fn seal(&self, public: &[u8], secret: &[u8]) -> Result<Vec<u8>, Rejection> {
        let refused = |error: hpke::HpkeError| {
            Rejection::new(Code::BadArgument, "nothing can be encrypted for this key").found(error.to_string())
        };
        let public = <Key as Kem>::PublicKey::from_bytes(public).map_err(refused)?;
        let (front, content) = single_shot_seal::<ChaCha20Poly1305, HkdfSha256, Key>(
            &OpModeS::Base,
            &public,
            &self.info(),
            secret,
            self.root,
        )
        .map_err(refused)?;
        Ok([front.to_bytes().as_slice(), &content].concat())
    }

    /// The context that both sides agree on.
    fn info(&self) -> Vec<u8> {
        let mut info = DOMAIN.to_vec();
        for part in [&self.network.0[..], self.organisation.as_bytes(), self.node.as_bytes()] {
            info.extend_from_slice(&(part.len() as u64).to_be_bytes());
            info.extend_from_slice(part);
        }
        info
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn delivery() -> Delivery<'static> {
        Delivery { network: &Hash::ZERO, organisation: "Org1", node: "Org1/node2", root: b"root" }
    }

    #[test]
    fn what_is_sealed_is_opened_by_whom_it_is_for_and_by_nobody_else() {
        let (receiver, other) = (Receiver::generate(), Receiver::generate());
        let sealed = delivery().seal(&receiver.public(), b"the key").unwrap();
        assert_eq!(receiver.open(&delivery(), &sealed).unwrap(), b"the key");
        assert!(!sealed.windows(7).any(|part| part == b"the key"));
        assert!(other.open(&delivery(), &sealed).is_err());
        let elsewhere = Hash([1; 32]);
        for changed in [
            Delivery { network: &elsewhere, ..delivery() },
            Delivery { organisation: "Org2", ..delivery() },
            Delivery { node: "Org1/node3", ..delivery() },
            Delivery { root: b"other", ..delivery() },
        ] {
            assert!(receiver.open(&changed, &sealed).is_err());
        }
    }

    #[test]
    fn what_was_changed_or_cut_on_its_way_is_refused() {
        let receiver = Receiver::generate();
        let sealed = delivery().seal(&receiver.public(), b"the key").unwrap();
        for cut in 0..sealed.len() {
            assert!(receiver.open(&delivery(), sealed.get(..cut).unwrap()).is_err(), "cut at {cut}");
        }
        for at in 0..sealed.len() {
            let mut changed = sealed.clone();
            *changed.get_mut(at).unwrap() ^= 1;
            assert!(receiver.open(&delivery(), &changed).is_err(), "changed at {at}");
        }
        assert!(receiver.open(&delivery(), &vec![0; SEALED_BYTES_MAX + 1]).is_err());
        assert!(delivery().seal(b"short", b"the key").is_err());
    }
}
