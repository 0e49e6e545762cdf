//! Writing a file.

use super::fields::Content;
use super::{MAGIC, op};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Uncompressed bytes at which a chunk ends, if it was not ended before.
const CHUNK_BYTES: usize = 1024 * 1024;
/// Bytes of opcode and length in front of every record.
const HEAD_BYTES: u64 = 9;

/// The times and the number of a message.
#[derive(Clone, Copy, Debug)]
pub struct Stamp {
    /// Its number on its channel.
    pub number: u32,
    /// When it was recorded: nanoseconds since the UNIX epoch.
    pub log_time: u64,
    /// When it was published.
    pub publish_time: u64,
}

/// A file that is being written, in order: it never seeks.
pub struct Writer<W> {
    out: W,
    /// Bytes given to it.
    position: u64,
    chunk: Chunk,
    /// Channels and schemas, which stand in the summary once more.
    schemas: Vec<Content>,
    channels: Vec<Content>,
    chunk_indexes: Vec<Content>,
    metadata_indexes: Vec<Content>,
    counts: BTreeMap<u16, u64>,
    /// Log times of the first and of the last message.
    times: Option<(u64, u64)>,
}

/// The chunk that is being filled.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    times: Option<(u64, u64)>,
    /// By channel: log time, and place in `records`.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

