//! The way of a reader: from where it was, over changes and proofs that a node shows, to the newest proof that it believes.

use crate::checkpoint::Checkpoint;
use crate::governance::{Change, Governance};
use crate::proof::Proof;
use ledger_base::rejection::{Code, Rejection};

/// Most bytes of changes that are kept before a proof shows that they are true.
const UNPROVED_BYTES_MAX: usize = 64 * 1024 * 1024;

/// The way of a reader.
#[derive(Clone, Debug)]
pub struct Way {
    governance: Governance,
    /// Changes that no proof covers yet.
    changes: Vec<Change>,
    bytes: usize,
    /// The proof that was followed last, or why the last one was not.
    reached: Option<Result<Proof, Rejection>>,
}

impl Way {
    /// Begins where the reader is.
    pub fn from(governance: Governance) -> Self {
        Self { governance, changes: Vec::new(), bytes: 0, reached: None }
    }

    /// Takes the writes of a change at that height, as a node shows them.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if too much is not proved; [`Code::Malformed`].
    pub fn change(&mut self, height: u64, writes: &[u8]) -> Result<(), Rejection> {
        self.bytes += writes.len();
        if self.bytes > UNPROVED_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "a node shows too many changes that it does not prove")
                .found(format!("{} bytes", self.bytes))
                .wanted(format!("at most {UNPROVED_BYTES_MAX} bytes before a proof"))
                .next("ask another node"));
        }
        self.changes.push(Change::from_bytes(height, writes)?);
        Ok(())
    }

    /// Goes on to a proof. One that cannot be followed is left out: a later one may be signed by more that are believed.
    pub fn follow(&mut self, proof: Proof) {
        self.reached = Some(self.governance.follow(&self.changes, &proof).map(|after| {
            self.changes.retain(|change| change.height > after.height());
            // What a later proof must cover still counts.
            self.bytes = self.changes.iter().map(|change| change.to_bytes().len()).sum();
            self.governance = after;
            proof
        }));
    }

    /// The end of the way.
    ///
    /// # Errors
    /// The reason why the last proof could not be followed; [`Code::NotFound`] if there was none.
    pub fn end(self) -> Result<Checkpoint, Rejection> {
        match self.reached {
            Some(Ok(proof)) => Ok(Checkpoint { governance: self.governance, proof }),
            Some(Err(refused)) => Err(refused),
            None => Err(Rejection::new(Code::NotFound, "the node has no proof of any block")
                .wanted("a block that a majority of the voters has signed, of two organisations at least")
                .next("look at ledgerctl status: do voters of two organisations run?")),
        }
    }
}
