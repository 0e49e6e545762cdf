//! The key pair of a reader, and content keys that are wrapped for it.

use super::content::{CONTENT_KEY_BYTES, ContentKey};
use hpke::aead::ChaCha20Poly1305;
use hpke::kdf::HkdfSha256;
use hpke::kem::X25519HkdfSha256;
use hpke::rand_core::CryptoRng;
use hpke::{
    Deserializable, HpkeError, Kem, OpModeR, OpModeS, Serializable, single_shot_open, single_shot_seal,
    single_shot_seal_with_rng,
};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{READING_KEY_BYTES, WRAPPED_BYTES};
use std::fmt;

type Pair = X25519HkdfSha256;
type Public = <Pair as Kem>::PublicKey;
/// The public half of a pair that was made for this, and the ciphertext.
type Sealed = (<Pair as Kem>::EncappedKey, Vec<u8>);

/// Separates this use of HPKE from all others.
const DOMAIN: &[u8] = b"ledgerd content key v1\0";

/// The key pair with which an identity reads: its own, beside the one with which it signs, and for all services.
#[derive(Clone)]
pub struct ReadingKey {
    secret: <Pair as Kem>::PrivateKey,
    public: Public,
}

impl fmt::Debug for ReadingKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ReadingKey({})", self.public_hex())
    }
}

/// The purpose of a wrapped key: both sides must say the same.
#[derive(Clone, Copy, Debug)]
pub struct Wrap<'a> {
    /// The network.
    pub network: &'a Hash,
    /// The service's full id.
    pub service: &'a str,
    /// The publisher whose key it is, e.g. `Org1/Salma`.
    pub publisher: &'a str,
    /// The reader for whom it is.
    pub reader: &'a str,
}

impl ReadingKey {
    /// A new pair.
    pub fn generate() -> Self {
        let (secret, public) = Pair::gen_keypair();
        Self { secret, public }
    }

    /// The pair with this secret half.
    ///
    /// # Errors
    /// [`Code::BadFile`] if it is no such key.
    pub fn from_secret(bytes: &[u8]) -> Result<Self, Rejection> {
        let secret = <Pair as Kem>::PrivateKey::from_bytes(bytes).map_err(|error| {
            Rejection::new(Code::BadFile, "this is no reading key")
                .found(error.to_string())
                .wanted(format!("{READING_KEY_BYTES} bytes"))
                .next("restore the file; without it a new key is made, which opens nothing of before")
        })?;
        let public = Pair::sk_to_pk(&secret);
        Ok(Self { secret, public })
    }

    /// The secret half.
    pub fn secret(&self) -> Vec<u8> {
        self.secret.to_bytes().to_vec()
    }

    /// The public half, as the ledger keeps it.
    pub fn public_hex(&self) -> String {
        hex::encode(self.public.to_bytes())
    }

    /// Opens a content key that was wrapped for this pair; none if it was wrapped for another, or another purpose.
    pub fn unwrap(&self, wrap: &Wrap<'_>, wrapped: &[u8]) -> Option<ContentKey> {
        let (front, content) = wrapped.split_at_checked(READING_KEY_BYTES)?;
        let front = <Pair as Kem>::EncappedKey::from_bytes(front).ok()?;
        let (mode, info) = (OpModeR::Base, wrap.info());
        let bytes =
            single_shot_open::<ChaCha20Poly1305, HkdfSha256, Pair>(&mode, &self.secret, &front, &info, content, &[]);
        ContentKey::of(<[u8; CONTENT_KEY_BYTES]>::try_from(bytes.ok()?).ok()?).ok()
    }
}

