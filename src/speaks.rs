//! Says on the ledger which rules of execution this node speaks, so that the network can activate newer ones.

use crate::orderer::{Seat, Shared};
use crate::signer::Signer;
use bytes::Bytes;
use ledger::governance::{self, NodeRole, Speaks};
use ledger::{Admission, Rules};
use ledger_raft::{Input, Lane};
use ledger_rejection::{Code, Rejection};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval};

/// Time between two looks at what the ledger says. The first comes at the start, when nobody may lead yet.
const EVERY: Duration = Duration::from_secs(5);

/// The task that tells the ledger.
pub(crate) struct Telling {
    pub shared: Arc<Shared>,
    pub seat: Arc<Seat>,
    pub signer: Signer,
    /// Id of this node.
    pub me: u64,
}

impl Telling {
    /// Tells until the ledger says the same. What it says then changes only with another release, and so with a start.
    pub(crate) async fn run(self) {
        let mut time = interval(EVERY);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            time.tick().await;
            match self.tell() {
                Ok(true) => return,
                Ok(false) => {}
                Err(reason) => tracing::debug!(%reason, "cannot say now which rules this node speaks"),
            }
        }
    }

    /// Submits what this node speaks, unless the ledger says so already.
    fn tell(&self) -> Result<bool, Rejection> {
        let ledger = &self.shared.ledger;
        let nodes = governance::nodes(&**ledger.state())?;
        let own = nodes.iter().find(|node| node.id == self.me && node.role != NodeRole::Removed);
        let Some(own) = own else { return Ok(false) };
        let newest = Rules::NEWEST.number();
        let known = own.speaks.as_ref().map_or(ledger.rules().number(), |speaks| speaks.newest);
        if known == newest {
            return Ok(true);
        }
        let speaks = Speaks { newest, release: env!("CARGO_PKG_VERSION").to_owned() };
        let argument =
            serde_json::to_vec(&speaks).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        let signed = self.signer.sign(governance::NAME, "speak", vec![Bytes::from(argument)])?;
        let admission = ledger.admit(signed.encoded().clone(), self.shared.clock.now());
        if let Admission::New(transaction) = admission.map_err(|refusal| refusal.rejection)? {
            let transaction = transaction.encoded().clone();
            self.seat.input(Input::Submit { lane: Lane::Data, transaction })?;
        }
        Ok(false)
    }
}
