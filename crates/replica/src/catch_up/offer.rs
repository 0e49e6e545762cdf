//! The blocks and snapshots of the other nodes.

use crate::REJOIN;
use crate::trust::given;
use ledger::Ledger;
use ledger::msp::{self, NodeRole};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Receipt, ReceiptKey, Status};
use ledger_storage::block_store::BlockStore;
use ledger_storage::snapshot::Snapshots;

/// A node that lacks no more blocks than this leaves it to replication.
const LAG_MIN: u64 = 1000;
/// Most receipts in one answer: one of the leader, one of a node that keeps what voters have confirmed.
pub const RECEIPTS_MAX: usize = 2;

/// A node that was asked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Who {
    /// Its number; 0 if only its address is known.
    pub id: u64,
    /// Its organisation; empty if only its address is known.
    pub organisation: String,
    /// Its name for people.
    pub name: String,
    /// The join token vouches for it.
    pub vouched: bool,
}

/// The blocks that a node says it has, and its snapshot.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Holding {
    /// Its newest block that is committed and durable.
    pub height: u64,
    /// The end of its log on disk. After a start it may be ahead of `height` until the node learns again how far the log is committed.
    pub durable: u64,
    /// Its oldest block.
    pub first_height: u64,
    /// The snapshot that it gives; 0 if it has none.
    pub snapshot_height: u64,
    /// The height that it says the asking node to have had. A claim, without a proof.
    pub yours: u64,
    /// Receipts of the asking node, which that node itself can check: at most [`RECEIPTS_MAX`].
    pub receipts: Vec<Receipt>,
    /// It knows the asking node as a voter.
    pub you_vote: bool,
    /// Its own receipt for its newest block, for whoever keeps it.
    pub receipt: Option<Receipt>,
}

/// The blocks of one node, and how to reach it.
#[derive(Clone, Debug)]
pub struct Offer<P> {
    /// The node.
    pub who: Who,
    /// Its blocks.
    pub has: Holding,
    /// For further questions.
    pub peer: P,
}

impl Holding {
    /// The answer of a node with these stores to the node `asking`. `status`: how ordering stands there, if it does.
    /// `confirmed`: what it remembers of the asking node. `key`: makes its own receipts.
    pub fn of(
        (ledger, store, snapshots): (&Ledger, &BlockStore, &Snapshots),
        status: Option<&Status>,
        (asking, confirmed): (u64, Option<&Receipt>),
        key: &ReceiptKey,
    ) -> Self {
        let peer = status.and_then(|status| status.peers.iter().find(|peer| peer.node == asking));
        let acknowledged = peer.map(|peer| peer.matched);
        let receipts: Vec<_> = peer
            .and_then(|peer| peer.receipt.clone())
            .into_iter()
            .chain(confirmed.cloned())
            .take(RECEIPTS_MAX)
            .collect();
        let known = acknowledged.into_iter().chain(confirmed.map(|receipt| receipt.index));
        let attestations = msp::attestations(&**ledger.state()).unwrap_or_default();
        let attested = attestations.iter().find(|said| said.id == asking).map(|said| said.latest.attest.height);
        let height = store_holds(store);
        Self {
            height,
            durable: store.durable_index(),
            first_height: store.first_index(),
            snapshot_height: given(ledger, snapshots).ok().flatten().map_or(0, |given| given.manifest().height),
            yours: known.chain(attested).max().unwrap_or_default(),
            receipts,
            you_vote: ledger.members().is_ok_and(|members| members.is_voter(asking)),
            receipt: Some(key.committed(height)),
        }
    }

    /// Has it this block?
    pub(super) fn holds(&self, height: u64) -> bool {
        self.first_height <= height && height <= self.height
    }
}

/// The newest block that a node may give to others: what is committed and durable there.
pub fn store_holds(store: &BlockStore) -> u64 {
    store.committed().min(store.durable_index())
}

/// Is there enough to fetch that it is worth it?
pub fn is_far_behind<'a>(ledger: &Ledger, offers: impl IntoIterator<Item = &'a Holding>) -> bool {
    let next = ledger.tip().height + 1;
    offers.into_iter().any(|has| has.height > next + LAG_MIN || has.first_height > next)
}

/// Does the ledger know this node? Before it does, it knows perhaps neither the leader nor whoever else may call.
///
/// # Errors
/// [`Code::NotAMember`] if it knows that this node was removed.
pub fn is_known(ledger: &Ledger, me: u64) -> Result<bool, Rejection> {
    let records = msp::nodes(&**ledger.state())?;
    let Some(record) = records.iter().find(|record| record.id == me) else { return Ok(false) };
    // Who was removed belongs here until the ordering has let it go.
    if record.role != NodeRole::Removed || ledger.members()?.contains(me) {
        return Ok(true);
    }
    Err(Rejection::new(Code::NotAMember, "this node was removed from the network")
        .found(format!("node {me}, removed, by the block of height {} or before", ledger.tip().height))
        .next(format!("to bring it back as a new node: {REJOIN}")))
}
