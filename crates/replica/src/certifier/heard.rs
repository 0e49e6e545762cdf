//! The statements about one height.

use ledger_light::{Misbehaviour, Signed, Statement};
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
    /// This node has passed it on.
    pub(super) passed: bool,
    contradictions: u8,
    /// A lie, and a fault, was proved.
    proved: [bool; 2],
}

impl Heard {
    /// Its signature is good.
    pub(super) fn good(signed: Signed) -> Self {
        Self { good: true, ..Self::unchecked(signed) }
    }

    /// Nobody has looked at its signature yet.
    pub(super) fn unchecked(signed: Signed) -> Self {
        Self { signed, good: false, passed: false, contradictions: 0, proved: [false; 2] }
    }

    /// Is it worth to look at the signature of what contradicts it? Counts.
    pub(super) fn may_be_contradicted(&mut self) -> bool {
        self.contradictions = self.contradictions.saturating_add(1);
        self.contradictions <= CONTRADICTIONS_MAX
    }

    /// The other statement of the same node proves a lie or a fault, if none of this kind was proved before.
    pub(super) fn contradicted_by(&mut self, other: Signed) -> Option<Misbehaviour> {
        let proof = Misbehaviour::of(self.signed.clone(), other)?;
        let proved = self.proved.get_mut(usize::from(proof.is_lie()))?;
        (!std::mem::replace(proved, true)).then_some(proof)
    }
}
