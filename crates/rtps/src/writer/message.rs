//! Samples as submessages, and for whom they are.

use super::history::Sample;
use crate::endpoint::{Outgoing, Peer};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::wire::submessage::{Data, DataFrag, Payload, Submessage};
use std::net::SocketAddrV4;

/// For whom a message is.
#[derive(Clone, Debug, Default)]
pub(super) struct Audience {
    to: Vec<SocketAddrV4>,
    destination: Option<GuidPrefix>,
    reader: Option<EntityId>,
}

impl Audience {
    /// These readers. Several are addressed as "all that match": each address gets one copy, whatever the number of readers there.
    pub(super) fn of<'a>(readers: impl Iterator<Item = &'a Peer>) -> Self {
        let mut audience = Self::default();
        for reader in readers {
            for address in &reader.unicast {
                if !audience.to.contains(address) {
                    audience.to.push(*address);
                }
            }
            let Guid { prefix, entity } = reader.guid;
            audience.reader = Some(audience.reader.map_or(entity, |_| EntityId::UNKNOWN));
            audience.destination = match audience.destination {
                Some(other) if other != prefix => Some(GuidPrefix::UNKNOWN),
                _ => Some(prefix),
            };
        }
        audience
    }

    pub(super) fn is_empty(&self) -> bool {
        self.to.is_empty()
    }

    /// The reader as submessages name it.
    pub(super) fn reader(&self) -> EntityId {
        self.reader.unwrap_or(EntityId::UNKNOWN)
    }

    /// Submessages for it, with the time of the sample in them.
    pub(super) fn message(&self, sample: Option<&Sample>, submessages: Vec<Submessage>) -> Outgoing {
        Outgoing {
            to: self.to.clone(),
            destination: self.destination.unwrap_or(GuidPrefix::UNKNOWN),
            timestamp: sample.and_then(|sample| sample.timestamp),
            submessages,
        }
    }
}

/// How many fragments of this size the sample has; 1 if it fits into one DATA.
pub(super) fn fragments_of(sample: &Sample, fragment_bytes: u16) -> u32 {
    let bytes = sample.content().map_or(0, bytes::Bytes::len);
    let fragments = bytes.div_ceil(usize::from(fragment_bytes).max(1)).max(1);
    u32::try_from(fragments).unwrap_or(u32::MAX)
}

/// One fragment of a sample (they count from 1), or the sample itself if it has only one. None if there is no such fragment.
///
/// Every fragment carries the inline QoS: Fast DDS takes it from the fragment that comes first, CycloneDDS from the first of the
/// sample. Payloads share the memory of the sample.
pub(super) fn submessage(
    sample: &Sample,
    writer: EntityId,
    reader: EntityId,
    fragment_bytes: u16,
    number: u32,
) -> Option<Submessage> {
    let count = fragments_of(sample, fragment_bytes);
    if number == 0 || number > count {
        return None;
    }
    let (sequence, inline_qos) = (SequenceNumber(sample.sequence), sample.inline_qos.clone());
    let content = match sample.content() {
        Some(content) if count > 1 => content,
        _ => {
            let payload = sample.payload.clone();
            return Some(Submessage::Data(Data { reader, writer, sequence, inline_qos, payload }));
        }
    };
    let from = usize::try_from(number - 1).ok()?.checked_mul(usize::from(fragment_bytes))?;
    let to = from.checked_add(usize::from(fragment_bytes))?.min(content.len());
    Some(Submessage::DataFrag(DataFrag {
        reader,
        writer,
        sequence,
        first: number,
        count: 1,
        fragment_bytes,
        sample_bytes: u32::try_from(content.len()).ok()?,
        inline_qos,
        is_key: matches!(sample.payload, Payload::Key(_)),
        payload: content.slice(from..to),
    }))
}

/// Bytes of the payload of a submessage, with what its headers add about.
pub(super) fn bytes_of(submessage: &Submessage) -> usize {
    const HEADERS: usize = 64;
    HEADERS
        + match submessage {
            Submessage::DataFrag(fragment) => fragment.payload.len(),
            Submessage::Data(Data { payload: Payload::Data(bytes) | Payload::Key(bytes), .. }) => bytes.len(),
            _ => 0,
        }
}
