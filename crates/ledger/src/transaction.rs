//! Transactions: signed requests to call a chaincode function.
//!
//! The message formats are those of `crates/api/proto/ledgerd/v1/transaction.proto`. A transaction travels and is
//! stored as the exact bytes that its creator sent. Its id is the SHA-256 of its body, so a rewritten signature (ECDSA
//! allows many) is still the same transaction. The creator signs the body, or the id of a long one.

use crate::block::{PAYLOAD_BYTES_MAX, leaf};
use crate::call_ref::CallRef;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::key::{PublicKey, SigningKey};
use ledger_storage::retention::KEPT_MIN_US;
use prost::Message;
use std::sync::{Arc, OnceLock};

/// How far `not_after` may lie ahead of block time, and so how long ids must be remembered: microseconds.
pub const NOT_AFTER_AHEAD_MAX: u64 = 120_000_000;
const _: () = assert!(KEPT_MIN_US >= 2 * NOT_AFTER_AHEAD_MAX, "a block is kept while its verdicts may be asked for");
/// Most bytes of one encoded transaction; a node's configuration may allow less, never more.
pub const TRANSACTION_BYTES_MAX: usize = PAYLOAD_BYTES_MAX / 2;
/// Most arguments of one call.
pub const ARGUMENTS_MAX: usize = 1024;
/// Most bytes of the names of chaincode and function.
pub const NAME_BYTES_MAX: usize = 128;
/// Exact length of a nonce.
pub const NONCE_BYTES: usize = 16;
/// Exact length of the part of a block's hash in a [`KnownBlock`].
pub const KNOWN_HASH_BYTES: usize = 8;
/// Separates these signatures from everything else that the same key may sign (TLS, certificate requests).
const SIGNATURE_DOMAIN: &[u8] = b"ledgerd transaction v1\0";
/// The same where the id is signed.
const ID_SIGNATURE_DOMAIN: &[u8] = b"ledgerd transaction id v1\0";
/// A body with more bytes may be signed by its id. Ed25519 hashes what it signs twice, and every check hashes it again,
/// with a hash for which processors have no instructions; the id is needed anyway.
pub const SIGNED_WHOLE_MAX: usize = 4096;

/// The bytes that the creator signs.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Body {
    /// Name of the network (32 bytes).
    #[prost(bytes = "bytes", tag = "1")]
    pub network: Bytes,
    /// SHA-256 of the creator's certificate in DER (32 bytes).
    #[prost(bytes = "bytes", tag = "2")]
    pub creator: Bytes,
    /// 16 random bytes.
    #[prost(bytes = "bytes", tag = "3")]
    pub nonce: Bytes,
    /// Block time after which it is no longer executed, microseconds since the UNIX epoch.
    #[prost(uint64, tag = "4")]
    pub not_after: u64,
    /// Name of the chaincode.
    #[prost(string, tag = "5")]
    pub chaincode: String,
    /// Name of its function.
    #[prost(string, tag = "6")]
    pub function: String,
    /// Arguments in order.
    #[prost(bytes = "bytes", repeated, tag = "7")]
    pub args: Vec<Bytes>,
    /// The newest block that the creator knew, if it names one. The ledger does not look at it; gates measure age by it.
    #[prost(message, optional, tag = "8")]
    pub known_block: Option<KnownBlock>,
}

/// The newest block that a signer knew when it signed. Its hash cannot be predicted, so it was signed after that block was made.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct KnownBlock {
    /// Its height.
    #[prost(uint64, tag = "1")]
    pub height: u64,
    /// The first [`KNOWN_HASH_BYTES`] bytes of the hash of its header.
    #[prost(bytes = "bytes", tag = "2")]
    pub hash: Bytes,
    /// How long the signer had known it by its steady clock, microseconds.
    #[prost(uint64, tag = "3")]
    pub known_us: u64,
}

impl KnownBlock {
    /// The first bytes of a block's hash, by which [`KnownBlock`] names it.
    pub fn prefix(hash: &[u8]) -> Option<[u8; KNOWN_HASH_BYTES]> {
        hash.first_chunk().copied()
    }
}

