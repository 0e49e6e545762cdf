//! The governance of a network at its foundation: a light client that knows only the name of the network begins with it.

use crate::chaincode::Registry;
use crate::facts;
use crate::msp::{self, MspChaincode};
use crate::network::Genesis;
use ledger_base::rejection::Rejection;
use ledger_light::Governance;
use std::sync::Arc;

impl Genesis {
    /// The members and authorities at the genesis of a network: a reader that pinned the network's name begins there.
    ///
    /// # Errors
    /// As [`Genesis::from_bytes`].
    pub fn governance(bytes: &[u8]) -> Result<Governance, Rejection> {
        let (genesis, network) = Self::from_bytes(bytes)?;
        let mut registry = Registry::default();
        registry.install(Arc::new(MspChaincode))?;
        let change = facts::change(0, &msp::found(&genesis)?, &registry);
        Governance::founded(network, genesis.created, &change)
    }
}
