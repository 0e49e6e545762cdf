//! The one accepted encoding of an ECDSA P-256 signature.
//!
//! Of a valid pair (r, s), (r, n - s) is valid too, and lax DER readers accept many encodings of both. If more
//! than one were accepted, anybody could rewrite a signature in transit. So: strict DER, and s at most n/2.
//! The ring crate enforces neither low s nor produces it; hence these few lines.

/// Bytes of one of the two numbers.
const NUMBER_BYTES: usize = 32;

/// The order n of the group of P-256, big-endian.
const ORDER: [u8; NUMBER_BYTES] = [
    0xff, 0xff, 0xff, 0xff, 0x00, 0x00, 0x00, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xbc, 0xe6, 0xfa,
    0xad, 0xa7, 0x17, 0x9e, 0x84, 0xf3, 0xb9, 0xca, 0xc2, 0xfc, 0x63, 0x25, 0x51,
];

/// n/2, rounded down: the largest s that is accepted.
const HALF_ORDER: [u8; NUMBER_BYTES] = [
    0x7f, 0xff, 0xff, 0xff, 0x80, 0x00, 0x00, 0x00, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xde, 0x73, 0x7d,
    0x56, 0xd3, 0x8b, 0xcf, 0x42, 0x79, 0xdc, 0xe5, 0x61, 0x7e, 0x31, 0x92, 0xa8,
];

const SEQUENCE: u8 = 0x30;
const INTEGER: u8 = 0x02;

/// Encodes r and s (64 bytes, as ring returns them) in DER, with s made low. `None` if they are not 64 bytes.
pub(super) fn encode(r_and_s: &[u8]) -> Option<Vec<u8>> {
    let (r, s) = r_and_s.split_first_chunk::<NUMBER_BYTES>()?;
    let s: &[u8; NUMBER_BYTES] = s.try_into().ok()?;
    let s = if *s > HALF_ORDER { negate(s) } else { *s };
    let mut content = Vec::with_capacity(72);
    push_integer(&mut content, r);
    push_integer(&mut content, &s);
    // Two numbers of at most 35 encoded bytes: the length always fits one byte below 128.
    let length = u8::try_from(content.len()).ok().filter(|length| *length < 0x80)?;
    Some([&[SEQUENCE, length], content.as_slice()].concat())
}

/// Decodes strict DER into the 64 bytes of r and s, and says whether s is low. `None` if it is not strict.
pub(super) fn decode(der: &[u8]) -> Option<([u8; 2 * NUMBER_BYTES], bool)> {
    let [SEQUENCE, length, content @ ..] = der else { return None };
    if *length >= 0x80 || usize::from(*length) != content.len() {
        return None;
    }
    let (r, rest) = integer(content)?;
    let (s, rest) = integer(rest)?;
    if !rest.is_empty() {
        return None;
    }
    let mut both = [0; 2 * NUMBER_BYTES];
    for (to, from) in both.iter_mut().zip(r.iter().chain(&s)) {
        *to = *from;
    }
    Some((both, s <= HALF_ORDER))
}

/// n - s, for 0 < s < n.
fn negate(s: &[u8; NUMBER_BYTES]) -> [u8; NUMBER_BYTES] {
    let mut result = [0; NUMBER_BYTES];
    let mut borrow = false;
    for ((to, n), s) in result.iter_mut().zip(&ORDER).zip(s).rev() {
        let (difference, first) = n.overflowing_sub(*s);
        let (difference, second) = difference.overflowing_sub(u8::from(borrow));
        *to = difference;
        borrow = first || second;
    }
    result
}

fn push_integer(to: &mut Vec<u8>, number: &[u8; NUMBER_BYTES]) {
    let start = number.iter().position(|byte| *byte != 0).unwrap_or(NUMBER_BYTES);
    let digits = number.get(start..).unwrap_or_default();
    // A leading one bit would read as a negative number.
    let padding: &[u8] = if digits.first().is_none_or(|first| *first >= 0x80) { &[0] } else { &[] };
    to.push(INTEGER);
    to.push(u8::try_from(padding.len() + digits.len()).unwrap_or(u8::MAX));
    to.extend_from_slice(padding);
    to.extend_from_slice(digits);
}

/// Reads one INTEGER greater than zero, in its shortest form, of at most 32 bytes.
fn integer(bytes: &[u8]) -> Option<([u8; NUMBER_BYTES], &[u8])> {
    let [INTEGER, length, rest @ ..] = bytes else { return None };
    let (value, rest) = rest.split_at_checked(usize::from(*length))?;
    let digits = match value {
        // The padding byte is due exactly when the number would read as negative without it.
        [0, digits @ ..] if digits.first().is_some_and(|first| *first >= 0x80) => digits,
        [first, ..] if (0x01..0x80).contains(first) => value,
        _ => return None,
    };
    let mut number = [0; NUMBER_BYTES];
    let start = NUMBER_BYTES.checked_sub(digits.len())?;
    for (to, from) in number.get_mut(start..)?.iter_mut().zip(digits) {
        *to = *from;
    }
    Some((number, rest))
}
