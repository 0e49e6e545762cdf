//! One record: its bytes, writing and reading them.

use bytes::Bytes;

use super::header::{LogPosition, SEGMENT_BYTES_MAX, take};
use super::seal::Seal;
use crate::entry::{Entry, EntryKind, HardState};
use ledger_base::mutation::{Mutation, active};

/// Size of a record's header.
pub const RECORD_HEADER_BYTES: usize = 25;

/// Bytes of an entry's payload before its data.
const ENTRY_FIELDS_BYTES: usize = 17;

/// Bytes of a hard state's payload.
const HARD_STATE_BYTES: usize = 24;

/// Most data in one entry: a block of several payloads at their default limit of 1 MiB, and room for a larger limit.
/// Reading one record never needs more memory than this.
pub const ENTRY_BYTES_MAX: usize = 16 << 20;

/// Largest record.
pub const RECORD_BYTES_MAX: usize = RECORD_HEADER_BYTES + ENTRY_FIELDS_BYTES + ENTRY_BYTES_MAX;

const _: () = assert!(SEGMENT_BYTES_MAX + RECORD_BYTES_MAX as u64 <= u32::MAX as u64);

const TYPE_ENTRY: u8 = 1;
const TYPE_HARD_STATE: u8 = 2;
const TYPE_SEAL: u8 = 3;

/// The content of a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Record {
    /// Type 1. Payload: index `u64`, term `u64`, kind `u8` ([`EntryKind::code`]), then the data to the end.
    Entry(Entry),
    /// Type 2. Payload: term, vote, commit, `u64` each.
    HardState(HardState),
    /// Type 3. The content of the segment before this one: see [`Seal`].
    Seal(Seal),
}

/// The head of a record; the payload follows at once.
///
/// | offset | bytes | field | why |
/// |---|---|---|---|
/// | 0 | 4 | header CRC | CRC-32C of (salt, own offset as `u64`, bytes 4 to 24): recognises a record without its predecessor, and only in its place. It covers the payload through the payload's CRC |
/// | 4 | 4 | length | bytes of the payload, at most 16 MiB + 17; checked before anything is allocated |
/// | 8 | 4 | payload CRC | CRC-32C of the payload: which of header and payload is damaged can be told |
/// | 12 | 4 | previous | header CRC of the record before (of the segment header, for the first): what an undone write left behind never continues the log |
/// | 16 | 8 | durable_upto | [`LogPosition`] up to which the log was on disk when this was written: damage before it is rot, not a torn write |
/// | 24 | 1 | type | 1 entry, 2 hard state, 3 seal; never 0, so zeros are no record |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordHeader {
    /// CRC of the header; the next record names it.
    pub crc: u32,
    /// Bytes of the payload.
    pub length: u32,
    /// CRC of the payload.
    pub payload_crc: u32,
    /// CRC of the header before.
    pub previous: u32,
    /// Up to where the log was durable when this record was written.
    pub durable_upto: LogPosition,
    /// The kind of the payload.
    kind: u8,
}

impl RecordHeader {
    /// Reads the header of a record that is to start at `position`; the error says what is wrong.
    ///
    /// Cheap tests come first, as resynchronisation calls this for every byte.
    pub fn decode(bytes: &[u8], salt: u64, position: LogPosition) -> Result<Self, &'static str> {
        const SHORT: &str = "the file ends inside a record header";
        let (bytes, _) = bytes.split_first_chunk::<RECORD_HEADER_BYTES>().ok_or(SHORT)?;
        let mut rest = bytes.as_slice();
        let crc = take(&mut rest).map(u32::from_le_bytes).ok_or(SHORT)?;
        let covered = rest;
        let header = Self {
            crc,
            length: take(&mut rest).map(u32::from_le_bytes).ok_or(SHORT)?,
            payload_crc: take(&mut rest).map(u32::from_le_bytes).ok_or(SHORT)?,
            previous: take(&mut rest).map(u32::from_le_bytes).ok_or(SHORT)?,
            durable_upto: take(&mut rest).map(u64::from_le_bytes).map(LogPosition::from_u64).ok_or(SHORT)?,
            kind: take::<1>(&mut rest).map(u8::from_le_bytes).ok_or(SHORT)?,
        };
        if !matches!(header.kind, TYPE_ENTRY | TYPE_HARD_STATE | TYPE_SEAL) {
            return Err("unknown record type");
        }
        if header.record_bytes() > RECORD_BYTES_MAX {
            return Err("the length exceeds the limit for records");
        }
        if header.durable_upto > position {
            return Err("the record is marked as durable before it was written");
        }
        if header_crc(covered, salt, position.offset) != crc {
            return Err("the CRC of the record header is wrong");
        }
        Ok(header)
    }

    /// Is the payload an entry?
    pub const fn is_entry(&self) -> bool {
        self.kind == TYPE_ENTRY
    }

    /// Bytes of header and payload.
    pub const fn record_bytes(&self) -> usize {
        RECORD_HEADER_BYTES + self.length as usize
    }
}

