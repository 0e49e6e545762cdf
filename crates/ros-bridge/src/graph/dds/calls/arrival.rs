//! A message that comes in at a server or a client.

use bytes::Bytes;
use rtps::guid::{Guid, SampleIdentity, SequenceNumber};

/// The side of a service that the two ends serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Server,
    Client,
}

impl Side {
    /// The key under which `rmw_cyclonedds` announces that both ends are one.
    pub(super) fn key(self) -> &'static str {
        match self {
            Self::Server => "serviceid",
            Self::Client => "clientid",
        }
    }
}

/// A message that came in.
pub(super) struct Arrival {
    /// The message, little endian.
    pub(super) message: Bytes,
    pub(super) writer: Guid,
    pub(super) sequence: SequenceNumber,
    /// The request to which it is related, as it says.
    pub(super) related: Option<SampleIdentity>,
}
