//! Says on the ledger which rules of execution this node speaks, so that the network can activate newer ones.

use crate::ordering::node_transactions::Author;
use ledger::msp::{self, NodeRole, Speaks};
use ledger_base::rejection::Rejection;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval};

/// Time between two looks at what the ledger says. The first comes at the start, when nobody may lead yet.
const EVERY: Duration = Duration::from_secs(5);

/// The task that tells the ledger.
pub(crate) struct Telling {
    /// Tells it.
    pub author: Arc<Author>,
    /// Id of this node.
    pub me: u64,
}

impl Telling {
    /// Tells until the ledger says the same. Its rules then change only with another release, and so with a start.
    pub(crate) async fn run(self) {
        let mut time = interval(EVERY);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            time.tick().await;
            match self.tell() {
                Ok(true) => return,
                Ok(false) => {}
                Err(reason) => {
                    tracing::debug!(code = reason.code.name(), %reason, "cannot register the supported rules now")
                }
            }
        }
    }

    /// Submits what this node speaks, unless the ledger says so already.
    fn tell(&self) -> Result<bool, Rejection> {
        let ledger = &self.author.storage.ledger;
        let nodes = msp::nodes(&**ledger.state())?;
        let own = nodes.iter().find(|node| node.id == self.me && node.role != NodeRole::Removed);
        let Some(own) = own else { return Ok(false) };
        let newest = ledger.registry().newest().number();
        let known = own.speaks.as_ref().map_or(ledger.rules().number(), |speaks| speaks.newest);
        if known == newest {
            return Ok(true);
        }
        let release = env!("CARGO_PKG_VERSION").to_owned();
        self.author.submit("speak", &Speaks { newest, release })?;
        Ok(false)
    }
}
