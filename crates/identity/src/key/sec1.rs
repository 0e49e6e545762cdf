//! Private keys as SEC1 writes them (RFC 5915), in the form PKCS#8 that is read here.

/// The algorithm of a key of P-256 in PKCS#8: id-ecPublicKey with the curve.
const P256: &[u8] = &[
    0x30, 0x13, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x08, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x03,
    0x01, 0x07,
];

/// The same for P-384.
const P384: &[u8] =
    &[0x30, 0x10, 0x06, 0x07, 0x2a, 0x86, 0x48, 0xce, 0x3d, 0x02, 0x01, 0x06, 0x05, 0x2b, 0x81, 0x04, 0x00, 0x22];

const INTEGER_ZERO: &[u8] = &[0x02, 0x01, 0x00];
const SEQUENCE: u8 = 0x30;
const OCTET_STRING: u8 = 0x04;

/// The key in PKCS#8, once for each curve that it may be of, because a SEC1 key need not name its curve. The reader refuses a
/// key of the wrong one.
pub(super) fn as_pkcs8(sec1: &[u8]) -> Vec<Vec<u8>> {
    let wrapped = |curve: &[u8]| {
        let key = tagged(OCTET_STRING, sec1)?;
        tagged(SEQUENCE, &[INTEGER_ZERO, curve, &key].concat())
    };
    [P256, P384].into_iter().filter_map(wrapped).collect()
}

/// A value in DER; none if it is longer than any key.
fn tagged(tag: u8, content: &[u8]) -> Option<Vec<u8>> {
    let length = u16::try_from(content.len()).ok()?.to_be_bytes();
    let head = match length {
        [0, short] if short < 0x80 => vec![tag, short],
        [0, one] => vec![tag, 0x81, one],
        [high, low] => vec![tag, 0x82, high, low],
    };
    Some([&head, content].concat())
}
