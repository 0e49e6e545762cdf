//! Certified blocks: the voters whose signatures count, and the hashes that the next block builds on.

use super::Ledger;
use crate::msp;
use ledger_light::Voters;
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::Roots;
use ledger_storage::state::Tip;

impl Ledger {
    /// The voters as of [`Ledger::tip`]: those whose signatures count for the next block.
    ///
    /// # Errors
    /// As [`Ledger::members`].
    pub fn voters(&self) -> Result<Voters, Rejection> {
        msp::voters(&*self.state)
    }

    /// A statement about a block builds on the roots of the block before it.
    pub(super) fn check_roots(&self, tip: &Tip, roots: Option<Roots>) -> Result<(), Rejection> {
        let rules = self.registry.speaks(self.schedule().number_at(tip.height));
        let wanted = rules.is_some_and(|rules| rules.certifies_every().is_some());
        if !wanted || roots.is_some() {
            return Ok(());
        }
        Err(Rejection::new(Code::Corrupt, "the result of the newest block lacks control chain and results root")
            .found(format!("height {}", tip.height))
            .wanted("both, as its rules say")
            .next("delete the directories state/ and results/; the node makes both again from the blocks"))
    }
}
