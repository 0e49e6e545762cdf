//! Attestations: from time to time this node signs what it has computed into the ledger, and compares what the others
//! have signed with what it has computed itself.
//!
//! An attestation is a transaction `msp attest` with a height, the hash of its block and the state digest after it; for a
//! snapshot also the hash of its manifest. A network in which nothing happens attests nothing. One that contradicts this
//! node is a reason to ask the voters ([`crate::peers::chain_monitor`]), and nothing more.

use crate::ordering::Ordering;
use crate::ordering::node_transactions::Author;
use crate::peers::chain_monitor::ChainMonitor;
use ledger::msp::{self, Attest};
use ledger::{Ledger, Outcome};
use ledger_base::rejection::Rejection;
use ledger_replica::Observer;
use ledger_replica::company::Point;
pub(crate) use ledger_replica::witness::Seen;
use ledger_replica::witness::{Said, seen};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

/// The view that the rest of the node has of its witness.
pub(crate) struct Witness {
    seen: mpsc::UnboundedSender<Seen>,
    /// Height of the newest block that holds anything but attestations.
    ordinary: AtomicU64,
    /// Height of this node's newest snapshot.
    snapshot: AtomicU64,
}

impl Witness {
    /// A witness, and what it will have seen.
    pub(crate) fn new() -> (Arc<Self>, mpsc::UnboundedReceiver<Seen>) {
        // Bounded by what nodes sign: a record in the ledger for each.
        let (seen, attestations) = mpsc::unbounded_channel();
        let (ordinary, snapshot) = Default::default();
        (Arc::new(Self { seen, ordinary, snapshot }), attestations)
    }

    /// Height of this node's newest snapshot, as far as it was noticed; 0 if there is none.
    pub(crate) fn snapshot_height(&self) -> u64 {
        self.snapshot.load(Relaxed)
    }
}

impl Observer for Witness {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        let (attestations, ordinary) = seen(outcome);
        for attestation in attestations {
            let _stopping = self.seen.send(attestation);
        }
        if ordinary {
            self.ordinary.store(outcome.header.height, Relaxed);
        }
    }
}

/// The task that attests.
pub(crate) struct Attesting {
    /// Submits attestations.
    pub author: Arc<Author>,
    /// Results of execution, and the members of the network.
    pub ordering: Arc<Ordering>,
    /// The attestations of others.
    pub witness: Arc<Witness>,
    /// Receives what differs.
    pub monitor: Arc<ChainMonitor>,
    /// This node, `ORGANISATION/NAME`.
    pub me: String,
    /// Time between two attestations.
    pub every: Duration,
    /// Attestations as their blocks are executed.
    pub seen: mpsc::UnboundedReceiver<Seen>,
}

impl Attesting {
    /// Attests and judges until the node stops.
    pub(crate) async fn run(mut self) {
        let mut said = Said::default();
        // What was attested before this node started counts as well.
        for record in msp::attestations(&**self.ordering.storage.ledger.state()).unwrap_or_default() {
            let by = format!("{}/{}", record.organisation, record.node);
            self.hear(&mut said, &Seen { by, attest: record.latest.attest });
        }
        let mut time = interval(self.every);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let told = tokio::select! {
                attestation = self.seen.recv() => match attestation {
                    Some(attestation) => {
                        self.hear(&mut said, &attestation);
                        continue;
                    }
                    None => return,
                },
                _ = time.tick() => self.attest_tip(&said),
            };
            if let Err(reason) = told {
                // The next one tells as much.
                tracing::debug!(code = reason.code.name(), %reason, "cannot sign the state now");
            }
        }
    }

    fn attest_tip(&self, said: &Said) -> Result<(), Rejection> {
        let (ledger, snapshots) = (&self.ordering.storage.ledger, &self.ordering.storage.snapshots);
        let height = snapshots.newest().map_or(0, |snapshot| snapshot.manifest().height);
        self.witness.snapshot.store(height, Relaxed);
        if let Some(attest) = said.snapshot_due(ledger, snapshots)? {
            self.author.submit("attest", &attest)?;
        }
        let ordinary = self.witness.ordinary.load(Relaxed);
        match said.block_due(&ledger.tip(), ordinary, self.ordering.storage.log.store.durable_index()) {
            Some(attest) => self.author.submit("attest", &attest),
            None => Ok(()),
        }
    }

    fn hear(&self, said: &mut Said, Seen { by, attest }: &Seen) {
        if *by == self.me {
            said.note(attest);
            return;
        }
        let members = self.ordering.directory.members();
        // Who has left says nothing any more.
        let present = members.iter().find(|member| member.wanted.is_some() && member.full_name() == *by);
        if let Some(member) = present {
            let Attest { height, hash, digest, .. } = *attest;
            self.monitor.told(member, Point { height, hash, digest });
        }
    }
}
