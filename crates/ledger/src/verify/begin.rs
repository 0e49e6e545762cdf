//! Where execution begins: with the genesis, or with a snapshot if the blocks begin above 1.

use crate::Hash;
use crate::archive::{SNAPSHOTS_DIRECTORY, oldest_snapshot, snapshot_name};
use crate::chain::Ledger;
use crate::chaincode::Registry;
use crate::code::Code;
use crate::rejection::Rejection;
use crate::segment::Base;
use crate::state::{MemoryState, State};
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
    /// Nodes that have signed this in blocks that were executed. Who does not trust the snapshot's origin looks here for
    /// nodes of organisations that they trust.
    pub attested_by: BTreeSet<String>,
}

/// A ledger in memory, ready to execute the first block.
pub(super) struct Beginning {
    pub(super) ledger: Ledger,
    pub(super) state: Arc<State>,
    /// Height and content of the snapshot it was begun from.
    pub(super) snapshot: Option<(u64, Hash)>,
}

impl Beginning {
    /// Begins where the blocks after `base` can be executed.
    pub(super) fn find(directory: &Path, genesis: &[u8], registry: &Registry, base: Base) -> Result<Self, Rejection> {
        let snapshots = directory.join(SNAPSHOTS_DIRECTORY);
        if base.index == 0 {
            let state = Arc::new(State::open(Box::new(MemoryState::default()))?);
            let ledger = Ledger::open(genesis, registry.clone(), Arc::clone(&state))?;
            return Ok(Self { ledger, state, snapshot: None });
        }
        let found = oldest_snapshot(&snapshots, base.index + 1)?;
        let name = found.map_or_else(|| "no snapshot before it".to_owned(), snapshot_name);
        Err(Rejection::new(Code::BadFile, format!("the blocks begin at {}", base.index + 1))
            .found(name)
            .wanted(format!(
                "blocks from 1 on, or a snapshot of height {} or above in {}",
                base.index,
                snapshots.display()
            ))
            .next("verify an archive of this node, which has the older blocks"))
    }
}
