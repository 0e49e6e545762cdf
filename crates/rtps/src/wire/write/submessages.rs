//! Writes submessages (§9.4.5).

use crate::guid::{EntityId, SampleIdentity, SequenceNumber};
use crate::wire::encoder::Encoder;
use crate::wire::format::{DATA_FRAG_TO_INLINE_QOS, DATA_TO_INLINE_QOS, flag, kind};
use crate::wire::number_set::bitmap_words;
use crate::wire::parameters::{PARAMETER_HEADER_BYTES, ParameterWriter};
use crate::wire::pid;
use crate::wire::submessage::{Data, DataFrag, InlineQos, NumberSet, Payload, Submessage};

/// Bytes of the identifiers of a reader and a writer.
const ENTITIES_BYTES: usize = 8;
/// Bytes of a sequence number.
const SEQUENCE_BYTES: usize = 8;
/// Bytes of a count, and of the number of a fragment.
const COUNT_BYTES: usize = 4;
/// Bytes of extra flags and `octetsToInlineQos`.
const DATA_HEAD_BYTES: usize = 4;

impl Submessage {
    pub(super) fn kind_and_flags(&self) -> (u8, u8) {
        let set = |condition: bool, flag: u8| if condition { flag } else { 0 };
        match self {
            Self::Data(data) => (kind::DATA, data.inline_qos.flag() | data.payload.flag()),
            Self::DataFrag(data) => (kind::DATA_FRAG, data.inline_qos.flag() | set(data.is_key, flag::FRAGMENT_OF_KEY)),
            Self::Heartbeat(heartbeat) => {
                (kind::HEARTBEAT, set(heartbeat.is_final, flag::FINAL) | set(heartbeat.is_alive, flag::ALIVE))
            }
            Self::HeartbeatFrag(_) => (kind::HEARTBEAT_FRAG, 0),
            Self::AckNack(acknack) => (kind::ACKNACK, set(acknack.is_final, flag::FINAL)),
            Self::NackFrag(_) => (kind::NACK_FRAG, 0),
            Self::Gap(_) => (kind::GAP, 0),
        }
    }

    /// Bytes that [`Self::write_body`] appends.
    pub(super) fn body_bytes(&self) -> usize {
        let rest = match self {
            Self::Data(data) => {
                DATA_HEAD_BYTES + SEQUENCE_BYTES + data.inline_qos.list_bytes() + data.payload.content().len()
            }
            Self::DataFrag(data) => {
                let fragment_head = COUNT_BYTES + 2 + 2 + 4;
                DATA_HEAD_BYTES + SEQUENCE_BYTES + fragment_head + data.inline_qos.list_bytes() + data.payload.len()
            }
            Self::Heartbeat(_) => 2 * SEQUENCE_BYTES + COUNT_BYTES,
            Self::HeartbeatFrag(_) => SEQUENCE_BYTES + 2 * COUNT_BYTES,
            Self::AckNack(acknack) => SEQUENCE_BYTES + bitmap_bytes(&acknack.missing) + COUNT_BYTES,
            Self::NackFrag(nack) => SEQUENCE_BYTES + COUNT_BYTES + bitmap_bytes(&nack.missing) + COUNT_BYTES,
            Self::Gap(gap) => 2 * SEQUENCE_BYTES + bitmap_bytes(&gap.list),
        };
        ENTITIES_BYTES + rest
    }

    pub(super) fn write_body(&self, encoder: &mut Encoder) {
        match self {
            Self::Data(data) => write_data(data, encoder),
            Self::DataFrag(data) => write_data_frag(data, encoder),
            Self::Heartbeat(heartbeat) => {
                entities(heartbeat.reader, heartbeat.writer, encoder);
                encoder.sequence(heartbeat.first);
                encoder.sequence(heartbeat.last);
                encoder.i32(heartbeat.count);
            }
            Self::HeartbeatFrag(heartbeat) => {
                entities(heartbeat.reader, heartbeat.writer, encoder);
                encoder.sequence(heartbeat.sequence);
                encoder.u32(heartbeat.last);
                encoder.i32(heartbeat.count);
            }
            Self::AckNack(acknack) => {
                entities(acknack.reader, acknack.writer, encoder);
                sequence_set(&acknack.missing, encoder);
                encoder.i32(acknack.count);
            }
            Self::NackFrag(nack) => {
                entities(nack.reader, nack.writer, encoder);
                encoder.sequence(nack.sequence);
                // A base beyond the numbers of fragments is no set of fragments; it becomes the invalid base 0.
                encoder.u32(u32::try_from(nack.missing.base).unwrap_or(0));
                bitmap(&nack.missing, encoder);
                encoder.i32(nack.count);
            }
            Self::Gap(gap) => {
                entities(gap.reader, gap.writer, encoder);
                encoder.sequence(gap.start);
                sequence_set(&gap.list, encoder);
            }
        }
    }
}

