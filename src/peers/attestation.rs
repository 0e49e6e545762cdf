//! Attestations: from time to time this node signs what it has computed into the ledger, and compares what the others
//! have signed with what it has computed itself.
//!
//! An attestation is a transaction `msp attest` with a height, the hash of its block and the state digest after it; for a
//! snapshot also the hash of its manifest. A network in which nothing happens attests nothing. One that contradicts this
//! node is a reason to ask the voters ([`crate::peers::chain_monitor`]), and nothing more.

use crate::ordering::directory::Directory;
use crate::ordering::node_transactions::Author;
use crate::peers::chain_monitor::ChainMonitor;
use ledger::msp::{self, Attest};
use ledger::{Ledger, Outcome};
use ledger_base::rejection::Rejection;
use ledger_replica::Observer;
use ledger_replica::company::Point;
pub(crate) use ledger_replica::witness::Seen;
use ledger_replica::witness::{Said, seen};
use ledger_storage::block_store::BlockStore;
use ledger_storage::snapshot::Snapshots;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
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
        self.snapshot.load(Ordering::Relaxed)
    }
}

impl Observer for Witness {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        let (attestations, ordinary) = seen(outcome);
        for attestation in attestations {
            let _stopping = self.seen.send(attestation);
        }
        if ordinary {
            self.ordinary.store(outcome.header.height, Ordering::Relaxed);
        }
    }
}

/// The task of a witness.
pub(crate) struct Testimony {
    /// Submits attestations, and knows what was computed.
    pub author: Author,
    /// The snapshots of this node.
    pub snapshots: Arc<Snapshots>,
    /// The log, which holds what is attested.
    pub store: Arc<BlockStore>,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The attestations of others.
    pub witness: Arc<Witness>,
    /// Hears who differs.
    pub company: Arc<ChainMonitor>,
    /// This node, `ORGANISATION/NAME`.
    pub me: String,
    /// Time between two attestations.
    pub every: Duration,
}

impl Testimony {
    /// Attests and judges until the node stops.
    pub(crate) async fn run(self, mut seen: mpsc::UnboundedReceiver<Seen>) {
        let mut said = Said::default();
        // What was attested before this node started counts as well.
        for record in msp::attestations(&**self.author.ledger.state()).unwrap_or_default() {
            let by = format!("{}/{}", record.organisation, record.node);
            self.hear(&mut said, &Seen { by, attest: record.latest.attest });
        }
        let mut time = interval(self.every);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let told = tokio::select! {
                attestation = seen.recv() => match attestation {
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
                tracing::debug!(code = reason.code.name(), %reason, "cannot attest now");
            }
        }
    }

    fn attest_tip(&self, said: &Said) -> Result<(), Rejection> {
        let (ledger, snapshots) = (&self.author.ledger, &self.snapshots);
        let height = snapshots.newest().map_or(0, |snapshot| snapshot.manifest().height);
        self.witness.snapshot.store(height, Ordering::Relaxed);
        if let Some(attest) = said.snapshot_due(ledger, snapshots)? {
            self.author.submit("attest", &attest)?;
        }
        let ordinary = self.witness.ordinary.load(Ordering::Relaxed);
        match said.block_due(&ledger.tip(), ordinary, self.store.durable_index()) {
            Some(attest) => self.author.submit("attest", &attest),
            None => Ok(()),
        }
    }

    fn hear(&self, said: &mut Said, Seen { by, attest }: &Seen) {
        if *by == self.me {
            said.note(attest);
            return;
        }
        let members = self.directory.members();
        // Who has left says nothing any more.
        let present = members.iter().find(|member| member.wanted.is_some() && member.full_name() == *by);
        if let Some(member) = present {
            let Attest { height, hash, digest, .. } = *attest;
            self.company.told(member, Point { height, hash, digest });
        }
    }
}
