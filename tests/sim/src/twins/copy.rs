//! A node, or one of the two copies of a liar's: storage, and the real parts that run on it.

use super::cast::Keys;
use crate::node::Node;
use bytes::Bytes;
use ledger::Ledger;
use ledger::block::Header;
use ledger::branch::CertifiedBranch;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use ledger_light::Certificate;
use ledger_replica::certifier::Certifier;
use ledger_replica::company::{Company, Point};
use ledger_replica::disputes::{Disputes, Evidence};
use ledger_replica::{Answer, Event, Executor, Replica, Waiter};
use ledger_storage::block_store::BlockStore;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// A machine and its process.
pub(super) struct Copy {
    /// Its disks and clock, and its number in the ordering protocol.
    pub(super) node: Node,
    /// `Org1/node1`.
    pub(super) name: String,
    /// Which of the liar's two stories it tells; 0 for honest nodes.
    pub(super) face: usize,
    /// Its organisation lies.
    pub(super) lies: bool,
    /// It never starts again.
    pub(super) gone: bool,
    /// The reason for which it has stopped by itself.
    pub(super) ended: Option<Code>,
    /// The proofs on its disk.
    pub(super) evidence: Arc<Evidence>,
    /// The certificates on its disk.
    pub(super) certificates: BTreeMap<u64, Certificate>,
    /// Contradicted, it has signed that it joins anew.
    pub(super) joins: Option<Transaction>,
    /// The process.
    pub(super) up: Option<Up>,
}

/// The process of a node.
pub(super) struct Up {
    pub(super) replica: Replica<Nobody>,
    pub(super) executor: Arc<Executor>,
    pub(super) store: Arc<BlockStore>,
    pub(super) ledger: Arc<Ledger>,
    pub(super) certifier: Certifier<Keys>,
    pub(super) disputes: Disputes<Keys>,
    pub(super) company: Company<Arc<Ledger>>,
    /// The executed blocks.
    pub(super) headers: BTreeMap<u64, Header>,
    pub(super) flushing: bool,
    pub(super) inbox: VecDeque<Event>,
    /// When the order thread is woken next.
    pub(super) turn_at: u64,
    /// Since when most voters have another history that nobody has certified.
    pub(super) forked: Option<u64>,
    /// The nodes whose logs contradict its own, as the engine has found.
    pub(super) contradicting: BTreeSet<u64>,
    /// Counts its looks at the time.
    pub(super) beats: u64,
}

impl Copy {
    /// The newest height for which it has a certificate.
    pub(super) fn certified(&self) -> u64 {
        self.certificates.keys().next_back().copied().unwrap_or_default()
    }

    /// It has stopped because a strict certificate contradicts it.
    pub(super) fn is_contradicted(&self) -> bool {
        self.ended == Some(Code::Contradicted)
    }

    /// It is there, or comes back by itself.
    pub(super) fn lives(&self) -> bool {
        !self.gone && self.ended.is_none()
    }
}

impl Up {
    /// The chain at a height, or at the tip if that is lower.
    pub(super) fn point(&self, height: u64) -> Option<Point> {
        let tip = self.ledger.tip();
        if height >= tip.height {
            return Some(Point { height: tip.height, hash: tip.hash, digest: tip.digest });
        }
        let block = self.ledger.block_hashes(height).unwrap()?;
        Some(Point { height, hash: block.hash, digest: block.digest })
    }

    /// The certified part of the chain from a height on, or the newest certificate (`src/peers/sync/serve.rs`).
    pub(super) fn branch(&self, height: u64, certificates: &BTreeMap<u64, Certificate>) -> Option<CertifiedBranch> {
        let Some((last, certificate)) = certificates.range(height..).next() else {
            return Some(CertifiedBranch::of(certificates.values().next_back()?.clone()));
        };
        let headers: Option<Vec<Header>> = (height..=*last).map(|height| self.headers.get(&height).cloned()).collect();
        CertifiedBranch::new(headers?, certificate.clone()).ok()
    }

    /// The entry of the log at a height: term and content.
    pub(super) fn entry(&self, height: u64) -> Option<(u64, Bytes)> {
        let entry = self.store.entry(height).ok().flatten()?;
        Some((entry.term, entry.data))
    }
}

/// No client waits at a node: what is executed is seen in the blocks.
pub(super) struct Nobody;

impl Waiter for Nobody {
    fn answer(self, _answer: &Answer<'_>) {}

    fn name(&self) -> &str {
        ""
    }

    fn is_gone(&self) -> bool {
        true
    }
}
