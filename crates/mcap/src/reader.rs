//! Reading a file from its beginning. Its bytes come from anybody: lengths are bounded, and nothing panics.

use super::fields::Fields;
use super::{MAGIC, op};
use std::collections::BTreeMap;
use std::io::{self, Read};

/// Largest record that is read, in bytes.
const RECORD_BYTES_MAX: u64 = 64 * 1024 * 1024;

/// Something that a file has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Item {
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
pub enum Fault {
    /// The bytes at the beginning are others.
    NotMcap,
    /// It ends in the middle of something.
    Cut,
    /// Chunks are compressed in this way.
    Compressed(String),
    /// Something is not as it should be.
    Damaged(&'static str),
    /// The file cannot be read.
    Io(io::Error),
}

/// A file that is being read.
pub struct Reader<R> {
    input: R,
    has_begun: bool,
    /// The rest of a chunk.
    chunk: Vec<u8>,
    /// How much of it was read.
    done: usize,
}

impl<R: Read> Reader<R> {
    /// From the beginning of this stream on.
    pub fn new(input: R) -> Self {
        Self { input, has_begun: false, chunk: Vec::new(), done: 0 }
    }

    /// The next item; none at the end of the data.
    ///
    /// # Errors
    /// The reason why there is no more although the file has no end here.
    pub fn read(&mut self) -> Result<Option<Item>, Fault> {
        if !self.has_begun {
            let mut magic = [0; MAGIC.len()];
            let read = self.input.read_exact(&mut magic).map_err(cut);
            if matches!(read, Err(Fault::Cut)) || magic != MAGIC {
                return Err(Fault::NotMcap);
            }
            read?;
            self.has_begun = true;
        }
        loop {
            let mut rest = Fields(self.chunk.get(self.done..).unwrap_or_default());
            if !rest.0.is_empty() {
                let before = rest.0.len();
                let (opcode, content) = inner_record(&mut rest).ok_or(Fault::Damaged("a record beyond its chunk"))?;
                let item = item(opcode, content)?;
                self.done += before - rest.0.len();
                match item {
                    Some(item) => return Ok(Some(item)),
                    None => continue,
                }
            }
            let (opcode, content) = self.record()?;
            match opcode {
                op::DATA_END | op::FOOTER => return Ok(None),
                op::CHUNK => (self.chunk, self.done) = (unpacked(content)?, 0),
                opcode => {
                    if let Some(item) = item(opcode, Fields(&content))? {
                        return Ok(Some(item));
                    }
                }
            }
        }
    }

    fn record(&mut self) -> Result<(u8, Vec<u8>), Fault> {
        let (mut opcode, mut length) = ([0], [0; 8]);
        self.input.read_exact(&mut opcode).map_err(cut)?;
        self.input.read_exact(&mut length).map_err(cut)?;
        let length = u64::from_le_bytes(length);
        if length > RECORD_BYTES_MAX {
            return Err(Fault::Damaged("a record that is longer than 64 MiB"));
        }
        // Grows with what is there, not with what somebody says.
        let mut content = Vec::new();
        let read = self.input.by_ref().take(length).read_to_end(&mut content).map_err(Fault::Io)?;
        if (read as u64) < length { Err(Fault::Cut) } else { Ok((opcode[0], content)) }
    }
}

fn cut(error: io::Error) -> Fault {
    if error.kind() == io::ErrorKind::UnexpectedEof { Fault::Cut } else { Fault::Io(error) }
}

fn inner_record<'a>(rest: &mut Fields<'a>) -> Option<(u8, Fields<'a>)> {
    let (opcode, length) = (rest.u8()?, rest.u64()?);
    Some((opcode, Fields(rest.take(usize::try_from(length).ok()?)?)))
}

