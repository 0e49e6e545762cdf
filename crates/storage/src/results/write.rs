//! Writing results: appending, finishing files, dropping them.

use super::file::{ResultFile, encode_record};
use super::{Open, Pending, RESULTS_FILE_BYTES_MAX, ResultStore, Writing, failed};
use crate::disk::{Disk, DiskFile};
use ledger_base::rejection::{Code, Rejection};
use std::sync::{Arc, MutexGuard, PoisonError};

/// Results are written in pieces of about this size: as much as is noted, or taken out of memory, under one lock.
const PIECE_BYTES: usize = 256 * 1024;

impl ResultStore {
    /// Makes the results up to a height durable. Readers and `push` go on beside it.
    ///
    /// # Errors
    /// [`Code::DiskFull`]: nothing is lost, it can be tried again. [`Code::DiskFailed`], for good after a failed sync.
    pub fn flush(&self, height: u64) -> Result<(), Rejection> {
        let mut writing = self.writing()?;
        let Some(disk) = &self.disk else {
            self.forget(height);
            return Ok(());
        };
        loop {
            let piece = self.piece(height);
            let Some(first) = piece.first() else { break };
            let (file, end) = self.file_for(&**disk, first.height)?;
            let mut bytes = Vec::with_capacity(piece.iter().map(|pending| pending.weight()).sum());
            for pending in &piece {
                encode_record(pending.height, &pending.bytes, &mut bytes);
            }
            writing.unsynced = true;
            file.write_at(&bytes, end).map_err(|error| failed("write", self.open_first(), &error))?;
            if self.written(&piece) {
                self.finish(&mut writing)?;
            }
        }
        self.sync(&mut writing)
    }

    /// Drops the files whose blocks are all below `keep_from`, except for the one before it: its last result has the hash
    /// that the next block follows. Nor is anything dropped of block time `keep_since` or later. Answers with the height
    /// of the oldest result that is left.
    ///
    /// # Errors
    /// [`Code::DiskFailed`].
    pub fn prune(&self, keep_from: u64, keep_since: u64) -> Result<u64, Rejection> {
        let _writing = self.writing()?;
        let Some(disk) = &self.disk else { return Ok(self.first()) };
        let mut dropped = false;
        loop {
            let oldest = {
                let mut files = self.files_mut();
                let droppable = |file: &Arc<ResultFile>| file.next() < keep_from && file.times.1 < keep_since;
                let oldest = files.finished.front().filter(|file| droppable(file)).map(|file| file.first);
                if oldest.is_some() {
                    files.finished.pop_front();
                }
                oldest
            };
            let Some(first) = oldest else { break };
            disk.remove(&ResultFile::name(first)).map_err(|error| failed("remove", first, &error))?;
            dropped = true;
        }
        if dropped {
            disk.sync_dir().map_err(|error| failed("remove", keep_from, &error))?;
        }
        Ok(self.first())
    }

    /// Lets an empty store begin at a height, to go on after a snapshot.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if it is not empty: its results belong to a world state that is lost.
    pub fn begin(&self, height: u64) -> Result<(), Rejection> {
        let _writing = self.writing()?;
        let in_files = {
            let files = self.files();
            !files.finished.is_empty() || files.open.is_some()
        };
        let mut recent = self.recent();
        if in_files || !recent.pending.is_empty() {
            return Err(Rejection::new(
                Code::Corrupt,
                "there are results of blocks, but the world state after them is lost",
            )
            .found(format!("results up to height {}", recent.next.saturating_sub(1)))
            .wanted("no results, as the world state starts with a snapshot"));
        }
        recent.next = height;
        Ok(())
    }

    fn writing(&self) -> Result<MutexGuard<'_, Writing>, Rejection> {
        let writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if writing.failed {
            return Err(Rejection::new(Code::DiskFailed, "results cannot be written, because an earlier sync failed")
                .next("restart the node: it executes the missing blocks again"));
        }
        Ok(writing)
    }

    /// The next results to write, up to a height.
    pub(super) fn piece(&self, height: u64) -> Vec<Arc<Pending>> {
        let recent = self.recent();
        let mut bytes = 0;
        let within = recent.pending.iter().take_while(|pending| {
            let wanted = pending.height <= height && bytes < PIECE_BYTES;
            bytes += pending.bytes.len();
            wanted
        });
        within.cloned().collect()
    }

    /// The file that takes the results from a height on, and where.
    pub(super) fn file_for(&self, disk: &dyn Disk, height: u64) -> Result<(Arc<dyn DiskFile>, u64), Rejection> {
        if let Some(open) = &self.files().open {
            return Ok((Arc::clone(&open.file), open.content.end));
        }
        let content = ResultFile::new(height);
        let created = disk.create(&ResultFile::name(height)).and_then(|file| {
            file.write_at(&content.head(&self.network.0), 0)?;
            disk.sync_dir()?;
            Ok(file)
        });
        let file = created.map_err(|error| failed("create", height, &error))?;
        let end = content.end;
        self.files_mut().open = Some(Open { content, file: Arc::clone(&file) });
        Ok((file, end))
    }

    /// These are in the file now. Is it full?
    pub(super) fn written(&self, piece: &[Arc<Pending>]) -> bool {
        let full = {
            let mut files = self.files_mut();
            let Some(open) = &mut files.open else { return false };
            for pending in piece {
                open.content.add(pending.bytes.len(), pending.time, pending.taken.iter().copied());
            }
            open.content.end >= RESULTS_FILE_BYTES_MAX
        };
        let weight: usize = piece.iter().map(|pending| pending.weight()).sum();
        let mut recent = self.recent();
        recent.bytes -= weight;
        recent.pending.drain(..piece.len());
        full
    }

    /// Writes the end of the open file.
    fn finish(&self, writing: &mut Writing) -> Result<(), Rejection> {
        let (finished, bytes, file) = {
            let files = self.files();
            let Some(open) = &files.open else { return Ok(()) };
            let (finished, bytes) = open.content.finish();
            (finished, bytes, Arc::clone(&open.file))
        };
        // Not even its end may follow bytes of a longer one.
        let written =
            file.write_at(&bytes, finished.end).and_then(|()| file.set_len(finished.end + bytes.len() as u64));
        written.map_err(|error| failed("write", finished.first, &error))?;
        self.sync(writing)?;
        let mut files = self.files_mut();
        files.finished.push_back(Arc::new(finished));
        files.open = None;
        Ok(())
    }

    fn sync(&self, writing: &mut Writing) -> Result<(), Rejection> {
        let open = self.files().open.as_ref().map(|open| (Arc::clone(&open.file), open.content.first));
        let Some((file, first)) = open.filter(|_| writing.unsynced) else { return Ok(()) };
        if let Err(error) = file.sync_data() {
            writing.failed = true;
            return Err(failed("sync", first, &error));
        }
        writing.unsynced = false;
        Ok(())
    }

    fn open_first(&self) -> u64 {
        self.files().open.as_ref().map_or(0, |open| open.content.first)
    }

    fn forget(&self, height: u64) {
        let mut recent = self.recent();
        while let Some(pending) = recent.pending.pop_front_if(|pending| pending.height <= height) {
            recent.bytes -= pending.weight();
        }
    }
}
