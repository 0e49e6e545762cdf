//! GUIDs of endpoints.

use rustdds::GUID;

/// Bytes of a GUID that all endpoints of a participant share.
pub(super) const PREFIX_BYTES: usize = 12;

/// The part of a GUID that all endpoints of a participant share.
pub(super) fn prefix(guid: GUID) -> [u8; PREFIX_BYTES] {
    let mut prefix = [0; PREFIX_BYTES];
    prefix.iter_mut().zip(guid.to_bytes()).for_each(|(to, from)| *to = from);
    prefix
}