/// The three parts as they are stored and sent.
#[derive(Clone, PartialEq, Eq, prost::Message)]
struct Envelope {
    #[prost(bytes = "bytes", tag = "1")]
    body: Bytes,
    #[prost(bytes = "bytes", tag = "2")]
    signature: Bytes,
    #[prost(bytes = "bytes", tag = "3")]
    certificate: Bytes,
}

/// A transaction whose form has been checked; its signature has not (see [`Transaction::verify`]).
#[derive(Clone, Debug)]
pub struct Transaction {
    body: Body,
    envelope: Envelope,
    encoded: Bytes,
    /// Both are calculated when somebody asks: hashing megabytes takes a millisecond.
    id: OnceLock<Hash>,
    leaf: OnceLock<Hash>,
}

/// By its bytes, from which everything else follows.
impl PartialEq for Transaction {
    fn eq(&self, other: &Self) -> bool {
        self.encoded == other.encoded
    }
}

impl Transaction {
    /// The name by which others ask for its verdict.
    pub fn call_ref(&self) -> CallRef {
        CallRef { id: self.id(), not_after: self.body().not_after }
    }

    /// Signs a body whole, as every network understands it.
    ///
    /// # Errors
    /// A transaction that [`Transaction::decode`] would refuse.
    pub fn sign(body: &Body, key: &SigningKey) -> Result<Self, Rejection> {
        let mut signed = Vec::with_capacity(SIGNATURE_DOMAIN.len().saturating_add(body.encoded_len()));
        signed.extend_from_slice(SIGNATURE_DOMAIN);
        body.encode_raw(&mut signed);
        let signature = key.sign(&signed).into();
        let body = Bytes::from(signed).slice(SIGNATURE_DOMAIN.len()..);
        Self::from_envelope(Envelope { body, signature, certificate: Bytes::new() }, OnceLock::new())
    }

    /// Signs a body by its id if it is long, else whole.
    ///
    /// # Errors
    /// As [`Transaction::sign`].
    pub fn sign_by_id(body: &Body, key: &SigningKey) -> Result<Self, Rejection> {
        if body.encoded_len() <= SIGNED_WHOLE_MAX {
            return Self::sign(body, key);
        }
        let body = Bytes::from(body.encode_to_vec());
        let id = Hash::of(&[&body]);
        let signature = key.sign(&signed_id(&id)).into();
        Self::from_envelope(Envelope { body, signature, certificate: Bytes::new() }, id.into())
    }

    /// The same transaction, carrying its creator's certificate.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if it does not fit.
    pub fn with_certificate(&self, certificate: Bytes) -> Result<Self, Rejection> {
        Self::from_envelope(Envelope { certificate, ..self.envelope.clone() }, self.id.clone())
    }

