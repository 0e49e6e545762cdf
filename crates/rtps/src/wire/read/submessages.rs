//! Reads submessages, by the rules of validity of §8.3.8.

use crate::guid::{EntityId, SequenceNumber};
use crate::wire::cursor::{Cursor, Malformed};
use crate::wire::format::{DATA_FRAG_TO_INLINE_QOS, DATA_TO_INLINE_QOS, flag, kind};
use crate::wire::number_set::{bitmap_words, masked};
use crate::wire::submessage::{
    AckNack, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, InlineQos, NackFrag, NumberSet, Payload, Submessage,
};
use bytes::Bytes;

impl Submessage {
    /// None for kinds that are not used here, and for payloads in a non-standard format.
    pub(super) fn read(kind: u8, flags: u8, body: Cursor) -> Result<Option<Self>, Malformed> {
        Ok(Some(match kind {
            kind::DATA if flags & flag::OTHER_FORMAT != 0 => return Ok(None),
            kind::DATA_FRAG if flags & flag::FRAGMENT_OF_OTHER_FORMAT != 0 => return Ok(None),
            kind::DATA => Self::Data(read_data(flags, body)?),
            kind::DATA_FRAG => Self::DataFrag(read_data_frag(flags, body)?),
            kind::HEARTBEAT => Self::Heartbeat(read_heartbeat(flags, body)?),
            kind::HEARTBEAT_FRAG => Self::HeartbeatFrag(read_heartbeat_frag(body)?),
            kind::ACKNACK => Self::AckNack(read_acknack(flags, body)?),
            kind::NACK_FRAG => Self::NackFrag(read_nack_frag(body)?),
            kind::GAP => Self::Gap(read_gap(body)?),
            _ => return Ok(None),
        }))
    }
}

/// An error, which ends the datagram, unless the condition holds.
fn require(condition: bool) -> Result<(), Malformed> {
    condition.then_some(()).ok_or(Malformed)
}

/// Reader and writer.
fn entities(body: &mut Cursor) -> Result<(EntityId, EntityId), Malformed> {
    Ok((body.entity()?, body.entity()?))
}

/// The number of a sample: samples begin at 1.
fn sample_number(body: &mut Cursor) -> Result<SequenceNumber, Malformed> {
    let number = body.sequence()?;
    require(number > SequenceNumber::ZERO)?;
    Ok(number)
}

/// A bitmap. Bits behind its last one are cleared, so that equal sets compare equal.
fn bitmap(base: i64, body: &mut Cursor) -> Result<NumberSet, Malformed> {
    let bits = body.u32()?;
    let mut words = [0; 8];
    for word in words.iter_mut().take(bitmap_words(bits)) {
        *word = body.u32()?;
    }
    Ok(NumberSet { base, bits, bitmap: masked(words, bits) })
}

fn sequence_set(body: &mut Cursor) -> Result<NumberSet, Malformed> {
    let base = body.sequence()?.0;
    let set = bitmap(base, body)?;
    require(set.is_valid_for_sequences())?;
    Ok(set)
}

fn fragment_set(body: &mut Cursor) -> Result<NumberSet, Malformed> {
    let base = body.u32()?.into();
    let set = bitmap(base, body)?;
    require(set.is_valid_for_fragments())?;
    Ok(set)
}

/// Skips fields that a later version may add in front of the parameters, and reads the parameters if there are any.
fn inline_qos(flags: u8, to_inline_qos: u16, expected: u16, body: &mut Cursor) -> Result<InlineQos, Malformed> {
    body.skip(to_inline_qos.checked_sub(expected).ok_or(Malformed)?.into())?;
    if flags & flag::INLINE_QOS == 0 { Ok(InlineQos::default()) } else { InlineQos::read(body) }
}

