//! One file of results: its bytes, and reading them.

use super::RESULTS_FILE_BYTES_MAX;
use super::index::{self, Item, PAGE_BYTES, POSITION_BITS};
use super::stored::StoredResult;
use crate::disk::DiskFile;
use crate::segment::Window;
use bytes::Bytes;
use std::collections::BTreeSet;
use std::io::{self, ErrorKind};
use std::sync::Arc;

/// Bytes of the head of a file: `LEDGRRES`, format version `u32`, zero `u32`, network (32), first height `u64`, all LE,
/// CRC-32C of these, zero `u32`.
pub(super) const HEAD_BYTES: u64 = 64;
const MAGIC: &[u8; 8] = b"LEDGRRES";
const VERSION: u32 = 1;

/// Bytes before the result in a record: its length `u32` LE, then CRC-32C of (height `u64` LE, the result).
pub(super) const RECORD_HEAD_BYTES: u64 = 8;
/// A record is not smaller: head, hash and digest.
const RECORD_BYTES_MIN: u64 = RECORD_HEAD_BYTES + 66;
const _: () = assert!(RESULTS_FILE_BYTES_MAX / RECORD_BYTES_MIN < 1 << (u32::BITS - POSITION_BITS));

/// Bytes of the end of a finished file: `LEDGREND`, then, LE, first height `u64`, blocks `u64`, end of the records
/// `u64`, pages of the index `u32`, marks `u32`. Times of the first and of the last block `u64`, and CRC-32C of the
/// marks and of these, follow. Before it are the marks, `u32` each, and before them the pages.
const TAIL_BYTES: usize = 60;
const TAIL_MAGIC: &[u8; 8] = b"LEDGREND";

/// Every so many records their offset is kept in memory: four bytes for sixteen blocks.
const MARK_EVERY: u64 = 16;

/// A file of results, open for more or finished.
#[derive(Clone)]
pub(super) struct ResultFile {
    /// Height of its first block.
    pub(super) first: u64,
    /// How many blocks.
    pub(super) count: u64,
    /// Where the records end.
    pub(super) end: u64,
    /// Block times of the first and of the last block, microseconds.
    pub(super) times: (u64, u64),
    /// Offset of every sixteenth record.
    marks: Vec<u32>,
    index: Index,
}

#[derive(Clone)]
enum Index {
    /// Of the file that is being written.
    Open(BTreeSet<Item>),
    /// Pages after the records.
    Finished { pages: u32 },
}

/// Where a record is, but for some that are before it.
pub(super) struct Spot {
    offset: u64,
    skip: u64,
    height: u64,
    end: u64,
}

/// The records of a file.
pub(super) struct Records {
    pub(super) first: u64,
    /// Height after the last of them.
    pub(super) next: u64,
    /// Where they end.
    end: u64,
    /// Block time of the last, microseconds.
    pub(super) newest: u64,
    /// Offset of every sixteenth.
    marks: Vec<u32>,
}

/// A record of a file, as it is read.
struct Stored {
    bytes: Bytes,
    /// Where the next one begins.
    next: u64,
}

impl ResultFile {
    /// Name of the file that begins with this height.
    pub(super) fn name(first: u64) -> String {
        format!("{first:020}.res")
    }

    /// The height in a name.
    pub(super) fn height(name: &str) -> Option<u64> {
        let height = name.strip_suffix(".res")?.parse().ok()?;
        (Self::name(height) == name).then_some(height)
    }

    /// A file without records.
    pub(super) fn new(first: u64) -> Self {
        let index = Index::Open(BTreeSet::new());
        Self { first, count: 0, end: HEAD_BYTES, times: (0, 0), marks: Vec::new(), index }
    }

    /// Height of the block after its last.
    pub(super) fn next(&self) -> u64 {
        self.first + self.count
    }

