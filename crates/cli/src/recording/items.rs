//! The items of an MCAP file, from its beginning. Its bytes come from anybody: lengths are bounded, memory grows with what is
//! there, and nothing panics.

use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::io::{self, Read};

/// Largest record that is read, in bytes.
const RECORD_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Most bytes that are read at once.
const READ_BYTES_MAX: usize = 256 * 1024;

/// Something that a file has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Item {
    /// A type: its id, its name.
    Schema(u16, String),
    /// A channel.
    Channel {
        /// Its number in the file.
        id: u16,
        /// The number of its type.
        schema: u16,
        /// Its topic.
        topic: String,
        /// Its encoding, such as `cdr`.
        encoding: String,
        /// The facts that its writer added.
        about: BTreeMap<String, String>,
    },
    /// A message of a channel.
    Message {
        /// The number of its channel.
        channel: u16,
        /// When it was recorded: nanoseconds since the UNIX epoch.
        log_time: u64,
        /// Its bytes.
        data: Vec<u8>,
    },
}

/// Why a file cannot be read (further).
#[derive(Debug)]
pub(crate) enum Fault {
    /// The bytes at the beginning are others.
    NotMcap,
    /// It ends in the middle of something.
    Cut,
    /// Chunks are compressed in this way.
    Compressed(String),
    /// Something is not as it should be.
    Damaged(String),
    /// The file cannot be read.
    Io(io::Error),
}

/// A file that is being read.
pub(crate) struct Reader<R> {
    input: R,
    records: LinearReader,
    /// Bytes read so far.
    read: usize,
}

impl<R: Read> Reader<R> {
    /// From the beginning of this stream on.
    pub(crate) fn new(input: R) -> Self {
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_BYTES_MAX);
        Self { input, records: LinearReader::new_with_options(options), read: 0 }
    }

    /// The next item; none at the end of the data.
    ///
    /// # Errors
    /// The reason why there is no more although the file has no end here.
    pub(crate) fn read(&mut self) -> Result<Option<Item>, Fault> {
        while let Some(event) = self.records.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    // Grows with what is there, not with what somebody says.
                    let place = self.records.insert(wanted.min(READ_BYTES_MAX));
                    let count = read_some(&mut self.input, place).map_err(Fault::Io)?;
                    self.records.notify_read(count);
                    self.read = self.read.saturating_add(count);
                }
                Ok(LinearReadEvent::Record { opcode: op::DATA_END | op::FOOTER, .. }) => return Ok(None),
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    if let Some(item) = item(opcode, Fields(data))? {
                        return Ok(Some(item));
                    }
                }
                Err(McapError::UnexpectedEof) if self.read < mcap::MAGIC.len() => return Err(Fault::NotMcap),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(None)
    }
}

/// As [`Read::read`], again where it was interrupted.
fn read_some(input: &mut impl Read, place: &mut [u8]) -> io::Result<usize> {
    loop {
        match input.read(place) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

impl From<McapError> for Fault {
    fn from(error: McapError) -> Self {
        match error {
            McapError::BadMagic => Self::NotMcap,
            McapError::UnexpectedEof => Self::Cut,
            McapError::UnsupportedCompression(name) => Self::Compressed(name),
            McapError::BadChunkCrc { .. } => Self::Damaged("a chunk whose sum is another".to_owned()),
            McapError::RecordTooLarge { .. } | McapError::ChunkTooLarge(_) => {
                Self::Damaged("a record that is longer than 64 MiB".to_owned())
            }
            error => Self::Damaged(error.to_string()),
        }
    }
}

/// The item of a record, if it is one that counts here. The crate's own parser allocates what a length says before it looks
/// whether that much is there.
fn item(opcode: u8, mut fields: Fields<'_>) -> Result<Option<Item>, Fault> {
    let item = match opcode {
        op::SCHEMA => (|| Some(Item::Schema(fields.u16()?, fields.text()?)))(),
        op::CHANNEL => (|| {
            let (id, schema) = (fields.u16()?, fields.u16()?);
            let (topic, encoding, about) = (fields.text()?, fields.text()?, fields.texts()?);
            Some(Item::Channel { id, schema, topic, encoding, about })
        })(),
        op::MESSAGE => (|| {
            let (channel, _number) = (fields.u16()?, fields.u32()?);
            let (log_time, _publish_time) = (fields.u64()?, fields.u64()?);
            Some(Item::Message { channel, log_time, data: fields.0.to_vec() })
        })(),
        _ => return Ok(None),
    };
    item.map(Some).ok_or_else(|| Fault::Damaged("a record that is shorter than its fields".to_owned()))
}

/// The content of a record. Every reader gives none where the bytes end before.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length.
    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn text(&mut self) -> Option<String> {
        std::str::from_utf8(self.bytes()?).ok().map(str::to_owned)
    }

    fn texts(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Fields(self.bytes()?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            map.insert(inner.text()?, inner.text()?);
        }
        Some(map)
    }
}

#[cfg(test)]
#[path = "items/tests.rs"]
mod tests;
