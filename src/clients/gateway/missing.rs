//! The rejections of blocks and transactions that a node does not have, or has dropped.

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// The heights of the blocks that a node has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    /// The oldest block, besides the genesis.
    pub(super) first: u64,
    /// The newest one.
    pub(super) tip: u64,
}

impl Kept {
    /// Has the node dropped old blocks?
    fn has_dropped(self) -> bool {
        self.first > 1
    }

    fn wanted(self) -> String {
        match self.has_dropped() {
            true => format!("a height from {} to {}, or 0", self.first, self.tip),
            false => format!("a height from 0 to {}", self.tip),
        }
    }

    /// The rejection of a block that is not here.
    pub(super) fn no_block(self, height: u64) -> Rejection {
        if height > 0 && height < self.first {
            return Rejection::new(Code::Pruned, format!("this node no longer stores block {height}"))
                .found(format!("blocks from {} on", self.first))
                .wanted(self.wanted())
                .next("ask a node with a longer retention, or search the archive");
        }
        Rejection::new(Code::NotFound, format!("this node has no block {height}")).wanted(self.wanted())
    }

    /// The rejection of a transaction that is in no block here.
    pub(super) fn no_transaction(self, id: &Hash) -> Rejection {
        if self.has_dropped() {
            let message = format!("transaction {id} is in none of the blocks that this node stores");
            return Rejection::new(Code::Pruned, message)
                .found(format!("blocks from {} on", self.first))
                .wanted("a transaction in one of these blocks")
                .next(
                    "ask a node with a longer retention, or search the archive; if it was just submitted, try again",
                );
        }
        Rejection::new(Code::NotFound, format!("transaction {id} is unknown to this node"))
            .next("if it was just submitted, try again; a call that is rejected before ordering has no record")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_block_is_told_apart_from_one_that_was_never_there() {
        let kept = Kept { first: 200, tip: 301 };
        let refused = kept.no_block(2);
        assert_eq!((refused.code, refused.wanted.as_str()), (Code::Pruned, "a height from 200 to 301, or 0"));
        assert_eq!(kept.no_block(302).code, Code::NotFound);
        assert_eq!(kept.no_block(199).code, Code::Pruned);
        let all = Kept { first: 1, tip: 301 };
        let refused = all.no_block(302);
        assert_eq!((refused.code, refused.wanted.as_str()), (Code::NotFound, "a height from 0 to 301"));
    }

    #[test]
    fn an_unknown_transaction_may_be_in_a_dropped_block_where_blocks_were_dropped() {
        let id = Hash::ZERO;
        assert_eq!(Kept { first: 1, tip: 9 }.no_transaction(&id).code, Code::NotFound);
        let refused = Kept { first: 5, tip: 9 }.no_transaction(&id);
        assert_eq!((refused.code, refused.found.contains("from 5 on")), (Code::Pruned, true), "{refused}");
    }
}