impl<W: Write> Writer<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Those of the stream; likewise everywhere here.
    pub fn begin(out: W, profile: &str, library: &str) -> io::Result<Self> {
        let mut writer = Self {
            out,
            position: 0,
            chunk: Chunk::default(),
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk_indexes: Vec::new(),
            metadata_indexes: Vec::new(),
            counts: BTreeMap::new(),
            times: None,
        };
        writer.raw(&MAGIC)?;
        writer.record(op::HEADER, &Content::default().text(profile).text(library))?;
        Ok(writer)
    }

    /// Adds a type; an empty encoding says that its definition is not known.
    pub fn schema(&mut self, name: &str, encoding: &str, definition: &str) -> u16 {
        // Ids begin with 1: 0 is "no schema".
        let id = u16::try_from(self.schemas.len() + 1).unwrap_or(u16::MAX);
        let content = Content::default().u16(id).text(name).text(encoding).text(definition);
        put(&mut self.chunk.records, op::SCHEMA, &content);
        self.schemas.push(content);
        id
    }

    /// Adds a channel.
    pub fn channel(&mut self, schema: u16, topic: &str, encoding: &str, about: &BTreeMap<String, String>) -> u16 {
        let id = u16::try_from(self.channels.len()).unwrap_or(u16::MAX);
        let content = Content::default().u16(id).u16(schema).text(topic).text(encoding).texts(about);
        put(&mut self.chunk.records, op::CHANNEL, &content);
        self.channels.push(content);
        id
    }

    /// Adds a message.
    pub fn message(&mut self, channel: u16, stamp: Stamp, data: &[u8]) -> io::Result<()> {
        let Stamp { number, log_time, publish_time } = stamp;
        let mut content = Content::default().u16(channel).u32(number).u64(log_time).u64(publish_time);
        content.0.extend(data);
        let place = self.chunk.records.len() as u64;
        self.chunk.index.entry(channel).or_default().push((log_time, place));
        put(&mut self.chunk.records, op::MESSAGE, &content);
        self.chunk.times = Some(around(self.chunk.times, log_time));
        self.times = Some(around(self.times, log_time));
        *self.counts.entry(channel).or_default() += 1;
        if self.chunk.records.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    /// Adds facts about the file as a whole.
    pub fn metadata(&mut self, name: &str, facts: &BTreeMap<String, String>) -> io::Result<()> {
        self.end_chunk()?;
        let begins = self.position;
        self.record(op::METADATA, &Content::default().text(name).texts(facts))?;
        let length = self.position - begins;
        self.metadata_indexes.push(Content::default().u64(begins).u64(length).text(name));
        Ok(())
    }

    /// Ends the chunk, and gives everything to whatever is behind the stream.
    pub fn flush(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        self.out.flush()
    }

    /// Ends the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.end_chunk()?;
        // 0: chunks have sums of their own.
        self.record(op::DATA_END, &Content::default().u32(0))?;
        let summary_begins = self.position;
        let statistics = self.statistics();
        let groups = [
            (op::SCHEMA, std::mem::take(&mut self.schemas)),
            (op::CHANNEL, std::mem::take(&mut self.channels)),
            (op::STATISTICS, vec![statistics]),
            (op::CHUNK_INDEX, std::mem::take(&mut self.chunk_indexes)),
            (op::METADATA_INDEX, std::mem::take(&mut self.metadata_indexes)),
        ];
        let mut summary = Vec::new();
        let mut offsets = Vec::new();
        for (opcode, contents) in groups.iter().filter(|(_, contents)| !contents.is_empty()) {
            let begins = summary.len() as u64;
            contents.iter().for_each(|content| put(&mut summary, *opcode, content));
            let length = summary.len() as u64 - begins;
            let offset = Content::default().u8(*opcode).u64(summary_begins + begins).u64(length);
            put(&mut offsets, op::SUMMARY_OFFSET, &offset);
        }
        let offsets_begin = summary_begins + summary.len() as u64;
        summary.extend(offsets);
        // The sum covers the footer as well, up to itself.
        let footer = Content::default().u64(summary_begins).u64(offsets_begin);
        let mut covered = summary;
        covered.push(op::FOOTER);
        covered.extend((footer.0.len() as u64 + 4).to_le_bytes());
        covered.extend(&footer.0);
        let sum = crc32fast::hash(&covered);
        self.raw(&covered)?;
        self.raw(&sum.to_le_bytes())?;
        self.raw(&MAGIC)?;
        self.out.flush()
    }

    fn statistics(&self) -> Content {
        let (first, last) = self.times.unwrap_or_default();
        let count = |list: &[Content]| u32::try_from(list.len()).unwrap_or(u32::MAX);
        Content::default()
            .u64(self.counts.values().sum())
            .u16(u16::try_from(self.schemas.len()).unwrap_or(u16::MAX))
            .u32(count(&self.channels))
            .u32(0)
            .u32(count(&self.metadata_indexes))
            .u32(count(&self.chunk_indexes))
            .u64(first)
            .u64(last)
            .counts(self.counts.iter().map(|(id, count)| (*id, *count)))
    }

    fn end_chunk(&mut self) -> io::Result<()> {
        if self.chunk.records.is_empty() {
            return Ok(());
        }
        let Chunk { records, times, index } = std::mem::take(&mut self.chunk);
        let ((first, last), size) = (times.unwrap_or_default(), records.len() as u64);
        let chunk_begins = self.position;
        let mut chunk =
            Content::default().u64(first).u64(last).u64(size).u32(crc32fast::hash(&records)).text("").u64(size);
        chunk.0.extend(&records);
        self.record(op::CHUNK, &chunk)?;
        let chunk_length = self.position - chunk_begins;
        let indexes_begin = self.position;
        let mut offsets = BTreeMap::new();
        for (channel, places) in index {
            offsets.insert(channel, self.position);
            let list = places.into_iter().fold(Content::default(), |list, (time, place)| list.u64(time).u64(place));
            self.record(op::MESSAGE_INDEX, &Content::default().u16(channel).bytes(&list.0))?;
        }
        let content = Content::default()
            .u64(first)
            .u64(last)
            .u64(chunk_begins)
            .u64(chunk_length)
            .counts(offsets)
            .u64(self.position - indexes_begin)
            .text("")
            .u64(size)
            .u64(size);
        self.chunk_indexes.push(content);
        Ok(())
    }

    fn record(&mut self, opcode: u8, content: &Content) -> io::Result<()> {
        let mut head = Vec::with_capacity(HEAD_BYTES as usize);
        head.push(opcode);
        head.extend((content.0.len() as u64).to_le_bytes());
        self.raw(&head)?;
        self.raw(&content.0)
    }

    fn raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }
}

fn put(records: &mut Vec<u8>, opcode: u8, content: &Content) {
    records.push(opcode);
    records.extend((content.0.len() as u64).to_le_bytes());
    records.extend(&content.0);
}

fn around(times: Option<(u64, u64)>, time: u64) -> (u64, u64) {
    times.map_or((time, time), |(first, last)| (first.min(time), last.max(time)))
}
