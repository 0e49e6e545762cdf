//! The parts of a public key as certificates hold it (SubjectPublicKeyInfo), and its name for people.

use crate::der::{Element, SEQUENCE, identifier_text};

const RSA: &[u8] = &[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x01];
const ELLIPTIC_CURVE: &[u8] = &[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01];

/// Contents of object identifiers of keys and curves, and their names.
const KEYS: [(&[u8], &str); 10] = [
    (RSA, "RSA"),
    (&[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x01, 0x0a], "RSA for PSS alone"),
    (&[0x2b, 0x65, 0x70], "Ed25519"),
    (&[0x2b, 0x65, 0x71], "Ed448"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x38, 0x04, 0x01], "DSA"),
    (&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x03, 0x01, 0x07], "P-256"),
    (&[0x2b, 0x81, 0x04, 0x00, 0x22], "P-384"),
    (&[0x2b, 0x81, 0x04, 0x00, 0x23], "P-521"),
    (&[0x2b, 0x81, 0x04, 0x00, 0x0a], "secp256k1"),
    (&[0x2b, 0x81, 0x04, 0x00, 0x21], "P-224"),
];

/// A key (SubjectPublicKeyInfo in DER) in words.
pub(crate) fn key_text(key: &[u8]) -> String {
    if let Some(bits) = rsa_bits(key) {
        return format!("an RSA key of {bits} bits");
    }
    let Some((kind, bytes)) = key_parts(key) else { return "a key that cannot be read".into() };
    let identifiers = Element::all(kind).unwrap_or_default();
    let identifier = identifiers.first().map_or(&[][..], |element| element.content);
    if identifier != ELLIPTIC_CURVE {
        return format!("a key of {}", named(&KEYS, identifier));
    }
    let curve = named(&KEYS, identifiers.get(1).map_or(&[][..], |element| element.content));
    let form = if bytes.first() == Some(&0x04) { "" } else { " as a compressed point" };
    format!("a key of ECDSA on {curve}{form}")
}

/// The AlgorithmIdentifier (its content) and the bytes of a key.
pub(crate) fn key_parts(key: &[u8]) -> Option<(&[u8], &[u8])> {
    let parts = Element::inside(key, SEQUENCE)?;
    let [kind, bits] = parts.as_slice() else { return None };
    let [0, bytes @ ..] = bits.content else { return None };
    Some((kind.content, bytes))
}

/// The length of an RSA key; none for other keys.
pub(crate) fn rsa_bits(key: &[u8]) -> Option<usize> {
    let (kind, bytes) = key_parts(key)?;
    if Element::first(kind)?.0.content != RSA {
        return None;
    }
    let numbers = Element::inside(bytes, SEQUENCE)?;
    let modulus = numbers.first()?.content;
    let start = modulus.iter().position(|byte| *byte != 0)?;
    let (first, rest) = modulus.get(start..)?.split_first()?;
    Some(rest.len() * 8 + 8 - usize::try_from(first.leading_zeros()).ok()?)
}

/// The name of an object identifier (its content), or its numbers.
pub(crate) fn named(table: &[(&[u8], &str)], identifier: &[u8]) -> String {
    match table.iter().find(|(known, _)| *known == identifier) {
        Some((_, name)) => (*name).to_owned(),
        None => format!("the algorithm {}", identifier_text(identifier)),
    }
}
