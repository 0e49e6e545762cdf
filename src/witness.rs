//! Attestations: from time to time this node signs what it has computed into the ledger, and compares what the others
//! have signed with what it has computed itself.
//!
//! An attestation is a transaction `msp attest` with a height, the hash of its block and the state digest after it; for a
//! snapshot also the hash of its manifest. A network in which nothing happens attests nothing.
//!
//! ```text
//! witness        what is attested and when; what others attest
//!   judge        what a contradiction means
//!   difference   where it began: height and key
//! ```
//!
//! A node that more than half of the members contradict stops and says where the difference began. It leaves a mark, so
//! that its next start makes the world state anew from the blocks.

mod difference;
mod judge;

use crate::instance::Fate;
use crate::peers::{Dialer, Directory};
use crate::signer::Author;
use judge::{Finding, Judge};
use ledger::msp;
use ledger::{Ledger, Outcome};
use ledger_rejection::{Code, Rejection};
use ledger_replica::Observer;
pub(crate) use ledger_replica::witness::Seen;
use ledger_replica::witness::{Said, seen};
use ledger_storage::snapshot::Snapshots;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

/// The mark of a world state that contradicts the others', in the data directory.
pub(crate) const DIVERGED_FILE: &str = "diverged";

/// The view that the rest of the node has of its witness.
pub(crate) struct Witness {
    seen: mpsc::UnboundedSender<Seen>,
    /// Height of the newest block that holds anything but attestations.
    ordinary: AtomicU64,
    /// Height of this node's newest snapshot.
    snapshot: AtomicU64,
    differing: Mutex<String>,
}

impl Witness {
    /// A witness, and what it will have seen.
    pub(crate) fn new() -> (Arc<Self>, mpsc::UnboundedReceiver<Seen>) {
        // Bounded by what nodes sign: a record in the ledger for each.
        let (seen, attestations) = mpsc::unbounded_channel();
        let (ordinary, snapshot, differing) = Default::default();
        (Arc::new(Self { seen, ordinary, snapshot, differing }), attestations)
    }

    /// Height of this node's newest snapshot, as far as it was noticed; 0 if there is none.
    pub(crate) fn snapshot_height(&self) -> u64 {
        self.snapshot.load(Ordering::Relaxed)
    }

    /// The members that contradict this node, in words; empty if nobody does.
    pub(crate) fn divergence(&self) -> String {
        self.differing.lock().unwrap_or_else(PoisonError::into_inner).clone()
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
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The attestations of others.
    pub witness: Arc<Witness>,
    /// Ends a node that is wrong.
    pub fate: Fate,
    /// Asks a node that differs.
    pub dialer: Dialer,
    /// This node, `ORGANISATION/NAME`.
    pub me: String,
    /// Time between two attestations.
    pub every: Duration,
    /// The data directory.
    pub data: PathBuf,
}

/// The memory of the task.
#[derive(Default)]
struct Memory {
    judge: Judge,
    said: Said,
}

impl Testimony {
    /// Attests and judges until the node stops.
    pub(crate) async fn run(self, mut seen: mpsc::UnboundedReceiver<Seen>) {
        let mut memory = Memory::default();
        // What was attested before this node started counts as well.
        for record in msp::attestations(&**self.author.ledger.state()).unwrap_or_default() {
            let by = format!("{}/{}", record.organisation, record.node);
            self.judge(&mut memory, Seen { by, attest: record.latest.attest }).await;
        }
        let mut time = interval(self.every);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let told = tokio::select! {
                attestation = seen.recv() => match attestation {
                    Some(attestation) => {
                        self.judge(&mut memory, attestation).await;
                        continue;
                    }
                    None => return,
                },
                _ = time.tick() => self.attest_tip(&memory),
            };
            if let Err(reason) = told {
                // The next one tells as much.
                tracing::debug!(%reason, "cannot attest now");
            }
        }
    }

    fn attest_tip(&self, memory: &Memory) -> Result<(), Rejection> {
        let (ledger, snapshots) = (&self.author.ledger, &self.snapshots);
        let height = snapshots.newest().map_or(0, |snapshot| snapshot.manifest().height);
        self.witness.snapshot.store(height, Ordering::Relaxed);
        if let Some(attest) = memory.said.snapshot_due(ledger, snapshots)? {
            self.author.submit("attest", &attest)?;
        }
        match memory.said.block_due(ledger, self.witness.ordinary.load(Ordering::Relaxed)) {
            Some(attest) => self.author.submit("attest", &attest),
            None => Ok(()),
        }
    }

    async fn judge(&self, memory: &mut Memory, Seen { by, attest }: Seen) {
        if by == self.me {
            memory.said.note(&attest);
            return;
        }
        // What is not kept any more, or not yet executed, is not judged.
        let Ok(Some(own)) = self.author.ledger.block_hashes(attest.height) else { return };
        let agrees = own.digest == attest.digest && own.hash == attest.hash;
        let finding = memory.judge.judge(&by, attest.height, agrees, self.directory.members().len());
        *self.witness.differing.lock().unwrap_or_else(PoisonError::into_inner) = memory.judge.describe();
        match finding {
            Finding::Agrees => {}
            Finding::Differs => tracing::error!(
                node = by,
                height = attest.height,
                own = %own.digest,
                attested = %attest.digest,
                "this node and another differ; nobody knows yet which is right"
            ),
            Finding::Outvoted => self.stop(&memory.judge).await,
        }
    }

    /// This node is wrong: it stops serving, and says where that began.
    async fn stop(&self, judge: &Judge) {
        self.author.seat.stop();
        let mark = self.data.join(DIVERGED_FILE);
        if let Err(error) = std::fs::write(&mark, judge.describe()) {
            tracing::error!(%error, mark = %mark.display(), "cannot mark the world state");
        }
        let began = difference::find(&self.author.ledger, &self.directory, &self.dialer, judge).await;
        self.fate.fail(
            Rejection::new(Code::Diverged, "the world state of this node differs from that of most others")
                .found(judge.describe())
                .wanted(began)
                .next(
                    "start the node again: it makes its world state anew from its blocks; if it stops again, it runs \
                     another program than the others",
                ),
        );
    }
}
