//! Ed25519 as ZIP 215 checks it: by an equation that allows many signatures to be checked at once, at a third of what
//! each costs alone, with the same answer.
//!
//! RFC 8032 leaves open which of two equations a verifier checks. The stricter one, which ring has, cannot be checked
//! for many signatures at once. Somebody could make signatures whose verdict depends on what else a node checks with
//! them, and nodes would disagree. The rules of ZIP 215 leave nothing open. An ordinary signature of a key verifies
//! under either.

use chacha20::ChaCha20Rng;
use chacha20::rand_core::SeedableRng;
use ed25519_zebra::batch::Verifier;
use ed25519_zebra::{Signature, VerificationKey, VerificationKeyBytes};
use ledger_base::hash::Hash;

/// Bytes of a public key.
pub(super) const KEY_BYTES: usize = 32;
/// Bytes of a signature.
pub(super) const SIGNATURE_BYTES: usize = 64;

/// A public key as it is calculated with. To find its point on the curve takes an eighth of a verification.
pub(super) type Point = VerificationKey;

/// The point of a key; none if there is no such point, and so no signature by this key.
pub(super) fn point(key: [u8; KEY_BYTES]) -> Option<Point> {
    Point::try_from(key).ok()
}

/// Is it the signature of this message by this key?
pub(super) fn verify(key: &Point, message: &[u8], signature: [u8; SIGNATURE_BYTES]) -> bool {
    key.verify(&Signature::from(signature), message).is_ok()
}

/// Does the key say nothing about who signed? Such a key is of small order: one signature fits every message.
pub(super) fn is_weak(key: &Point) -> bool {
    // The neutral element of the curve and the number zero: 8 k A = 0, whatever the message makes of k.
    let mut anybodys = [0; SIGNATURE_BYTES];
    anybodys[0] = 1;
    verify(key, &[], anybodys)
}

/// Is each of them the signature of its message by its key? Answers as [`verify`] would for all of them.
pub(super) fn verify_together<'a>(signed: impl Iterator<Item = (&'a Point, &'a [u8], [u8; SIGNATURE_BYTES])>) -> bool {
    let (mut verifier, mut seed) = (Verifier::new(), Hash::ZERO);
    for (key, message, signature) in signed {
        let key = VerificationKeyBytes::from(*key);
        seed = Hash::of(&[&seed.0, key.as_ref(), &signature, &Hash::of(&[message]).0]);
        verifier.queue((key, Signature::from(signature), message));
    }
    // Numbers weigh the signatures, so that errors in them cannot cancel each other out. They follow from all that is
    // checked: nobody who makes a signature can know them, and nothing is left to chance.
    verifier.verify(ChaCha20Rng::from_seed(seed.0)).is_ok()
}