    /// Reads a transaction and checks its form.
    ///
    /// # Errors
    /// [`Code::TooLarge`] beyond a limit, [`Code::Malformed`] if the bytes or the lengths of fields are wrong.
    pub fn decode(encoded: Bytes) -> Result<Self, Rejection> {
        if encoded.len() > TRANSACTION_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "the transaction is too large")
                .found(format!("{} bytes", encoded.len()))
                .wanted(format!("at most {TRANSACTION_BYTES_MAX} bytes"))
                .next("split it into several transactions"));
        }
        let envelope = Envelope::decode(encoded.clone()).map_err(|error| malformed(&error.to_string()))?;
        let body = Body::decode(envelope.body.clone()).map_err(|error| malformed(&error.to_string()))?;
        check_encoding("Transaction", &envelope, encoded.len())?;
        check_encoding("TransactionBody", &body, envelope.body.len())?;
        check_form(&body)?;
        Ok(Self { body, envelope, encoded, id: OnceLock::new(), leaf: OnceLock::new() })
    }

    /// `id` is that of the body, if it was calculated.
    fn from_envelope(envelope: Envelope, id: OnceLock<Hash>) -> Result<Self, Rejection> {
        Ok(Self { id, ..Self::decode(envelope.encode_to_vec().into())? })
    }

    /// SHA-256 of the body.
    pub fn id(&self) -> Hash {
        *self.id.get_or_init(|| Hash::of(&[&self.envelope.body]))
    }

    /// Its leaf in the Merkle tree of a block.
    pub fn leaf(&self) -> Hash {
        *self.leaf.get_or_init(|| leaf(&self.encoded))
    }

    /// The signed bytes.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// SHA-256 of the creator's certificate.
    pub fn creator(&self) -> Hash {
        Hash::from_slice(&self.body.creator).unwrap_or(Hash::ZERO)
    }

    /// The creator's certificate in DER, if it travels along.
    pub fn certificate(&self) -> Option<&Bytes> {
        Some(&self.envelope.certificate).filter(|certificate| !certificate.is_empty())
    }

    /// The exact bytes to store and to send.
    pub fn encoded(&self) -> &Bytes {
        &self.encoded
    }

    /// May its signature be over its id?
    pub(crate) fn is_long(&self) -> bool {
        self.envelope.body.len() > SIGNED_WHOLE_MAX
    }

    /// Checks the creator's signature, over the body or over the id of a long one.
    ///
    /// # Errors
    /// [`Code::BadSignature`].
    pub fn verify(&self, key: &PublicKey) -> Result<(), Rejection> {
        let by_id = self.is_long() && key.verify(&signed_id(&self.id()), &self.envelope.signature).is_ok();
        if by_id { Ok(()) } else { self.verify_whole(key) }
    }

    fn verify_whole(&self, key: &PublicKey) -> Result<(), Rejection> {
        key.verify(&signed_bytes(&self.envelope.body), &self.envelope.signature).map_err(|error| {
            Rejection::new(
                Code::BadSignature,
                format!("the signature of transaction {} is not valid: {error}", self.id()),
            )
            .wanted(format!("a signature by the key of certificate {}", self.creator()))
        })
    }

    /// Do the creators' signatures over the bodies of all these verify? As [`PublicKey::verify_together`].
    pub(crate) fn verify_together(signed: &[(&Self, Arc<Identity>)]) -> bool {
        let messages: Vec<_> = signed.iter().map(|(transaction, _)| signed_bytes(&transaction.envelope.body)).collect();
        PublicKey::verify_together(signed.iter().zip(&messages).map(|((transaction, identity), message)| {
            (&identity.public_key, message.as_slice(), transaction.envelope.signature.as_ref())
        }))
    }

    /// Checks the window in which it may be executed.
    ///
    /// # Errors
    /// [`Code::Expired`], [`Code::NotAfterTooFar`].
    pub fn check_time(&self, block_time: u64) -> Result<(), Rejection> {
        let not_after = self.body.not_after;
        if not_after < block_time {
            return Err(Rejection::new(Code::Expired, "the transaction expired before it was executed")
                .found(format!("not_after {}, block time {}", rfc3339(not_after), rfc3339(block_time)))
                .wanted("execution before not_after"));
        }
        if not_after > block_time.saturating_add(NOT_AFTER_AHEAD_MAX) {
            return Err(Rejection::new(Code::NotAfterTooFar, "not_after is too far in the future")
                .found(format!("not_after {}, block time {}", rfc3339(not_after), rfc3339(block_time)))
                .wanted(format!("at most {} s after block time", NOT_AFTER_AHEAD_MAX / 1_000_000)));
        }
        Ok(())
    }
}

