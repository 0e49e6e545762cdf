//! The one accepted encoding of an ECDSA signature, for P-256 and P-384.
//!
//! Of a valid pair (r, s), (r, n - s) is valid too, and lax DER readers accept many encodings of both. If more
//! than one were accepted, anybody could rewrite a signature in transit. So: strict DER, and s at most n/2.
//! The ring crate enforces neither low s nor produces it; hence these few lines.

/// A group of points with numbers of `N` bytes.
pub(super) struct Curve<const N: usize> {
    /// The order n of the group, big-endian.
    order: [u8; N],
    /// n/2, rounded down: the largest s that is accepted.
    half: [u8; N],
}

/// The group of P-256.
pub(super) const P256: Curve<32> = Curve {
    order: [
        0xff, 0xff, 0xff, 0xff, 0x00, 0x00, 0x00, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xbc, 0xe6,
        0xfa, 0xad, 0xa7, 0x17, 0x9e, 0x84, 0xf3, 0xb9, 0xca, 0xc2, 0xfc, 0x63, 0x25, 0x51,
    ],
    half: [
        0x7f, 0xff, 0xff, 0xff, 0x80, 0x00, 0x00, 0x00, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xde, 0x73,
        0x7d, 0x56, 0xd3, 0x8b, 0xcf, 0x42, 0x79, 0xdc, 0xe5, 0x61, 0x7e, 0x31, 0x92, 0xa8,
    ],
};

/// The group of P-384.
pub(super) const P384: Curve<48> = Curve {
    order: [
        0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
        0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xc7, 0x63, 0x4d, 0x81, 0xf4, 0x37, 0x2d, 0xdf, 0x58, 0x1a, 0x0d, 0xb2,
        0x48, 0xb0, 0xa7, 0x7a, 0xec, 0xec, 0x19, 0x6a, 0xcc, 0xc5, 0x29, 0x73,
    ],
    half: [
        0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
        0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xe3, 0xb1, 0xa6, 0xc0, 0xfa, 0x1b, 0x96, 0xef, 0xac, 0x0d, 0x06, 0xd9,
        0x24, 0x58, 0x53, 0xbd, 0x76, 0x76, 0x0c, 0xb5, 0x66, 0x62, 0x94, 0xb9,
    ],
};

const SEQUENCE: u8 = 0x30;
const INTEGER: u8 = 0x02;

impl<const N: usize> Curve<N> {
    /// Encodes r and s (2 N bytes, as ring returns them) in DER, with s made low. `None` if they have another length.
    pub(super) fn encode(&self, r_and_s: &[u8]) -> Option<Vec<u8>> {
        let (r, s) = r_and_s.split_first_chunk::<N>()?;
        let s: &[u8; N] = s.try_into().ok()?;
        let s = if *s > self.half { self.negate(s) } else { *s };
        let mut content = Vec::with_capacity(2 * (N + 3));
        push_integer(&mut content, r);
        push_integer(&mut content, &s);
        // Two numbers of at most 51 encoded bytes: the length always fits one byte below 128.
        let length = u8::try_from(content.len()).ok().filter(|length| *length < 0x80)?;
        Some([&[SEQUENCE, length], content.as_slice()].concat())
    }

    /// Decodes strict DER into the 2 N bytes of r and s, and says whether s is low. `None` if it is not strict.
    pub(super) fn decode(&self, der: &[u8]) -> Option<(Vec<u8>, bool)> {
        let [SEQUENCE, length, content @ ..] = der else { return None };
        if *length >= 0x80 || usize::from(*length) != content.len() {
            return None;
        }
        let (r, rest) = integer::<N>(content)?;
        let (s, rest) = integer::<N>(rest)?;
        if !rest.is_empty() {
            return None;
        }
        Some(([r, s].concat(), s <= self.half))
    }

    /// n - s, for 0 < s < n.
    fn negate(&self, s: &[u8; N]) -> [u8; N] {
        let mut result = [0; N];
        let mut borrow = false;
        for ((to, n), s) in result.iter_mut().zip(&self.order).zip(s).rev() {
            let (difference, first) = n.overflowing_sub(*s);
            let (difference, second) = difference.overflowing_sub(u8::from(borrow));
            *to = difference;
            borrow = first || second;
        }
        result
    }
}

fn push_integer(to: &mut Vec<u8>, number: &[u8]) {
    let start = number.iter().position(|byte| *byte != 0).unwrap_or(number.len());
    let digits = number.get(start..).unwrap_or_default();
    // A leading one bit would read as a negative number.
    let padding: &[u8] = if digits.first().is_none_or(|first| *first >= 0x80) { &[0] } else { &[] };
    to.push(INTEGER);
    to.push(u8::try_from(padding.len() + digits.len()).unwrap_or(u8::MAX));
    to.extend_from_slice(padding);
    to.extend_from_slice(digits);
}

/// Reads one INTEGER greater than zero, in its shortest form, of at most N bytes.
fn integer<const N: usize>(bytes: &[u8]) -> Option<([u8; N], &[u8])> {
    let [INTEGER, length, rest @ ..] = bytes else { return None };
    let (value, rest) = rest.split_at_checked(usize::from(*length))?;
    let digits = match value {
        // The padding byte is due exactly when the number would read as negative without it.
        [0, digits @ ..] if digits.first().is_some_and(|first| *first >= 0x80) => digits,
        [first, ..] if (0x01..0x80).contains(first) => value,
        _ => return None,
    };
    let mut number = [0; N];
    let start = N.checked_sub(digits.len())?;
    for (to, from) in number.get_mut(start..)?.iter_mut().zip(digits) {
        *to = *from;
    }
    Some((number, rest))
}
