//! Turns between identities that ask. A question is read from the state or the store on a thread that others want, too.

use super::Looks;
use super::looks::Look;
use ledger_identity::Identity;
use ledger_raft::Lane;
use ledger_replica::gateway::Shares;
use std::sync::Arc;

/// The turns to read for somebody who asks. An identity has no more of them with many connections. Control is never asked for here:
/// it is submitted, and submissions have turns of their own.
#[derive(Clone)]
pub(crate) struct Questions {
    turns: Arc<Looks>,
    shares: Arc<Shares>,
}

impl Questions {
    /// On a runtime of so many workers.
    pub(crate) fn new(workers: usize, shares: &Arc<Shares>) -> Self {
        Self { turns: Looks::new(workers), shares: Arc::clone(shares) }
    }

    /// The right to read, until it is dropped; after those of the same identity who wait already. Its holder waits for nothing.
    pub(super) async fn turn(&self, reader: &Identity) -> Look {
        self.turns.turn(Lane::Data, &self.shares.of(reader.id())).await
    }
}
