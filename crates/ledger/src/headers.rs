//! The bytes of headers that follow each other, in evidence and in the part of a branch that a node shows to others.

use crate::block::Header;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_light::BranchLink;
use ledger_light::codec::Reader;
use ledger_light::digest::LATER_MAX;

/// Most headers in one encoding.
pub const HEADERS_MAX: usize = LATER_MAX;
/// Longest encoding.
pub(crate) const HEADERS_BYTES_MAX: usize = 8 + 32 + 4 + HEADERS_MAX * BranchLink::BYTES;

/// Appends headers: height and predecessor of the first one, their number, and of each what these do not give.
pub(crate) fn write_headers(bytes: &mut Vec<u8>, headers: &[Header]) {
    let (height, previous) = headers.first().map_or((0, Hash::ZERO), |first| (first.height, first.previous));
    bytes.extend_from_slice(&height.to_be_bytes());
    bytes.extend_from_slice(&previous.0);
    bytes.extend_from_slice(&(headers.len() as u32).to_be_bytes());
    for Header { term, time, root, .. } in headers {
        BranchLink { term: *term, time: *time, root: *root }.write(bytes);
    }
}

/// Reads headers. Each follows the one before.
///
/// # Errors
/// [`Code::Malformed`](ledger_base::rejection::Code::Malformed).
pub(crate) fn read_headers(reader: &mut Reader<'_>) -> Result<Vec<Header>, Rejection> {
    let (mut height, mut previous, count) = (reader.u64()?, reader.hash()?, reader.u32()? as usize);
    if count > HEADERS_MAX {
        return Err(reader.malformed(&format!("{count} headers"), &format!("at most {HEADERS_MAX}")));
    }
    if count == 0 && (height, previous) != (0, Hash::ZERO) {
        return Err(reader.malformed("a place without headers", "height 0 and a hash of zeros"));
    }
    let mut headers = Vec::new();
    for _ in 0..count {
        let BranchLink { term, time, root } = BranchLink::read(reader)?;
        let header = Header { height, term, time, previous, root };
        (height, previous) = (height.saturating_add(1), header.hash());
        headers.push(header);
    }
    Ok(headers)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn headers_have_one_encoding_and_each_follows_the_one_before() {
        let first = Header { height: 7, term: 3, time: 10, previous: Hash([1; 32]), root: Hash([2; 32]) };
        let last = Header { height: 8, term: 4, time: 11, previous: first.hash(), root: Hash([3; 32]) };
        for headers in [Vec::new(), vec![first.clone()], vec![first, last]] {
            let mut bytes = Vec::new();
            write_headers(&mut bytes, &headers);
            let mut reader = Reader::new("headers", HEADERS_BYTES_MAX, &[], &bytes).unwrap();
            assert_eq!(read_headers(&mut reader).unwrap(), headers);
            reader.end().unwrap();
        }
        let place = [&7_u64.to_be_bytes()[..], &[1; 32]].concat();
        for count in [0, HEADERS_MAX as u32 + 1, 1] {
            let bytes = [&place[..], &count.to_be_bytes()].concat();
            assert!(read_headers(&mut Reader::new("headers", bytes.len(), &[], &bytes).unwrap()).is_err());
        }
    }
}
