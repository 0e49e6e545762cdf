//! The first bytes of a segment, its name, and positions in the log.

use std::fmt;

/// Size of a segment's header.
pub const HEADER_BYTES: u64 = 96;

/// The format this code writes.
pub const VERSION: u32 = 1;

/// Largest segment: offsets are kept in 32 bits, with room for one record beyond the end.
pub const SEGMENT_BYTES_MAX: u64 = 1 << 30;

const MAGIC: [u8; 8] = *b"LEDGRSEG";
const CRC_AT: usize = 92;
const _: () = assert!(CRC_AT + 4 == HEADER_BYTES as usize);

/// A place in the log: a byte of a segment. Ordered as the log is.
///
/// On disk a `u64`: the sequence number in the upper, the offset in the lower half. 0 is before everything.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogPosition {
    /// Sequence number of the segment, from 1.
    pub sequence: u32,
    /// Offset in its file, bytes.
    pub offset: u32,
}

impl LogPosition {
    /// As stored.
    pub const fn to_u64(self) -> u64 {
        ((self.sequence as u64) << 32) | self.offset as u64
    }

    /// From what is stored.
    pub const fn from_u64(stored: u64) -> Self {
        Self { sequence: (stored >> 32) as u32, offset: stored as u32 }
    }
}

impl fmt::Display for LogPosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.sequence, self.offset)
    }
}

/// The entry that a log follows: the newest that is no longer in it. Index and term 0: the genesis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Base {
    /// Its index.
    pub index: u64,
    /// Its term.
    pub term: u64,
}

/// The head of a segment.
///
/// | offset | bytes | field | why |
/// |---|---|---|---|
/// | 0 | 8 | magic `LEDGRSEG` | a foreign file is named as such |
/// | 8 | 4 | format version, 1 | an older program refuses a newer file; the header's size and the place of its CRC never change |
/// | 12 | 4 | sequence | order of the segments; equals the name, so a renamed or missing file is noticed |
/// | 16 | 32 | network | hash of the genesis block; a store of another network is refused |
/// | 48 | 8 | first index | the index that follows the newest entry before this segment; equals the name |
/// | 56 | 8 | salt | random; seeds the records' CRCs, so that bytes of another segment or of a payload never parse |
/// | 64 | 8 | durable_upto | end of the predecessor's records, a [`LogPosition`]; all of it was durable before this segment got its name. 0 in a segment that begins a log: the first of all, or the first after a snapshot, which makes those before it void |
/// | 72 | 4 | previous | header CRC of the predecessor's last record (or of its header, if none): the chain goes across files. 0 in a segment that begins a log |
/// | 76 | 8 | previous term | term of the entry before the first index, 0 for index 0: the orderer asks for it when older segments are gone |
/// | 84 | 8 | zero | reserved |
/// | 92 | 4 | CRC-32C of bytes 0 to 91 | damage is noticed; the first record names it as its predecessor |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SegmentHeader {
    /// Place among the segments, from 1.
    pub sequence: u32,
    /// Hash of the genesis block.
    pub network: [u8; 32],
    /// The index that follows the newest entry before this segment.
    pub first_index: u64,
    /// Random seed of the records' CRCs.
    pub salt: u64,
    /// Where the predecessor's records end.
    pub durable_upto: LogPosition,
    /// CRC of what precedes this header in the chain.
    pub previous: u32,
    /// Term of the newest entry before this segment.
    pub previous_term: u64,
}

impl SegmentHeader {
    /// Does the log begin here, whatever older segments there are?
    pub fn begins_log(&self) -> bool {
        self.durable_upto == LogPosition::default()
    }

    /// Where the log begins if this is its oldest segment.
    pub const fn base(&self) -> Base {
        Base { index: self.first_index.saturating_sub(1), term: self.previous_term }
    }

    /// The bytes to store, and their CRC, which the first record names as its predecessor.
    pub fn encode(&self) -> (Vec<u8>, u32) {
        let mut bytes = Vec::with_capacity(HEADER_BYTES as usize);
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.network);
        bytes.extend(self.first_index.to_le_bytes());
        bytes.extend(self.salt.to_le_bytes());
        bytes.extend(self.durable_upto.to_u64().to_le_bytes());
        bytes.extend(self.previous.to_le_bytes());
        bytes.extend(self.previous_term.to_le_bytes());
        bytes.resize(CRC_AT, 0);
        let crc = crc32c::crc32c(&bytes);
        bytes.extend(crc.to_le_bytes());
        (bytes, crc)
    }

    /// Reads a header and its CRC; says the offset of what is wrong, and what.
    pub fn decode(bytes: &[u8]) -> Result<(Self, u32), (u64, String)> {
        let short = || (bytes.len() as u64, format!("a segment header has {HEADER_BYTES} bytes, the file ends before"));
        let (body, stored) = bytes.split_at_checked(CRC_AT).ok_or_else(short)?;
        let (stored, _) = stored.split_first_chunk::<4>().ok_or_else(short)?;
        let stored = u32::from_le_bytes(*stored);
        let mut rest = body;
        if take::<8>(&mut rest) != Some(MAGIC) {
            return Err((0, "the file does not start like a segment".to_owned()));
        }
        let crc = crc32c::crc32c(body);
        if crc != stored {
            return Err((0, format!("CRC of the segment header is {crc:08x}, stored is {stored:08x}")));
        }
        let version = take(&mut rest).map(u32::from_le_bytes).ok_or_else(short)?;
        if version != VERSION {
            let what = format!("format version {version}, this program reads {VERSION}: use a newer program");
            return Err((8, what));
        }
        let header = Self {
            sequence: take(&mut rest).map(u32::from_le_bytes).ok_or_else(short)?,
            network: take(&mut rest).ok_or_else(short)?,
            first_index: take(&mut rest).map(u64::from_le_bytes).ok_or_else(short)?,
            salt: take(&mut rest).map(u64::from_le_bytes).ok_or_else(short)?,
            durable_upto: take(&mut rest).map(u64::from_le_bytes).map(LogPosition::from_u64).ok_or_else(short)?,
            previous: take(&mut rest).map(u32::from_le_bytes).ok_or_else(short)?,
            previous_term: take(&mut rest).map(u64::from_le_bytes).ok_or_else(short)?,
        };
        if header.first_index == 0 {
            return Err((48, "the first index is 0, which is the genesis and not in the log".to_owned()));
        }
        Ok((header, crc))
    }
}

/// The name of a segment's file.
pub fn segment_name(sequence: u32, first_index: u64) -> String {
    format!("{sequence:010}-{first_index:020}.seg")
}

/// Sequence and first index of a file that is named as a segment is.
pub fn parse_name(name: &str) -> Option<(u32, u64)> {
    let (sequence, first_index) = name.strip_suffix(".seg")?.split_once('-')?;
    let parsed = (sequence.parse().ok()?, first_index.parse().ok()?);
    (segment_name(parsed.0, parsed.1) == name).then_some(parsed)
}

/// Takes the next `N` bytes.
pub(super) fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (head, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*head)
}
