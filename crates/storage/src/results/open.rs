//! Opening a directory of results, and holding it to the savepoint of the world state.

use super::file::ResultFile;
use super::{Open, ResultStore, failed};
use crate::disk::Disk;
use crate::state::Tip;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::collections::VecDeque;
use std::sync::Arc;

impl ResultStore {
    /// Opens the results in a directory. A wrong record is left out with all that follow;
    /// [`ResultStore::align`] finds out if they are missed.
    ///
    /// # Errors
    /// [`Code::DiskFailed`] if the directory cannot be read.
    pub fn open(disk: Arc<dyn Disk>, network: Hash) -> Result<Self, Rejection> {
        let names = disk.list().map_err(|error| failed("list", 0, &error))?;
        let firsts: Vec<u64> = names.iter().filter_map(|name| ResultFile::height(name)).collect();
        let mut files: VecDeque<Arc<ResultFile>> = VecDeque::new();
        let mut open = None;
        for first in firsts {
            if files.back().is_some_and(|before| before.next() != first) {
                break;
            }
            let file = disk.open(&ResultFile::name(first)).map_err(|error| failed("open", first, &error))?;
            let finished = ResultFile::finished(&*file, first, &network.0);
            if let Some(content) = finished.map_err(|error| failed("read", first, &error))? {
                files.push_back(Arc::new(content));
                continue;
            }
            let found = ResultFile::scan(&file, first, u64::MAX, &network.0);
            open = found.map_err(|error| failed("read", first, &error))?.map(|content| Open { content, file });
            break;
        }
        Ok(Self::new(Some(disk), network, files, open))
    }

    /// Cuts off what lies beyond the savepoint: those blocks are executed again.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if results are missing or belong to another chain: world state and results are to be made
    /// again then.
    pub fn align(&self, tip: &Tip) -> Result<(), Rejection> {
        let missing = |found: String| {
            Rejection::new(Code::Corrupt, "the results of blocks end before the world state")
                .found(found)
                .wanted(format!("results up to height {}", tip.height))
                .next(
                    "delete the directories state/ and results/ while the node is stopped; both are rebuilt from \
                       the blocks",
                )
        };
        self.cut(tip.height)?;
        if self.next() != tip.height + 1 {
            return Err(missing(format!("results up to height {}", self.next() - 1)));
        }
        if tip.height == 0 {
            return Ok(());
        }
        let last = self.get(tip.height)?.ok_or_else(|| missing("none".into()))?;
        if (last.hash(), last.digest()) == (tip.hash, tip.digest) {
            return Ok(());
        }
        Err(Rejection::new(Code::Corrupt, "the results of blocks and the world state do not match")
            .found(format!("height {}, block hash {}, state digest {}", tip.height, last.hash(), last.digest()))
            .wanted(format!("block hash {}, state digest {}", tip.hash, tip.digest))
            .next(
                "delete the directories state/ and results/ while the node is stopped; both are rebuilt from the \
                   blocks",
            ))
    }

    /// Drops the results above a height, and files that could not be read.
    fn cut(&self, last: u64) -> Result<(), Rejection> {
        let Some(disk) = &self.disk else { return Ok(()) };
        let next = self.next();
        let mut files = self.files_mut();
        let known = |first: u64| first <= last && first < next;
        let names = disk.list().map_err(|error| failed("list", 0, &error))?;
        let beyond: Vec<u64> =
            names.iter().filter_map(|name| ResultFile::height(name)).filter(|first| !known(*first)).collect();
        for first in beyond.iter().rev() {
            disk.remove(&ResultFile::name(*first)).map_err(|error| failed("remove", *first, &error))?;
        }
        if !beyond.is_empty() {
            disk.sync_dir().map_err(|error| failed("remove", last, &error))?;
        }
        files.finished.retain(|file| file.first <= last);
        if files.open.as_ref().is_some_and(|open| open.content.first > last) {
            files.open = None;
        }
        // The file in which the cut is becomes the one that is written.
        let split = match &files.open {
            Some(open) => open.content.next() > last + 1,
            None => files.finished.back().is_some_and(|file| file.next() > last + 1),
        };
        if split {
            let first = match files.open.take() {
                Some(open) => open.content.first,
                None => files.finished.pop_back().map_or(0, |file| file.first),
            };
            let reopened = disk.open(&ResultFile::name(first)).and_then(|file| {
                let content = ResultFile::scan(&file, first, last, &self.network.0)?;
                Ok(content.map(|content| Open { content, file }))
            });
            files.open = reopened.map_err(|error| failed("read", first, &error))?;
        }
        if let Some(open) = &files.open {
            let length = open.file.set_len(open.content.end);
            length.map_err(|error| failed("cut", open.content.first, &error))?;
        }
        self.recent().next = files.next();
        Ok(())
    }
}