    /// The first bytes of the file.
    pub(super) fn head(&self, network: &[u8; 32]) -> Vec<u8> {
        let mut head = Vec::with_capacity(HEAD_BYTES as usize);
        head.extend(MAGIC);
        head.extend(VERSION.to_le_bytes());
        head.extend([0; 4]);
        head.extend(network);
        head.extend(self.first.to_le_bytes());
        head.extend(crc32c::crc32c(&head).to_le_bytes());
        head.resize(HEAD_BYTES as usize, 0);
        head
    }

    /// Takes note of a record that was written at the end.
    pub(super) fn add(&mut self, bytes: usize, time: u64, taken: impl Iterator<Item = (u32, u64)>) {
        if self.count.is_multiple_of(MARK_EVERY) {
            // Files are finished long before that: see `RESULTS_FILE_BYTES_MAX`.
            self.marks.push(u32::try_from(self.end).unwrap_or(u32::MAX));
        }
        if let Index::Open(items) = &mut self.index {
            let block = u32::try_from(self.count).unwrap_or(u32::MAX);
            items.extend(taken.map(|(position, id)| Item { id, block, position }));
        }
        self.times = (if self.count == 0 { time } else { self.times.0 }, time);
        self.count += 1;
        self.end += RECORD_HEAD_BYTES + bytes as u64;
    }

    /// Where to look for the record of a height; none if it is not in this file.
    pub(super) fn locate(&self, height: u64) -> Option<Spot> {
        let number = height.checked_sub(self.first).filter(|number| *number < self.count)?;
        let mark = self.marks.get(usize::try_from(number / MARK_EVERY).ok()?)?;
        Some(Spot { offset: u64::from(*mark), skip: number % MARK_EVERY, height, end: self.end })
    }

    /// All its records.
    pub(super) fn records(&self) -> Records {
        let (first, next, marks) = (self.first, self.next(), self.marks.clone());
        Records { first, next, end: self.end, newest: self.times.1, marks }
    }

    /// The places of transactions whose id begins so. Answers at once for the file that is being written.
    pub(super) fn find(&self, file: impl FnOnce() -> io::Result<Arc<dyn DiskFile>>, id: u64) -> io::Result<Vec<Item>> {
        match &self.index {
            Index::Open(items) => {
                let from = Item { id, block: 0, position: 0 };
                Ok(items.range(from..).take_while(|item| item.id == id).copied().collect())
            }
            Index::Finished { pages: 0 } => Ok(Vec::new()),
            Index::Finished { pages } => index::find(&*file()?, self.end, *pages, id),
        }
    }

    /// The end of a finished file, after its records.
    pub(super) fn finish(&self) -> (Self, Vec<u8>) {
        let Index::Open(items) = &self.index else { return (self.clone(), Vec::new()) };
        let mut bytes = index::pages(items);
        let pages = u32::try_from(bytes.len() / PAGE_BYTES).unwrap_or(u32::MAX);
        let mut tail: Vec<u8> = self.marks.iter().flat_map(|mark| mark.to_le_bytes()).collect();
        tail.extend(TAIL_MAGIC);
        for number in [self.first, self.count, self.end] {
            tail.extend(number.to_le_bytes());
        }
        tail.extend(pages.to_le_bytes());
        tail.extend(u32::try_from(self.marks.len()).unwrap_or(u32::MAX).to_le_bytes());
        tail.extend(self.times.0.to_le_bytes());
        tail.extend(self.times.1.to_le_bytes());
        tail.extend(crc32c::crc32c(&tail).to_le_bytes());
        bytes.append(&mut tail);
        let Self { first, count, end, times, .. } = *self;
        (Self { first, count, end, times, marks: self.marks.clone(), index: Index::Finished { pages } }, bytes)
    }

    /// Opens a finished file by its end; none if it is not finished, or damaged.
    pub(super) fn finished(mut file: &dyn DiskFile, first: u64, network: &[u8; 32]) -> io::Result<Option<Self>> {
        if !Self::has_head(file, first, network)? {
            return Ok(None);
        }
        let length = file.len()?;
        let Some(at) = length.checked_sub(TAIL_BYTES as u64) else { return Ok(None) };
        let tail = read(&mut file, at, TAIL_BYTES)?;
        Ok(Self::read_tail(file, &tail, at, first)?.filter(|found| found.first == first))
    }

