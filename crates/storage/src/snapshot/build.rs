//! Making a snapshot of what a state has stored.

use super::manifest::{CHUNK_BYTES_MAX, CHUNKS_MAX, Chunk, Manifest};
use super::{Complete, damaged, failed, file, items};
use crate::disk::{Disk, DiskFile};
use crate::results::ResultStore;
use crate::state::{State, Tip};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;

/// Pairs that are read from the store at once.
const PAIRS_AT_ONCE: usize = 64;

/// Writes the snapshot of the stored state to a file. Nobody may store meanwhile.
pub(super) fn build(
    (disk, name): (&dyn Disk, &str),
    network: Hash,
    (tip, state): (&Tip, &State),
    (results, since): (&ResultStore, u64),
    complete: &mut Complete<'_>,
) -> Result<(), Rejection> {
    let file = disk.create(name).map_err(|error| failed("create", name, &error))?;
    let mut chunks = Chunks::begin(&file, name)?;
    let mut after = None;
    loop {
        let pairs = state.stored_world(after.as_deref(), PAIRS_AT_ONCE)?;
        let Some((last, _)) = pairs.last() else { break };
        after = Some(last.clone());
        for (key, value) in &pairs {
            items::put_pair(key, value, &mut chunks.stream);
            chunks.cut()?;
        }
    }
    results.since(since, tip.height, |height, stored| {
        let result = complete(height, stored)?
            .ok_or_else(|| Rejection::new(Code::Corrupt, format!("block {height}, of the last 120 s, is missing")))?;
        items::put_result(height, &result.determined().to_bytes(), &mut chunks.stream);
        chunks.cut()
    })?;
    chunks.finish(network, tip)
}

/// The stream of items, cut into chunks.
struct Chunks<'a> {
    file: &'a Arc<dyn DiskFile>,
    name: &'a str,
    offset: u64,
    stream: Vec<u8>,
    chunks: Vec<Chunk>,
}

impl<'a> Chunks<'a> {
    fn begin(file: &'a Arc<dyn DiskFile>, name: &'a str) -> Result<Self, Rejection> {
        let mut chunks = Self { file, name, offset: 0, stream: Vec::new(), chunks: Vec::new() };
        chunks.write(&file::head())?;
        Ok(chunks)
    }

    /// Writes the chunks that are complete.
    fn cut(&mut self) -> Result<(), Rejection> {
        let whole = self.stream.len() / CHUNK_BYTES_MAX * CHUNK_BYTES_MAX;
        if whole == 0 {
            return Ok(());
        }
        let stream = std::mem::take(&mut self.stream);
        let (whole, rest) = stream.split_at_checked(whole).unwrap_or_default();
        self.stream.reserve(2 * CHUNK_BYTES_MAX);
        self.stream.extend_from_slice(rest);
        whole.chunks(CHUNK_BYTES_MAX).try_for_each(|chunk| self.chunk(chunk))
    }

    fn chunk(&mut self, chunk: &[u8]) -> Result<(), Rejection> {
        if self.chunks.len() >= CHUNKS_MAX {
            return Err(Rejection::new(Code::TooLarge, "the world state is too large for a snapshot")
                .found(format!("more than {CHUNKS_MAX} chunks"))
                .wanted(format!("at most {CHUNKS_MAX} chunks of {CHUNK_BYTES_MAX} bytes")));
        }
        self.chunks.push(Chunk { hash: Hash::of(&[chunk]), bytes: u32::try_from(chunk.len()).unwrap_or(u32::MAX) });
        self.write(chunk)
    }

    fn finish(mut self, network: Hash, tip: &Tip) -> Result<(), Rejection> {
        let rest = std::mem::take(&mut self.stream);
        if !rest.is_empty() {
            self.chunk(&rest)?;
        }
        if self.chunks.is_empty() {
            return Err(damaged(self.name, "the state is empty"));
        }
        let chunks = std::mem::take(&mut self.chunks);
        let manifest = Manifest { network, height: tip.height, tip: tip.clone(), chunks };
        self.write(&file::end(&manifest))?;
        self.file.sync_data().map_err(|error| failed("sync", self.name, &error))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Rejection> {
        self.file.write_at(bytes, self.offset).map_err(|error| failed("write", self.name, &error))?;
        self.offset += bytes.len() as u64;
        Ok(())
    }
}
