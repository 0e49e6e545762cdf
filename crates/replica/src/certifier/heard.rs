//! The statements about one height.

use ledger_light::{Signed, Statement};
use std::collections::BTreeMap;

/// Contradictions of one node about one height whose signatures are checked at most.
const CONTRADICTIONS_MAX: u8 = 4;

/// The statements about one height.
#[derive(Default)]
pub(super) struct Height {
    /// The node's own statement, and whether the block changes whom others trust; none while it was not executed.
    pub(super) own: Option<(Statement, bool)>,
    /// The first statement of each node, this one included.
    pub(super) heard: BTreeMap<u64, Heard>,
    /// There is a certificate.
    pub(super) certified: bool,
}

/// The statement of a node.
pub(super) struct Heard {
    pub(super) signed: Signed,
    /// The signature was checked, and is good.
    pub(super) good: bool,
    contradictions: u8,
}

impl Heard {
    /// Its signature is good.
    pub(super) fn good(signed: Signed) -> Self {
        Self { signed, good: true, contradictions: 0 }
    }

    /// Nobody has looked at its signature yet.
    pub(super) fn unchecked(signed: Signed) -> Self {
        Self { signed, good: false, contradictions: 0 }
    }

    /// Is it worth to look at what contradicts it? Counts.
    pub(super) fn may_be_contradicted(&mut self) -> bool {
        self.contradictions = self.contradictions.saturating_add(1);
        self.contradictions <= CONTRADICTIONS_MAX
    }

    /// A lie was proved; no other one about this height is needed.
    pub(super) fn proved(&mut self) {
        self.contradictions = CONTRADICTIONS_MAX;
    }
}
