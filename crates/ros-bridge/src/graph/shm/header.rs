//! The user header of each sample; the top of [`super`] has its format.

use crate::graph::mark::Mark;

const HEADER_BYTES: usize = 32;
/// The header as it travels.
pub(super) type Header = [u8; HEADER_BYTES];

pub(super) fn encode_header(origin: [u8; 16], sequence: u64, mark: Option<Mark>) -> Header {
    let mut header = [0; HEADER_BYTES];
    let mark = mark.map_or(0, Mark::nanos);
    let bytes = origin.into_iter().chain(sequence.to_le_bytes()).chain(mark.to_le_bytes());
    header.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    header
}

pub(super) fn decode_header(header: &Header) -> ([u8; 16], u64, Option<Mark>) {
    let origin = header.first_chunk().copied().unwrap_or_default();
    let number = |at: usize| {
        let bytes = header.get(at..).and_then(|rest| rest.first_chunk()).copied();
        bytes.map_or(0, u64::from_le_bytes)
    };
    (origin, number(16), Mark::from_nanos(number(24)))
}
