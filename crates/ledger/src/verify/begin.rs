//! Where execution begins: with the genesis, or with a snapshot if the blocks begin above 1.

use crate::chain::Ledger;
use crate::chaincode::Registry;
use crate::network::Genesis;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::archive::{oldest_snapshot, snapshot_name};
use ledger_storage::layout::SNAPSHOTS_DIRECTORY;
use ledger_storage::results::ResultStore;
use ledger_storage::segment::Base;
use ledger_storage::snapshot::Snapshot;
use ledger_storage::state::{MemoryState, State};
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// The snapshot that the first block was executed on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Begun {
    /// Its height.
    pub height: u64,
    /// SHA-256 of its manifest: names its content.
    pub content: Hash,
    /// Nodes that have signed this in blocks that were executed. A reader who does not trust the snapshot's origin
    /// looks here for nodes of trusted organisations.
    pub attested_by: BTreeSet<String>,
}

/// A ledger in memory, ready to execute the first block.
pub(super) struct Beginning {
    pub(super) ledger: Ledger,
    /// Height and content of the snapshot it was begun from.
    pub(super) snapshot: Option<(u64, Hash)>,
}

impl Beginning {
    /// Begins where the blocks after `base` can be executed.
    pub(super) fn find(directory: &Path, genesis: &[u8], registry: &Registry, base: Base) -> Result<Self, Rejection> {
        let (store, results) = (MemoryState::default(), Arc::new(ResultStore::in_memory()));
        let mut begun = None;
        if base.index > 0 {
            let snapshot = find_snapshot(&directory.join(SNAPSHOTS_DIRECTORY), base)?;
            let (_, network) = Genesis::from_bytes(genesis)?;
            if snapshot.manifest().network != network {
                return Err(Rejection::new(
                    Code::WrongNetwork,
                    "the snapshot and the genesis belong to different \
                                                               networks",
                )
                .found(snapshot.manifest().network.to_string())
                .wanted(network.to_string()));
            }
            snapshot.fill(&store, &results)?;
            begun = Some((snapshot.manifest().height, snapshot.content()));
        }
        let state = Arc::new(State::open(Box::new(store))?);
        let ledger = Ledger::open(genesis, registry.clone(), state, results)?;
        Ok(Self { ledger, snapshot: begun })
    }
}

/// The snapshot from which the blocks after `base` can be executed.
fn find_snapshot(directory: &Path, base: Base) -> Result<Snapshot, Rejection> {
    match oldest_snapshot(directory, base.index + 1)? {
        Some(height) => Snapshot::open(&directory.join(snapshot_name(height))),
        None => Err(Rejection::new(Code::BadFile, format!("the blocks start at {}", base.index + 1))
            .found("no snapshot before it")
            .wanted(format!(
                "blocks from 1 on, or a snapshot of height {} or above in {}",
                base.index,
                directory.display()
            ))
            .next("verify an archive of this node, which contains the older blocks")),
    }
}
