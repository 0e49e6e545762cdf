//! The signers that a block accepts. A change of an organisation counts for the transactions behind it in the same block: its
//! members lose an authority at once.

use crate::identities::Identities;
use crate::msp::{self, ORGANISATION_KEYS};
use ledger_base::rejection::Rejection;
use ledger_storage::state::{Overlay, WriteSet};

/// The identities by the organisations as the transactions of a block so far have left them.
pub(super) struct Trust<'a> {
    /// Those by the organisations of the block before.
    before: &'a Identities,
    /// The writes to organisations in this block, and the identities by them; none before the first one.
    changed: Option<(WriteSet, Identities)>,
}

impl<'a> Trust<'a> {
    /// At the beginning of a block.
    pub(super) fn new(before: &'a Identities) -> Self {
        Self { before, changed: None }
    }

    /// Before the next transaction.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Corrupt`] if an organisation cannot be read.
    pub(super) fn now(&mut self, overlay: &Overlay) -> Result<&Identities, Rejection> {
        if !overlay.written(ORGANISATION_KEYS).eq(self.changed.iter().flat_map(|(writes, _)| writes)) {
            let writes = overlay.written(ORGANISATION_KEYS).map(|(key, value)| (key.clone(), value.clone())).collect();
            let identities = self.before.with(&msp::organisations_in(overlay)?)?;
            self.changed = Some((writes, identities));
        }
        Ok(self.changed.as_ref().map_or(self.before, |(_, identities)| identities))
    }
}