fn read_data(flags: u8, mut body: Cursor) -> Result<Data, Malformed> {
    let _extra_flags = body.u16()?;
    let to_inline_qos = body.u16()?;
    let (reader, writer) = entities(&mut body)?;
    let sequence = sample_number(&mut body)?;
    let inline_qos = inline_qos(flags, to_inline_qos, DATA_TO_INLINE_QOS, &mut body)?;
    let payload = match (flags & flag::DATA != 0, flags & flag::KEY != 0) {
        (true, true) => return Err(Malformed),
        (true, false) => Payload::Data(body.into_rest()),
        (false, true) => Payload::Key(body.into_rest()),
        (false, false) => Payload::None,
    };
    Ok(Data { reader, writer, sequence, inline_qos, payload })
}

fn read_data_frag(flags: u8, mut body: Cursor) -> Result<DataFrag, Malformed> {
    let _extra_flags = body.u16()?;
    let to_inline_qos = body.u16()?;
    let (reader, writer) = entities(&mut body)?;
    let sequence = sample_number(&mut body)?;
    let (first, count) = (body.u32()?, body.u16()?);
    let (fragment_bytes, sample_bytes) = (body.u16()?, body.u32()?);
    let inline_qos = inline_qos(flags, to_inline_qos, DATA_FRAG_TO_INLINE_QOS, &mut body)?;
    let length = bytes_of_fragments(first, count, fragment_bytes, sample_bytes).ok_or(Malformed)?;
    let payload: Bytes = body.take(length)?;
    let is_key = flags & flag::FRAGMENT_OF_KEY != 0;
    Ok(DataFrag { reader, writer, sequence, first, count, fragment_bytes, sample_bytes, inline_qos, is_key, payload })
}

/// Bytes of these fragments, without the padding behind the last one. None if the sample does not have them (§8.3.8.3.3).
fn bytes_of_fragments(first: u32, count: u16, fragment_bytes: u16, sample_bytes: u32) -> Option<usize> {
    let (size, count) = (u64::from(fragment_bytes), u64::from(count));
    let sample = u64::from(sample_bytes);
    let before = u64::from(first.checked_sub(1)?);
    let is_valid = count > 0 && size > 0 && size <= sample && before + count <= sample.div_ceil(size);
    let (start, end) = (before * size, (before + count) * size);
    if is_valid { usize::try_from(end.min(sample) - start).ok() } else { None }
}

fn read_heartbeat(flags: u8, mut body: Cursor) -> Result<Heartbeat, Malformed> {
    let (reader, writer) = entities(&mut body)?;
    let (first, last) = (body.sequence()?, body.sequence()?);
    require(first > SequenceNumber::ZERO && last >= first.previous())?;
    let (is_final, is_alive) = (flags & flag::FINAL != 0, flags & flag::ALIVE != 0);
    Ok(Heartbeat { reader, writer, first, last, count: body.i32()?, is_final, is_alive })
}

fn read_heartbeat_frag(mut body: Cursor) -> Result<HeartbeatFrag, Malformed> {
    let (reader, writer) = entities(&mut body)?;
    let (sequence, last) = (sample_number(&mut body)?, body.u32()?);
    require(last > 0)?;
    Ok(HeartbeatFrag { reader, writer, sequence, last, count: body.i32()? })
}

fn read_acknack(flags: u8, mut body: Cursor) -> Result<AckNack, Malformed> {
    let (reader, writer) = entities(&mut body)?;
    let missing = sequence_set(&mut body)?;
    Ok(AckNack { reader, writer, missing, count: body.i32()?, is_final: flags & flag::FINAL != 0 })
}

fn read_nack_frag(mut body: Cursor) -> Result<NackFrag, Malformed> {
    let (reader, writer) = entities(&mut body)?;
    let (sequence, missing) = (sample_number(&mut body)?, fragment_set(&mut body)?);
    Ok(NackFrag { reader, writer, sequence, missing, count: body.i32()? })
}

fn read_gap(mut body: Cursor) -> Result<Gap, Malformed> {
    let (reader, writer) = entities(&mut body)?;
    let (start, list) = (sample_number(&mut body)?, sequence_set(&mut body)?);
    Ok(Gap { reader, writer, start, list })
}