    fn read_tail(mut file: &dyn DiskFile, tail: &[u8], at: u64, first: u64) -> io::Result<Option<Self>> {
        let number = |at: usize| {
            let bytes = tail.get(at..).and_then(|rest| rest.first_chunk());
            bytes.map_or(0, |bytes| u64::from_le_bytes(*bytes))
        };
        let (pages, marks) = ((number(32) & 0xffff_ffff) as u32, number(32) >> 32);
        let [count, end] = [16, 24].map(number);
        let index = end.checked_add(u64::from(pages) * PAGE_BYTES as u64);
        let fits = index.and_then(|index| index.checked_add(marks * 4)) == Some(at);
        if !tail.starts_with(TAIL_MAGIC) || !fits || marks != count.div_ceil(MARK_EVERY) || number(8) != first {
            return Ok(None);
        }
        // It fits, so that this is no more than the file has.
        let marks = read(&mut file, at - marks * 4, (marks * 4) as usize)?;
        let covered = crc32c::crc32c_append(crc32c::crc32c(&marks), tail.get(..TAIL_BYTES - 4).unwrap_or_default());
        if tail.last_chunk().map(|crc| u32::from_le_bytes(*crc)) != Some(covered) {
            return Ok(None);
        }
        let (marks, _) = marks.as_chunks();
        let marks = marks.iter().map(|mark| u32::from_le_bytes(*mark)).collect();
        let times = (number(40), number(48));
        Ok(Some(Self { first, count, end, times, marks, index: Index::Finished { pages } }))
    }

    /// Opens a file by its records, up to a height or to the first that is not right.
    pub(super) fn scan(
        file: &Arc<dyn DiskFile>,
        first: u64,
        last: u64,
        network: &[u8; 32],
    ) -> io::Result<Option<Self>> {
        if !Self::has_head(&**file, first, network)? {
            return Ok(None);
        }
        let mut found = Self::new(first);
        let length = file.len()?;
        let mut window = Window::new(Arc::clone(file))?;
        while found.next() <= last {
            let stored = match read_record(&mut window, found.next(), found.end, length) {
                Err(error) if error.kind() == ErrorKind::InvalidData => break,
                stored => stored?,
            };
            let bytes = stored.bytes.len();
            let Ok(result) = StoredResult::from_bytes(stored.bytes) else { break };
            found.add(bytes, result.time(), beginnings(&result));
        }
        Ok(Some(found))
    }

    fn has_head(file: &dyn DiskFile, first: u64, network: &[u8; 32]) -> io::Result<bool> {
        let mut head = vec![0; HEAD_BYTES as usize];
        let read = file.read_at(&mut head, 0)?;
        Ok(read == head.len() && head == Self::new(first).head(network))
    }
}

impl Spot {
    /// Reads the record.
    pub(super) fn read(self, file: &dyn DiskFile) -> io::Result<Bytes> {
        let (mut file, mut offset) = (file, self.offset);
        for _ in 0..self.skip {
            let (length, _) = record_head(&mut file, offset)?;
            offset += RECORD_HEAD_BYTES + u64::from(length);
        }
        Ok(read_record(&mut file, self.height, offset, self.end)?.bytes)
    }
}

