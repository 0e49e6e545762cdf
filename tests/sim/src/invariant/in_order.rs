//! No call overtakes another: the calls of one client about a subject are ordered as they came to the node. Only control,
//! which waits for no message, may go before messages.

use super::{Check, Violation};
use ledger_base::hash::Hash;
use ledger_raft::Lane;
use std::collections::BTreeMap;

/// Node, start of it, and stream.
pub(super) type StreamOf = (u64, u64, u64);

/// A call that is given to the orderer.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Over which stream it came.
    pub stream: StreamOf,
    /// Its subject.
    pub subject: Hash,
    /// Its lane.
    pub lane: Lane,
    /// See [`InOrder::arrives`].
    pub number: u64,
}

/// The newest call of each stream about each subject.
#[derive(Default)]
pub struct InOrder {
    next: u64,
    /// Number of the newest control and of the newest data.
    newest: BTreeMap<(StreamOf, Hash), (u64, u64)>,
}

impl InOrder {
    /// The number of a call that comes to a node: it grows.
    pub fn arrives(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    /// A call is given to the orderer.
    ///
    /// # Errors
    /// It came before one that was given earlier, and should have gone before it.
    pub fn ordered(&mut self, call: Call) -> Check {
        let Call { stream, subject, lane, number } = call;
        let (control, data) = self.newest.entry((stream, subject)).or_default();
        let before = match lane {
            Lane::Control => (*control).max(*data),
            Lane::Data => *data,
        };
        if number < before {
            let what = format!("{call:?} is ordered after number {before}, which came later");
            return Err(Violation::new("no call overtakes another", what));
        }
        match lane {
            Lane::Control => *control = number,
            Lane::Data => *data = number,
        }
        Ok(())
    }
}
