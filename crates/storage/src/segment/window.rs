//! A moving view of a file, so that reading a segment takes little memory and few calls.

use std::io;
use std::sync::Arc;

use crate::disk::DiskFile;

/// How much is read at once.
const WINDOW_BYTES: usize = 256 << 10;

/// How much is read at once of a file of which only the beginning is wanted.
const SMALL_BYTES: usize = 8 << 10;

pub(crate) struct Window {
    file: Arc<dyn DiskFile>,
    /// Length of the file when the view was made.
    length: u64,
    /// Offset of the first byte held.
    start: u64,
    bytes: Vec<u8>,
    /// How much is read at once.
    piece: usize,
}

impl Window {
    pub(crate) fn new(file: Arc<dyn DiskFile>) -> io::Result<Self> {
        let length = file.len()?;
        Ok(Self { file, length, start: 0, bytes: Vec::new(), piece: WINDOW_BYTES })
    }

    /// A view for who wants a little only.
    pub(crate) fn small(file: Arc<dyn DiskFile>) -> io::Result<Self> {
        Ok(Self { piece: SMALL_BYTES, ..Self::new(file)? })
    }

    /// The bytes from `offset` on: `count`, or fewer where the file ends.
    pub(crate) fn get(&mut self, offset: u64, count: usize) -> io::Result<&[u8]> {
        let rest = usize::try_from(self.length.saturating_sub(offset)).unwrap_or(usize::MAX);
        let count = count.min(rest);
        let held = offset.checked_sub(self.start).and_then(|at| usize::try_from(at).ok());
        let at = match held {
            Some(at) if at.saturating_add(count) <= self.bytes.len() => at,
            _ => {
                self.bytes.resize(count.max(self.piece.min(rest)), 0);
                self.start = offset;
                let read = self.file.read_at(&mut self.bytes, offset)?;
                self.bytes.truncate(read);
                0
            }
        };
        Ok(self.bytes.get(at..).map_or(&[], |bytes| bytes.get(..count).unwrap_or(bytes)))
    }

    /// Offset of the last byte from `offset` on that is not zero.
    pub(super) fn last_non_zero(&mut self, offset: u64) -> io::Result<Option<u64>> {
        let mut last = None;
        let mut at = offset;
        while at < self.length {
            let piece = self.get(at, WINDOW_BYTES)?;
            if piece.is_empty() {
                break;
            }
            if let Some(found) = piece.iter().rposition(|byte| *byte != 0) {
                last = Some(at + found as u64);
            }
            at += piece.len() as u64;
        }
        Ok(last)
    }

    /// Offset of the first byte from `offset` on that is not zero.
    pub(super) fn first_non_zero(&mut self, offset: u64) -> io::Result<Option<u64>> {
        let mut at = offset;
        while at < self.length {
            let piece = self.get(at, WINDOW_BYTES)?;
            if piece.is_empty() {
                break;
            }
            if let Some(found) = piece.iter().position(|byte| *byte != 0) {
                return Ok(Some(at + found as u64));
            }
            at += piece.len() as u64;
        }
        Ok(None)
    }
}
