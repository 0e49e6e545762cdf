//! The bytes of a reply on the ledger.
//!
//! ```text
//! 0              4                          36
//! +--------------+--------------------------+----------
//! | 00 01 00 00  | id of the request's      | CDR of the reply ...
//! |              | transaction              |
//! +--------------+--------------------------+----------
//! ```
//! The first four bytes are the encapsulation header of little endian CDR. The id is the SHA-256 of the signed request: nobody can
//! make another request with it. It has 32 bytes, so all numbers behind it keep their alignment.

use bytes::{BufMut, Bytes, BytesMut};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_gate::sample::{CDR_LE, Sample};

/// Bytes of a reply beside those of its message.
pub(in crate::routes) const REPLY_BYTES: usize = 32;

/// The reply to a request.
///
/// # Errors
/// As [`Sample::new`].
pub(in crate::routes) fn reply_to(request: Hash, message: &[u8]) -> Result<Sample, Rejection> {
    let mut body = BytesMut::with_capacity(REPLY_BYTES.saturating_add(message.len()));
    body.put_slice(&request.0);
    body.put_slice(message);
    Sample::new(CDR_LE, &body)
}

/// The request that a reply is for, and its message; none if it is no reply.
pub(in crate::routes) fn split(reply: &Sample) -> Option<(Hash, Bytes)> {
    let body = message_of(reply)?;
    let id = *body.first_chunk::<REPLY_BYTES>()?;
    Some((Hash(id), body.slice(REPLY_BYTES..)))
}

/// The CDR of a message without its header, if it is little endian.
pub(in crate::routes) fn message_of(sample: &Sample) -> Option<Bytes> {
    (sample.representation_id() == CDR_LE).then(|| sample.body())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::CDR_BE;

    #[test]
    fn the_format_of_a_reply_does_not_change() {
        let sample = reply_to(Hash([7; 32]), b"yes").unwrap();
        assert_eq!(sample.wire()[..], [&[0, 1, 0, 0][..], &[7; 32], b"yes"].concat());
        assert_eq!(split(&sample).unwrap(), (Hash([7; 32]), Bytes::from_static(b"yes")));
    }

    #[test]
    fn what_is_too_short_or_of_another_byte_order_is_no_reply() {
        for length in 0..REPLY_BYTES {
            assert_eq!(split(&Sample::new(CDR_LE, &vec![0; length]).unwrap()), None);
        }
        assert_eq!(split(&Sample::new(CDR_BE, &[0; 64]).unwrap()), None);
    }
}