/// The records of a chunk.
fn unpacked(content: Vec<u8>) -> Result<Vec<u8>, Fault> {
    let mut fields = Fields(&content);
    let mut head = || {
        let (_first, _last) = (fields.u64()?, fields.u64()?);
        let (_size, sum, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let length = usize::try_from(fields.u64()?).ok()?;
        Some((sum, compression, fields.take(length)?))
    };
    let (sum, compression, records) = head().ok_or(Fault::Damaged("a chunk that is shorter than it says"))?;
    if !compression.is_empty() {
        return Err(Fault::Compressed(compression));
    }
    if sum != 0 && sum != crc32fast::hash(records) {
        return Err(Fault::Damaged("a chunk whose sum is another"));
    }
    Ok(records.to_vec())
}

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
    item.map(Some).ok_or(Fault::Damaged("a record that is shorter than its fields"))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::{Stamp, Writer};

    fn written() -> Vec<u8> {
        let mut file = Vec::new();
        let mut writer = Writer::begin(&mut file, "ros2", "test").unwrap();
        let schema = writer.schema("std_msgs/msg/String", "ros2msg", "string data\n");
        let channel = writer.channel(schema, "/a", "cdr", &[("service".to_owned(), "A/a".to_owned())].into());
        writer.metadata("about", &[("key".to_owned(), "value".to_owned())].into()).unwrap();
        for number in 0..3_u32 {
            let time = 7 + u64::from(number);
            let stamp = Stamp { number, log_time: time, publish_time: time - 1 };
            writer.message(channel, stamp, &[number as u8; 10]).unwrap();
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        file
    }

    fn read(file: &[u8]) -> (Vec<Item>, Option<Fault>) {
        let mut reader = Reader::new(file);
        let mut items = Vec::new();
        loop {
            match reader.read() {
                Ok(Some(item)) => items.push(item),
                Ok(None) => return (items, None),
                Err(fault) => return (items, Some(fault)),
            }
        }
    }

    #[test]
    fn everything_that_was_written_is_read_in_its_order() {
        let (items, fault) = read(&written());
        assert!(fault.is_none() && items.len() == 5, "{items:?} {fault:?}");
        assert_eq!(items[0], Item::Schema(1, "std_msgs/msg/String".to_owned()));
        let Item::Channel { id: 0, schema: 1, topic, encoding, about } = &items[1] else { unreachable!("{items:?}") };
        assert_eq!((topic.as_str(), encoding.as_str(), about["service"].as_str()), ("/a", "cdr", "A/a"));
        assert_eq!(items[4], Item::Message { channel: 0, log_time: 9, data: vec![2; 10] });
    }

    #[test]
    fn a_file_that_was_cut_is_read_up_to_its_last_whole_chunk() {
        let file = written();
        let whole = read(&file).0;
        for length in 8..file.len() {
            let (items, fault) = read(&file[..length]);
            assert!(whole.starts_with(&items), "{length}");
            assert!(matches!(fault, None | Some(Fault::Cut)), "{length}: {fault:?}");
            assert!(fault.is_some() || items.len() == whole.len(), "{length}");
        }
        for length in 0..8 {
            assert!(matches!(read(&file[..length]).1, Some(Fault::NotMcap)));
        }
    }

    #[test]
    fn no_changed_byte_makes_a_message_another_one() {
        let file = written();
        let whole = read(&file).0;
        for place in 0..file.len() {
            let mut changed = file.clone();
            changed[place] ^= 0x41;
            let (items, _) = read(&changed);
            // Whatever stands in a chunk is covered by its sum; a record in front of it may be lost with its opcode.
            for item in items.iter().filter(|item| matches!(item, Item::Message { .. })) {
                assert!(whole.contains(item), "{place}: {item:?}");
            }
        }
    }

    #[test]
    fn a_length_beyond_everything_allocates_nothing() {
        let mut file = MAGIC.to_vec();
        file.push(op::METADATA);
        file.extend(u64::MAX.to_le_bytes());
        assert!(matches!(read(&file).1, Some(Fault::Damaged(_))));
        let end = file.len();
        file[end - 8..].copy_from_slice(&RECORD_BYTES_MAX.to_le_bytes());
        assert!(matches!(read(&file).1, Some(Fault::Cut)));
    }
}
