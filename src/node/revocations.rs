//! Revoked certificates lose their connections, of every kind.

use crate::process::caller::Members;
use crate::storage::Storage;
use ledger::msp::NAME;
use ledger::{Ledger, Outcome};
use ledger_base::invariant::vital_task;
use ledger_replica::Observer;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;

/// Time for streams to say that they end, and why.
const FAREWELL: Duration = Duration::from_millis(500);

/// Ends the connections of members that are none any more.
pub(super) struct Revocations {
    members: Arc<Members>,
    storage: Arc<Storage>,
    /// Where waiting costs no thread.
    runtime: Handle,
}

impl Revocations {
    /// Of these connections, by this ledger. Waits in the runtime of the caller.
    pub(super) fn new(members: &Arc<Members>, storage: &Arc<Storage>) -> Self {
        Self { members: Arc::clone(members), storage: Arc::clone(storage), runtime: Handle::current() }
    }
}

impl Observer for Revocations {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        if outcome.events.iter().any(|emitted| emitted.event.chaincode == NAME) {
            let (members, storage) = (Arc::clone(&self.members), Arc::clone(&self.storage));
            self.runtime.spawn(vital_task(async move {
                tokio::time::sleep(FAREWELL).await;
                members.end(|named| storage.ledger.check_revoked(&named.0).is_err());
            }));
        }
    }
}
