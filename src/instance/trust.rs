//! What an instance trusts: the organisations on its ledger.

use crate::clock::wall;
use ledger::Ledger;
use ledger_api::tls::TrustSource;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use std::sync::Arc;

/// The organisations on a ledger.
pub(super) struct Trust {
    ledger: Arc<Ledger>,
}

impl Trust {
    /// Those of this ledger, as they change.
    pub(super) fn new(ledger: &Arc<Ledger>) -> Self {
        Self { ledger: Arc::clone(ledger) }
    }
}

impl TrustSource for Trust {
    fn msps(&self) -> Arc<Msps> {
        self.ledger.msps()
    }

    fn now(&self) -> u64 {
        wall()
    }

    fn revoked(&self, identity: &Identity) -> bool {
        self.ledger.check_revoked(identity).is_err()
    }
}
