//! The end of a replica: of its node, or of one that fetches blocks before the next replica starts.

use super::Replica;
use crate::waiters::Waiter;
use ledger_storage::entry::Entry;

/// A last deed of a replica that takes nothing in any more.
#[derive(Debug, PartialEq)]
pub enum Last {
    /// Write the log, then tell [`Event::Written`](super::Event::Written).
    Write,
    /// Execute these blocks.
    Execute(Vec<Entry>),
}

impl<W: Waiter> Replica<W> {
    /// The next deed before the replica ends; nothing when all is done. World state and results are stored
    /// afterwards.
    ///
    /// The log is written once, if the engine waits for it. Blocks that are committed then are executed. A full disk keeps
    /// no replica
    /// from ending: everything that was acknowledged is on the disk already.
    pub fn end(&mut self) -> Option<Last> {
        if self.flush.is_some() && !std::mem::replace(&mut self.wrote_last, true) {
            return Some(Last::Write);
        }
        self.hand_out().map(Last::Execute)
    }
}
