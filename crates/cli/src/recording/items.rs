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
///
/// Chunks are opened here. Where a record is longer than its chunk, the crate's own reader (0.26.0) panics, or takes what
/// follows for records.
pub(crate) struct Reader<R> {
    input: R,
    records: LinearReader,
    /// The records of the last chunk that are not read yet.
    chunk: Chunk,
    /// Bytes read so far.
    read: usize,
}

impl<R: Read> Reader<R> {
    /// From the beginning of this stream on.
    pub(crate) fn new(input: R) -> Self {
        let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(RECORD_BYTES_MAX);
        Self { input, records: LinearReader::new_with_options(options), chunk: Chunk::default(), read: 0 }
    }

    /// The next item; none at the end of the data.
    ///
    /// # Errors
    /// The reason why there is no more although the file has no end here.
    pub(crate) fn read(&mut self) -> Result<Option<Item>, Fault> {
        loop {
            if let Some(item) = self.chunk.read()? {
                return Ok(Some(item));
            }
            let Some(event) = self.records.next_event() else { return Ok(None) };
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    // Grows with what is there, not with what somebody says.
                    let place = self.records.insert(wanted.min(READ_BYTES_MAX));
                    let count = read_some(&mut self.input, place).map_err(Fault::Io)?;
                    self.records.notify_read(count);
                    self.read = self.read.saturating_add(count);
                }
                Ok(LinearReadEvent::Record { opcode: op::DATA_END | op::FOOTER, .. }) => return Ok(None),
                Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => self.chunk = Chunk::opened(Fields(data))?,
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    if let Some(item) = item(opcode, Fields(data))? {
                        return Ok(Some(item));
                    }
                }
                Err(McapError::UnexpectedEof) if self.read < mcap::MAGIC.len() => return Err(Fault::NotMcap),
                Err(error) => return Err(error.into()),
            }
        }
    }
}

/// The records of a chunk.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    /// Bytes of them that are read.
    read: usize,
}

impl Chunk {
    /// The chunk of this record, if its sum is right.
    fn opened(mut record: Fields<'_>) -> Result<Self, Fault> {
        let parts = (|| {
            let (_first_time, _last_time, _length) = (record.u64()?, record.u64()?, record.u64()?);
            let (sum, compression, length) = (record.u32()?, record.text()?, record.u64()?);
            Some((sum, compression, record.take(length)?))
        })();
        let (sum, compression, records) = parts.ok_or_else(shorter)?;
        if !compression.is_empty() {
            return Err(Fault::Compressed(compression));
        }
        // Zero says that the writer made no sum.
        if sum != 0 && sum != crc32fast::hash(records) {
            return Err(Fault::Damaged("a chunk whose sum is another".to_owned()));
        }
        Ok(Self { records: records.to_vec(), read: 0 })
    }

    /// The next item; none at its end.
    fn read(&mut self) -> Result<Option<Item>, Fault> {
        while let Some(rest) = self.records.get(self.read..).filter(|rest| !rest.is_empty()) {
            let mut fields = Fields(rest);
            let record = (|| {
                let [opcode] = fields.array()?;
                let length = fields.u64()?;
                Some((opcode, fields.take(length)?))
            })();
            let longer = || Fault::Damaged("a record that is longer than its chunk".to_owned());
            let (opcode, data) = record.ok_or_else(longer)?;
            self.read = self.records.len() - fields.0.len();
            if let Some(item) = item(opcode, Fields(data))? {
                return Ok(Some(item));
            }
        }
        Ok(None)
    }
}

fn shorter() -> Fault {
    Fault::Damaged("a record that is shorter than its fields".to_owned())
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
            McapError::RecordTooLarge { .. } => Self::Damaged("a record that is longer than 64 MiB".to_owned()),
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
    item.map(Some).ok_or_else(shorter)
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

    /// This many bytes.
    fn take(&mut self, length: u64) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(taken)
    }

    /// Bytes behind their length.
    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.take(length.into())
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
