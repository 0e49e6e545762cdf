//! How the middlewares of ROS 2 tell to which request a reply belongs.
//!
//! - **In front of the message** (CycloneDDS, `rmw_cyclonedds`): request and reply begin with 16 bytes, a number of the client
//!   and a number of the request. Every client gets every reply, and takes its own.
//! - **Next to the message** (Fast DDS, `rmw_fastrtps`, and others): a reply names writer and sequence number of its request in a
//!   parameter of the RTPS message. A request may name the reader of its replies there: then that one is named in the
//!   reply instead of the writer.
//!
//! Which of both a peer means is known by its DDS: the first two bytes of a GUID are the number of the vendor.

use bytes::{BufMut, Bytes, BytesMut};
use rtps::guid::{Guid, SampleIdentity, VendorId};

/// Bytes in front of a message of CycloneDDS.
const HEADER_BYTES: usize = 16;

/// The way in which a peer relates replies to requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Mapping {
    InFront,
    NearbyEndpoint,
}

impl Mapping {
    /// That of the peer with this endpoint.
    pub(super) fn of(endpoint: Guid) -> Self {
        if endpoint.prefix.0.starts_with(&VendorId::CYCLONE.0) { Self::InFront } else { Self::NearbyEndpoint }
    }
}

/// A client that has called, and the request as it knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// The writer of the request.
    pub(super) writer: Guid,
    pub(super) request: Named,
}

/// The request that a reply is for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Named {
    /// The reply has this in front.
    InFront(Header),
    /// The reply names this beside it.
    NearbyEndpoint(SampleIdentity),
}

/// The bytes in front of a message: little endian, as all that is taken in here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    /// The number of the client.
    pub(super) client: u64,
    /// The client's number of the request.
    pub(super) number: i64,
}

impl Header {
    /// The header in front of a message, and the rest.
    pub(super) fn split(message: &Bytes) -> Option<(Self, Bytes)> {
        let (header, _) = message.split_at_checked(HEADER_BYTES)?;
        let (client, number) = header.split_first_chunk::<8>()?;
        let header = Self { client: u64::from_le_bytes(*client), number: i64::from_le_bytes(*number.first_chunk()?) };
        Some((header, message.slice(HEADER_BYTES..)))
    }

    /// A message with this in front.
    pub(super) fn before(self, message: &[u8]) -> Bytes {
        let mut whole = BytesMut::with_capacity(HEADER_BYTES.saturating_add(message.len()));
        whole.put_u64_le(self.client);
        whole.put_i64_le(self.number);
        whole.put_slice(message);
        whole.freeze()
    }
}

/// The name of the client in a request's parameter, if there is one: else its writer is it.
pub(super) fn named(related: Option<SampleIdentity>) -> Option<Guid> {
    related.map(|related| related.writer).filter(|named| *named != Guid::default())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_vendor_tells_the_mapping() {
        let mut guid = [0; 16];
        for (vendor, mapping) in [
            (VendorId::CYCLONE, Mapping::InFront),
            (VendorId::FAST_DDS, Mapping::NearbyEndpoint),
            (VendorId::RUST_DDS, Mapping::NearbyEndpoint),
        ] {
            guid[..2].copy_from_slice(&vendor.0);
            assert_eq!(Mapping::of(Guid::from_bytes(guid)), mapping);
        }
    }

    #[test]
    fn a_header_comes_back_and_the_message_with_it() {
        let header = Header { client: u64::MAX - 1, number: 7 };
        let whole = header.before(b"abc");
        assert_eq!(whole.len(), HEADER_BYTES + 3);
        assert_eq!(Header::split(&whole).unwrap(), (header, Bytes::from_static(b"abc")));
        for short in 0..HEADER_BYTES {
            assert_eq!(Header::split(&whole.slice(..short)), None);
        }
    }
}