impl Records {
    /// Calls `each` with the records of blocks whose time is `time` or later, in order, and perhaps with a few before
    /// them. Block time never goes back, so those that are older need not be read.
    pub(super) fn since<E>(
        &self,
        time: u64,
        file: &Arc<dyn DiskFile>,
        fault: impl Fn(&io::Error) -> E,
        mut each: impl FnMut(u64, Bytes) -> Result<(), E>,
    ) -> Result<(), E> {
        let from = self.mark_before(time, &**file).map_err(|error| fault(&error))?;
        let (mut height, mut offset) = (self.first + from * MARK_EVERY, self.offset(from));
        let mut window = Window::new(Arc::clone(file)).map_err(|error| fault(&error))?;
        while height < self.next {
            let stored = read_record(&mut window, height, offset, self.end).map_err(|error| fault(&error))?;
            offset = stored.next;
            each(height, stored.bytes)?;
            height += 1;
        }
        Ok(())
    }

    /// The last mark whose block is older; the first if none is.
    fn mark_before(&self, time: u64, mut file: &dyn DiskFile) -> io::Result<u64> {
        let (mut low, mut high) = (0, self.marks.len() as u64);
        while low < high {
            let middle = low + (high - low) / 2;
            let height = self.first + middle * MARK_EVERY;
            let stored = read_record(&mut file, height, self.offset(middle), self.end)?;
            let result = StoredResult::from_bytes(stored.bytes);
            let older = result.map_err(|fault| io::Error::new(ErrorKind::InvalidData, fault.message))?.time() < time;
            (low, high) = if older { (middle + 1, high) } else { (low, middle) };
        }
        Ok(low.saturating_sub(1))
    }

    fn offset(&self, mark: u64) -> u64 {
        let mark = usize::try_from(mark).ok().and_then(|mark| self.marks.get(mark));
        mark.map_or(HEAD_BYTES, |offset| u64::from(*offset))
    }
}

/// Where records are read from: a file, or a view of it for who reads on.
trait Source {
    fn fill(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<bool>;
}

impl Source for &dyn DiskFile {
    fn fill(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<bool> {
        Ok(self.read_at(buffer, offset)? == buffer.len())
    }
}

impl Source for Window {
    fn fill(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<bool> {
        let bytes = self.get(offset, buffer.len())?;
        let whole = bytes.len() == buffer.len();
        if whole {
            buffer.copy_from_slice(bytes);
        }
        Ok(whole)
    }
}

/// Position and beginning of the ids that a block has taken.
pub(super) fn beginnings(result: &StoredResult) -> impl Iterator<Item = (u32, u64)> + '_ {
    result.taken().map(|(position, id, _)| (position, index::beginning(&id)))
}

/// Appends the record of a block to `out`.
pub(super) fn encode_record(height: u64, result: &[u8], out: &mut Vec<u8>) {
    out.extend(u32::try_from(result.len()).unwrap_or(u32::MAX).to_le_bytes());
    out.extend(record_crc(height, result).to_le_bytes());
    out.extend(result);
}

fn record_crc(height: u64, result: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(&height.to_le_bytes()), result)
}

fn record_head(file: &mut impl Source, offset: u64) -> io::Result<(u32, u32)> {
    let mut head = [0; RECORD_HEAD_BYTES as usize];
    if !file.fill(offset, &mut head)? {
        return Err(damaged(offset));
    }
    let number = u64::from_le_bytes(head);
    Ok((number as u32, (number >> 32) as u32))
}

fn read_record(file: &mut impl Source, height: u64, offset: u64, end: u64) -> io::Result<Stored> {
    let (length, crc) = record_head(file, offset)?;
    let next = offset + RECORD_HEAD_BYTES + u64::from(length);
    if next > end {
        return Err(damaged(offset));
    }
    let bytes = read(file, offset + RECORD_HEAD_BYTES, length as usize)?;
    if record_crc(height, &bytes) != crc {
        return Err(damaged(offset));
    }
    Ok(Stored { bytes: bytes.into(), next })
}

fn read(file: &mut impl Source, offset: u64, bytes: usize) -> io::Result<Vec<u8>> {
    let mut buffer = vec![0; bytes];
    if file.fill(offset, &mut buffer)? { Ok(buffer) } else { Err(damaged(offset)) }
}

fn damaged(offset: u64) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, format!("the record at byte {offset} is damaged"))
}
