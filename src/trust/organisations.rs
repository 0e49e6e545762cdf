//! The organisations on the ledger, for TLS.

use crate::process::clock::Clock;
use ledger::Ledger;
use ledger_api::tls::TrustSource;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use std::sync::Arc;

/// The organisations on a ledger.
pub(crate) struct Organisations {
    ledger: Arc<Ledger>,
    clock: Clock,
}

impl Organisations {
    /// Those of this ledger, as they change.
    pub(crate) fn new(ledger: &Arc<Ledger>, clock: Clock) -> Self {
        Self { ledger: Arc::clone(ledger), clock }
    }
}

impl TrustSource for Organisations {
    fn msps(&self) -> Arc<Msps> {
        self.ledger.msps()
    }

    fn now(&self) -> u64 {
        self.clock.wall()
    }

    fn revoked(&self, identity: &Identity) -> bool {
        self.ledger.check_revoked(identity).is_err()
    }
}