/// Bytes a record takes.
pub fn encoded_bytes(record: &Record) -> usize {
    RECORD_HEADER_BYTES
        + match record {
            Record::Entry(entry) => ENTRY_FIELDS_BYTES + entry.data.len(),
            Record::HardState(_) => HARD_STATE_BYTES,
            Record::Seal(seal) => seal.bytes(),
        }
}

/// Appends `record` to `out` as it has to be at `offset`; returns its header CRC.
pub fn encode_record(
    record: &Record,
    salt: u64,
    offset: u32,
    previous: u32,
    durable_upto: LogPosition,
    out: &mut Vec<u8>,
) -> u32 {
    // The fields before an entry's data are few: they are put together first, the data is copied once.
    let (kind, fields, data): (u8, Vec<u8>, &[u8]) = match record {
        Record::Entry(entry) => {
            let mut fields = Vec::with_capacity(ENTRY_FIELDS_BYTES);
            fields.extend(entry.index.to_le_bytes());
            fields.extend(entry.term.to_le_bytes());
            fields.push(entry.kind.code());
            (TYPE_ENTRY, fields, &entry.data)
        }
        Record::HardState(state) => {
            let numbers = [state.term, state.vote, state.commit];
            (TYPE_HARD_STATE, numbers.iter().flat_map(|number| number.to_le_bytes()).collect(), &[])
        }
        Record::Seal(seal) => (TYPE_SEAL, seal.to_bytes(), &[]),
    };
    let payload_crc = crc32c::crc32c_append(crc32c::crc32c(&fields), data);
    let length = (fields.len() + data.len()) as u32;
    let mut covered = Vec::with_capacity(RECORD_HEADER_BYTES);
    covered.extend(length.to_le_bytes());
    covered.extend(payload_crc.to_le_bytes());
    covered.extend(previous.to_le_bytes());
    covered.extend(durable_upto.to_u64().to_le_bytes());
    covered.push(kind);
    let crc = header_crc(&covered, salt, offset);
    out.extend(crc.to_le_bytes());
    out.extend(covered);
    out.extend(fields);
    out.extend_from_slice(data);
    crc
}

/// Reads the payload of `header`; the error says what is wrong.
pub fn decode_record(header: &RecordHeader, payload: &[u8]) -> Result<Record, &'static str> {
    const SHORT: &str = "the payload ends before its fields";
    if payload.len() != header.length as usize {
        return Err("the file ends inside a record");
    }
    if crc32c::crc32c(payload) != header.payload_crc && !active(Mutation::NoRecheckAfterRestart) {
        return Err("the CRC of the record's payload is wrong");
    }
    let mut rest = payload;
    if header.kind == TYPE_SEAL {
        return Seal::from_bytes(payload).map(Record::Seal);
    }
    if header.kind == TYPE_HARD_STATE {
        let mut number = || take(&mut rest).map(u64::from_le_bytes).ok_or(SHORT);
        return Ok(Record::HardState(HardState { term: number()?, vote: number()?, commit: number()? }));
    }
    let index = take(&mut rest).map(u64::from_le_bytes).ok_or(SHORT)?;
    let term = take(&mut rest).map(u64::from_le_bytes).ok_or(SHORT)?;
    let [kind] = take::<1>(&mut rest).ok_or(SHORT)?;
    let kind = EntryKind::from_code(kind).ok_or("unknown kind of entry")?;
    Ok(Record::Entry(Entry { index, term, kind, data: Bytes::copy_from_slice(rest) }))
}

fn header_crc(covered: &[u8], salt: u64, offset: u32) -> u32 {
    let mut seed = [0; 16];
    let (first, second) = seed.split_at_mut(8);
    first.copy_from_slice(&salt.to_le_bytes());
    second.copy_from_slice(&u64::from(offset).to_le_bytes());
    crc32c::crc32c_append(crc32c::crc32c(&seed), covered)
}