fn entities(reader: EntityId, writer: EntityId, encoder: &mut Encoder) {
    encoder.entity(reader);
    encoder.entity(writer);
}

fn sequence_set(set: &NumberSet, encoder: &mut Encoder) {
    encoder.sequence(SequenceNumber(set.base));
    bitmap(set, encoder);
}

fn bitmap(set: &NumberSet, encoder: &mut Encoder) {
    encoder.u32(set.bits);
    set.bitmap.iter().take(bitmap_words(set.bits)).for_each(|word| encoder.u32(*word));
}

/// Bytes of the length and the words of a bitmap.
fn bitmap_bytes(set: &NumberSet) -> usize {
    4 + 4 * bitmap_words(set.bits)
}

fn write_data(data: &Data, encoder: &mut Encoder) {
    encoder.u16(0);
    encoder.u16(DATA_TO_INLINE_QOS);
    entities(data.reader, data.writer, encoder);
    encoder.sequence(data.sequence);
    data.inline_qos.write(encoder);
    encoder.slice(data.payload.content());
}

fn write_data_frag(data: &DataFrag, encoder: &mut Encoder) {
    encoder.u16(0);
    encoder.u16(DATA_FRAG_TO_INLINE_QOS);
    entities(data.reader, data.writer, encoder);
    encoder.sequence(data.sequence);
    encoder.u32(data.first);
    encoder.u16(data.count);
    encoder.u16(data.fragment_bytes);
    encoder.u32(data.sample_bytes);
    data.inline_qos.write(encoder);
    encoder.slice(&data.payload);
}

impl Payload {
    fn flag(&self) -> u8 {
        match self {
            Self::None => 0,
            Self::Data(_) => flag::DATA,
            Self::Key(_) => flag::KEY,
        }
    }

    fn content(&self) -> &[u8] {
        match self {
            Self::None => &[],
            Self::Data(bytes) | Self::Key(bytes) => bytes,
        }
    }
}

impl InlineQos {
    fn is_absent(&self) -> bool {
        *self == Self::default()
    }

    fn flag(&self) -> u8 {
        if self.is_absent() { 0 } else { flag::INLINE_QOS }
    }

    fn list_bytes(&self) -> usize {
        if self.is_absent() {
            return 0;
        }
        let parameter = |is_there: bool, bytes: usize| if is_there { PARAMETER_HEADER_BYTES + bytes } else { 0 };
        2 * parameter(self.related.is_some(), 24)
            + parameter(self.key_hash.is_some(), 16)
            + parameter(self.status != 0, 4)
            + PARAMETER_HEADER_BYTES
    }

    fn write(&self, encoder: &mut Encoder) {
        if self.is_absent() {
            return;
        }
        let mut list = ParameterWriter::new(encoder);
        if let Some(SampleIdentity { writer, sequence }) = self.related {
            // Fast DDS before 2.11 reads only its own number.
            for id in [pid::RELATED_SAMPLE_IDENTITY, pid::RELATED_SAMPLE_IDENTITY_CUSTOM] {
                list.add(id, |value| {
                    value.guid(writer);
                    value.sequence(sequence);
                });
            }
        }
        if let Some(hash) = self.key_hash {
            list.add(pid::KEY_HASH, |value| value.slice(&hash));
        }
        if self.status != 0 {
            // Big endian, whatever the submessage is (§9.6.4.9).
            list.add(pid::STATUS_INFO, |value| value.slice(&self.status.to_be_bytes()));
        }
        list.end();
    }
}