/// The creator that an encoded transaction names: the SHA-256 of the creator's certificate, if it names one. Nothing is
/// checked, and nothing else is read: for sorting what waits, where somebody has looked at the transaction before.
pub fn claimed_creator(encoded: &Bytes) -> Option<Hash> {
    #[derive(Clone, PartialEq, prost::Message)]
    struct OnlyBody {
        #[prost(bytes = "bytes", tag = "1")]
        body: Bytes,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    struct OnlyCreator {
        #[prost(bytes = "bytes", tag = "2")]
        creator: Bytes,
    }
    let OnlyBody { body } = OnlyBody::decode(encoded.clone()).ok()?;
    Hash::from_slice(&OnlyCreator::decode(body).ok()?.creator)
}

fn signed_bytes(body: &[u8]) -> Vec<u8> {
    [SIGNATURE_DOMAIN, body].concat()
}

fn signed_id(id: &Hash) -> Vec<u8> {
    [ID_SIGNATURE_DOMAIN, &id.0].concat()
}

fn malformed(what: &str) -> Rejection {
    Rejection::new(Code::Malformed, format!("the bytes are not a transaction: {what}"))
        .wanted("an encoded ledgerd.v1.Transaction (transaction.proto)")
}

/// Refuses bytes that the message does not account for: a field that it does not have, one that stands twice, a number
/// that is longer than it must be. The signer of such a field meant something by it, and it would be left out in
/// silence.
fn check_encoding(name: &str, message: &impl Message, found: usize) -> Result<(), Rejection> {
    let wanted = message.encoded_len();
    if found == wanted {
        return Ok(());
    }
    Err(malformed(&format!("{name} has unknown fields, or a field twice"))
        .found(format!("{found} bytes, of which its fields account for {wanted}"))
        .wanted(format!("exactly the fields of {name} in transaction.proto, in canonical encoding")))
}

fn check_form(body: &Body) -> Result<(), Rejection> {
    for (name, found, wanted) in [
        ("network", body.network.len(), 32),
        ("creator", body.creator.len(), 32),
        ("nonce", body.nonce.len(), NONCE_BYTES),
    ] {
        if found != wanted {
            return Err(malformed(&format!("field {name} has {found} bytes instead of {wanted}")));
        }
    }
    if let Some(found) = body.known_block.as_ref().map(|known| known.hash.len()).filter(|len| *len != KNOWN_HASH_BYTES)
    {
        return Err(malformed(&format!("field known_block has {found} bytes of a hash instead of {KNOWN_HASH_BYTES}")));
    }
    for (name, text) in [("chaincode", &body.chaincode), ("function", &body.function)] {
        if text.is_empty() || text.len() > NAME_BYTES_MAX {
            return Err(malformed(&format!("field {name} has {} bytes instead of 1 to {NAME_BYTES_MAX}", text.len())));
        }
    }
    if body.args.len() > ARGUMENTS_MAX {
        return Err(Rejection::new(Code::TooLarge, "the transaction has too many arguments")
            .found(body.args.len().to_string())
            .wanted(format!("at most {ARGUMENTS_MAX}")));
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_identity::key::KeyKind;
    use ring::rand::SystemRandom;

    fn body() -> Body {
        Body {
            network: vec![1; 32].into(),
            creator: vec![2; 32].into(),
            nonce: vec![3; 16].into(),
            not_after: 0,
            chaincode: "abac".into(),
            function: "acquire".into(),
            args: vec![Bytes::new(), "Husky".into()],
            known_block: None,
        }
    }

    /// The same call, signed as these bytes.
    fn signed(body: Vec<u8>, beyond: &[u8]) -> Result<Transaction, Rejection> {
        let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
        let signature = key.sign(&signed_bytes(&body)).into();
        let envelope = Envelope { body: body.into(), signature, certificate: Bytes::new() };
        Transaction::decode([&envelope.encode_to_vec(), beyond].concat().into())
    }

    /// A call that this key has signed in this way.
    fn signed_as(body: &[u8], key: &SigningKey, message: &[u8]) -> Transaction {
        let signature = key.sign(message).into();
        let envelope = Envelope { body: body.to_vec().into(), signature, certificate: Bytes::new() };
        Transaction::decode(envelope.encode_to_vec().into()).unwrap()
    }

    #[test]
    fn an_expired_transaction_is_told_by_its_times_and_not_to_be_signed_again() {
        let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
        let at = Body { not_after: 1_700_000_000_000_000, ..body() }.encode_to_vec();
        let transaction = signed_as(&at, &key, &signed_bytes(&at));
        let late = transaction.check_time(1_700_000_001_000_000).unwrap_err();
        assert_eq!(late.message, "the transaction expired before it was executed");
        assert_eq!(late.found, "not_after 2023-11-14T22:13:20.000000Z, block time 2023-11-14T22:13:21.000000Z");
        assert!(late.advice().contains("send a new one") && !late.advice().contains("sign"), "{late}");
        let early = transaction.check_time(1_600_000_000_000_000).unwrap_err();
        assert!(early.found.contains("block time 2020-09-13T") && early.wanted.starts_with("at most 120 s"), "{early}");
    }

    #[test]
    fn a_long_body_may_be_signed_by_its_id_and_a_short_one_may_not() {
        let with = |argument: usize| Body { args: vec![vec![7; argument].into()], ..body() };
        let beside = with(SIGNED_WHOLE_MAX).encoded_len() - SIGNED_WHOLE_MAX;
        let longest = SIGNED_WHOLE_MAX - beside;
        for kind in [KeyKind::Ed25519, KeyKind::P256] {
            let key = SigningKey::generate(kind, &SystemRandom::new()).unwrap();
            for (argument, may) in [(longest, false), (longest + 1, true)] {
                let encoded = with(argument).encode_to_vec();
                assert_eq!(encoded.len() > SIGNED_WHOLE_MAX, may);
                let id = Hash::of(&[&encoded]);
                let by_id = signed_as(&encoded, &key, &signed_id(&id));
                assert_eq!(by_id.verify(&key.public_key()).is_ok(), may);
                let whole = signed_as(&encoded, &key, &signed_bytes(&encoded));
                whole.verify(&key.public_key()).unwrap();
                // The text before keeps one kind of signature from passing for the other, and for that of another message.
                let of_another = signed_as(&encoded, &key, &signed_id(&Hash::of(&[b"another"])));
                let mixed = signed_as(&encoded, &key, &signed_bytes(&id.0));
                assert!(of_another.verify(&key.public_key()).is_err() && mixed.verify(&key.public_key()).is_err());
                let made = Transaction::sign_by_id(&with(argument), &key).unwrap();
                made.verify(&key.public_key()).unwrap();
                assert_eq!(
                    made.verify_whole(&key.public_key()).is_err(),
                    may,
                    "the shorter way is taken where it may be"
                );
                assert_eq!(made.id(), id);
            }
        }
    }

    #[test]
    fn fields_that_a_transaction_does_not_have_are_refused_wherever_they_stand() {
        let encoded = body().encode_to_vec();
        signed(encoded.clone(), &[]).unwrap();
        // Field 9: a number, a fixed one of eight bytes, a text, an empty group.
        for unknown in [&[0x48, 7][..], &[0x49, 0, 0, 0, 0, 0, 0, 0, 0], &[0x4a, 1, b'x'], &[0x4b, 0x4c]] {
            for body in [[&encoded, unknown].concat(), [unknown, &encoded].concat()] {
                let refused = signed(body, &[]).unwrap_err();
                assert_eq!(refused.code, Code::Malformed, "{refused}");
                assert!(refused.message.contains("TransactionBody has unknown fields"), "{refused}");
            }
            assert!(signed(encoded.clone(), unknown).unwrap_err().message.contains("Transaction has unknown fields"));
        }
    }

    #[test]
    fn a_known_block_is_named_by_eight_bytes_of_its_hash() {
        for (len, fits) in [(0, false), (7, false), (8, true), (32, false)] {
            let known = KnownBlock { height: 1, hash: vec![1; len].into(), known_us: 0 };
            let body = Body { known_block: Some(known), ..body() };
            assert_eq!(signed(body.encode_to_vec(), b"").is_ok(), fits, "{len}");
        }
    }

    #[test]
    fn a_call_has_one_encoding_but_for_the_order_of_its_fields() {
        let encoded = body().encode_to_vec();
        // The function again; not_after although it is zero; a number of two bytes that fits into one.
        for other in [&[0x32, 1, b'x'][..], &[0x20, 0], &[0x20, 0x81, 0x00]] {
            assert_eq!(signed([&encoded, other].concat(), &[]).unwrap_err().code, Code::Malformed);
        }
    }
}
