//! A whole sample, and what is delivered of it.

use crate::endpoint::{Delivered, DisposedKey};
use crate::guid::{Guid, SequenceNumber};
use crate::interface::IncomingSample;
use crate::time::Ticks;
use crate::wire::submessage::{InlineQos, Payload};
use bytes::Bytes;

/// Bytes that a sample counts beyond its payload: a map may be half empty, and a payload has a head of its own.
pub(super) const SAMPLE_OVERHEAD: usize = 384;
const _: () = assert!(SAMPLE_OVERHEAD >= size_of::<(i64, Content)>() * 11 / 5 + 64);

/// A whole sample.
#[derive(Clone, Debug)]
pub(super) struct Content {
    pub(super) timestamp: Option<Ticks>,
    pub(super) inline_qos: InlineQos,
    pub(super) payload: Payload,
}

impl Content {
    pub(super) fn deliver(self, writer: Guid, number: i64, out: &mut Vec<Delivered>) {
        let InlineQos { related, status, key_hash } = self.inline_qos;
        match self.payload {
            Payload::Data(key) | Payload::Key(key) if status != 0 => {
                out.push(Delivered::Disposed { writer, key: DisposedKey::Serialized(key) });
            }
            Payload::None if status != 0 => {
                out.push(Delivered::Disposed { writer, key: key_hash.map_or(DisposedKey::Unknown, DisposedKey::Hash) });
            }
            Payload::Data(payload) => out.push(Delivered::Sample(IncomingSample {
                writer,
                sequence: SequenceNumber(number),
                timestamp: self.timestamp,
                related,
                payload,
            })),
            Payload::None | Payload::Key(_) => {}
        }
    }

    /// With memory of its own: a small payload would keep the whole datagram.
    pub(super) fn detached(self) -> Self {
        let payload = match self.payload {
            Payload::None => Payload::None,
            Payload::Data(bytes) => Payload::Data(Bytes::copy_from_slice(&bytes)),
            Payload::Key(bytes) => Payload::Key(Bytes::copy_from_slice(&bytes)),
        };
        Self { payload, ..self }
    }

    pub(super) fn bytes(&self) -> usize {
        match &self.payload {
            Payload::None => SAMPLE_OVERHEAD,
            Payload::Data(bytes) | Payload::Key(bytes) => SAMPLE_OVERHEAD.saturating_add(bytes.len()),
        }
    }
}
