//! The attachment of each message, request and reply.
//!
//! ```text
//! | sequence number, 8 bytes, little endian | time, 8 bytes, little endian | 16 | identifier, 16 bytes |
//! ```
//! The 17th byte is the length of the identifier. The time is in nanoseconds since 1970.

/// Bytes of the identifier of an endpoint.
pub const GID_BYTES: usize = 16;
/// Bytes of an attachment.
pub const ATTACHMENT_BYTES: usize = 33;

/// The number, time and source of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attachment {
    /// The source's own count of its messages, from 1. That of a reply is its request's.
    pub sequence: i64,
    /// When it was sent, in nanoseconds since 1970 by the clock of the source.
    pub time: i64,
    /// The publisher or the client. A reply names the client that it is for.
    pub gid: [u8; GID_BYTES],
}

impl Attachment {
    /// The bytes as they travel.
    pub fn to_bytes(self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        let parts = self.sequence.to_le_bytes().into_iter().chain(self.time.to_le_bytes());
        let parts = parts.chain([LENGTH]).chain(self.gid);
        bytes.iter_mut().zip(parts).for_each(|(byte, part)| *byte = part);
        bytes
    }

    /// Reads them; none if they are too short, or the identifier has another length. Bytes behind it are for later versions.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk()?;
        let (time, rest) = rest.split_first_chunk()?;
        let (length, rest) = rest.split_first()?;
        let gid = *rest.first_chunk()?;
        let (sequence, time) = (i64::from_le_bytes(*sequence), i64::from_le_bytes(*time));
        (*length == LENGTH).then_some(Self { sequence, time, gid })
    }
}

/// The length of an identifier as a variable-length number.
const LENGTH: u8 = 16;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_bytes_are_those_of_rmw_zenoh() {
        let bytes = Attachment { sequence: 7, time: 0x0102_0304_0506_0708, gid: [0xab; 16] }.to_bytes();
        assert_eq!(bytes[..], [&[7, 0, 0, 0, 0, 0, 0, 0, 8, 7, 6, 5, 4, 3, 2, 1, 16][..], &[0xab; 16]].concat());
    }

    proptest! {
        #[test]
        fn it_comes_back_and_a_shorter_one_does_not(sequence: i64, time: i64, gid: [u8; 16], short in 0..ATTACHMENT_BYTES) {
            let attachment = Attachment { sequence, time, gid };
            let bytes = attachment.to_bytes();
            prop_assert_eq!(Attachment::parse(&bytes), Some(attachment));
            prop_assert_eq!(Attachment::parse(bytes.get(..short).unwrap_or_default()), None);
        }
    }
}