impl Wrap<'_> {
    /// Wraps a content key for the pair with this public half. A key that hides nothing gets zeros: its reader must not keep the
    /// publisher from all others, and reads nothing itself.
    pub fn wrap(&self, public: &[u8], content: &ContentKey) -> Vec<u8> {
        let seal = single_shot_seal::<ChaCha20Poly1305, HkdfSha256, Pair>;
        self.wrap_by(public, |public, info| seal(&OpModeS::Base, public, info, content.bytes(), &[]))
    }

    /// The same with random bytes from there.
    pub(crate) fn wrap_with(&self, random: &mut impl CryptoRng, public: &[u8], content: &ContentKey) -> Vec<u8> {
        let seal = single_shot_seal_with_rng::<ChaCha20Poly1305, HkdfSha256, Pair>;
        self.wrap_by(public, |public, info| seal(&OpModeS::Base, public, info, content.bytes(), &[], random))
    }

    fn wrap_by(&self, public: &[u8], seal: impl FnOnce(&Public, &[u8]) -> Result<Sealed, HpkeError>) -> Vec<u8> {
        let public = Public::from_bytes(public).ok();
        let sealed = public.and_then(|public| seal(&public, &self.info()).ok());
        sealed.map_or_else(|| vec![0; WRAPPED_BYTES], |(front, content)| [&front.to_bytes()[..], &content].concat())
    }

    fn info(&self) -> Vec<u8> {
        let mut info = DOMAIN.to_vec();
        let Self { network, service, publisher, reader } = self;
        crate::parts(&mut info, &[&network.0, service.as_bytes(), publisher.as_bytes(), reader.as_bytes()]);
        info
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn wrap() -> Wrap<'static> {
        Wrap { network: &Hash::ZERO, service: "Husky/front", publisher: "Org2/Husky", reader: "Org1/Salma" }
    }

    #[test]
    fn a_wrapped_key_is_opened_by_its_reader_for_its_purpose_and_by_nobody_else() {
        let (own, other, content) = (ReadingKey::generate(), ReadingKey::generate(), ContentKey::generate().unwrap());
        let public = hex::decode(own.public_hex()).unwrap();
        let wrapped = wrap().wrap(&public, &content);
        assert_eq!(wrapped.len(), WRAPPED_BYTES);
        assert_eq!(own.unwrap(&wrap(), &wrapped).unwrap().bytes(), content.bytes());
        assert!(other.unwrap(&wrap(), &wrapped).is_none());
        let elsewhere = Hash([1; 32]);
        for changed in [
            Wrap { network: &elsewhere, ..wrap() },
            Wrap { service: "Husky/rear", ..wrap() },
            Wrap { publisher: "Org1/Salma", ..wrap() },
            Wrap { reader: "Org1/Farhad", ..wrap() },
        ] {
            assert!(own.unwrap(&changed, &wrapped).is_none(), "{changed:?}");
        }
        for at in 0..wrapped.len() {
            let mut changed = wrapped.clone();
            *changed.get_mut(at).unwrap() ^= 1;
            assert!(own.unwrap(&wrap(), &changed).is_none(), "changed at {at}");
            assert!(own.unwrap(&wrap(), wrapped.get(..at).unwrap()).is_none(), "cut at {at}");
        }
    }

    #[test]
    fn a_pair_is_the_same_again_from_its_secret_half() {
        let own = ReadingKey::generate();
        assert_eq!(ReadingKey::from_secret(&own.secret()).unwrap().public_hex(), own.public_hex());
        assert!(ReadingKey::from_secret(&[1; 31]).is_err());
    }

    #[test]
    fn a_key_that_would_hide_nothing_gets_nothing() {
        let content = ContentKey::generate().unwrap();
        for (bad, why) in [(&[0; READING_KEY_BYTES][..], "a point of small order"), (&[9; 5], "too short")] {
            assert_eq!(wrap().wrap(bad, &content), [0; WRAPPED_BYTES], "{why}");
        }
    }

    /// The test vector of docs/format.md.
    #[test]
    fn what_was_wrapped_once_is_opened_for_ever() {
        let own = ReadingKey::from_secret(&[3; 32]).unwrap();
        assert_eq!(own.public_hex(), PUBLIC);
        let content = own.unwrap(&wrap(), &hex::decode(WRAPPED).unwrap()).unwrap();
        assert_eq!(content.bytes(), &[1; 32]);
    }

    const PUBLIC: &str = "5dfedd3b6bd47f6fa28ee15d969d5bb0ea53774d488bdaf9df1c6e0124b3ef22";
    const WRAPPED: &str = "50a61409b1ddd0325e9b16b700e719e9772c07000b1bd7786e907c653d20495d70e6e45fdf0ed406\
        8b0585e94a82fd13e9f0cb646ea0fa267d5414ba39920f2dd1d1c6d64df422ce12580d97865816e3";
}
