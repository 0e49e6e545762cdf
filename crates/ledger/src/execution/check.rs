//! The invariants of an executed block, stated before anybody hears of it.

use super::Execution;
use ledger_base::hash::Hash;
use ledger_base::{costly_invariant, invariant};
use ledger_storage::state::Tip;
use std::collections::HashSet;

impl Execution {
    /// States that this is the outcome of the block that follows `previous`.
    pub(crate) fn check(&self, previous: &Tip) {
        let (header, tip, height) = (&self.header, &self.tip, self.header.height);
        let (follows, found) = (header.previous == previous.hash, header.previous);
        invariant!(
            height == previous.height + 1 && follows,
            "a block follows the one before it",
            "block {height} after {} and {found}, executed after {} and {}",
            height.saturating_sub(1),
            previous.height,
            previous.hash
        );
        let (time, before) = (header.time, previous.time);
        invariant!(time >= before, "block time never goes back", "{time} after {before} at height {height}");
        let (transactions, ids, verdicts) = (self.transactions.len(), self.ids.len(), self.result.results.len());
        invariant!(
            ids == transactions && verdicts == transactions && self.foretold.len() == transactions,
            "each transaction has one verdict",
            "{transactions} transactions, {ids} ids and {verdicts} verdicts in block {height}"
        );
        invariant!(
            (tip.height, tip.term, tip.time) == (height, header.term, time)
                && self.result.hash == tip.hash.0[..]
                && self.result.digest == tip.digest.0[..],
            "savepoint, header and result tell of one block",
            "savepoint {tip:?}, header {header:?}"
        );
        costly_invariant!(tip.hash == header.hash(), "a block is named by its header", "{} for {header:?}", tip.hash);
        costly_invariant!(
            self.executed_twice().is_none(),
            "an id is executed once",
            "{:?} twice in block {height}",
            self.executed_twice()
        );
    }

    /// An id that two transactions of the block took.
    fn executed_twice(&self) -> Option<Hash> {
        let taken = self.ids.iter().zip(&self.result.results).filter(|(_, result)| result.not_after.is_some());
        let mut seen = HashSet::new();
        taken.map(|(id, _)| *id).find(|id| !seen.insert(*id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::Header;
    use bytes::Bytes;
    use ledger_storage::result::{BlockResult, TransactionResult};
    use ledger_storage::state::WriteSet;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    fn previous() -> Tip {
        Tip { height: 6, term: 2, time: 50, hash: Hash([6; 32]), digest: Hash([1; 32]) }
    }

    /// A block of two transactions.
    fn execution() -> Execution {
        let header = Header { height: 7, term: 2, time: 60, previous: previous().hash, root: Hash::ZERO };
        let tip = Tip { height: 7, term: 2, time: 60, hash: header.hash(), digest: Hash([2; 32]) };
        let verdict = TransactionResult { not_after: Some(100), ..TransactionResult::default() };
        let result = BlockResult {
            hash: Bytes::copy_from_slice(&tip.hash.0),
            digest: Bytes::copy_from_slice(&tip.digest.0),
            results: vec![verdict.clone(), verdict],
            ..BlockResult::default()
        };
        let (transactions, ids) = (vec![Bytes::new(); 2], vec![Hash([7; 32]), Hash([8; 32])]);
        Execution {
            tip,
            header,
            result,
            foretold: vec![false; 2],
            transactions,
            ids,
            writes: WriteSet::new(),
            certifiable: None,
            is_unwanted: false,
            governs: false,
        }
    }

    /// A fault of the program, and the invariant that it breaks.
    type Break = (fn(&mut Execution), &'static str);

    #[test]
    fn a_block_that_follows_with_a_verdict_for_each_transaction_is_believed() {
        execution().check(&previous());
    }

    #[test]
    fn an_execution_that_contradicts_itself_is_found_before_anybody_hears_of_it() {
        invariant::look_closely();
        let breaks: [Break; 8] = [
            (|broken| broken.header.height = 8, "a block follows the one before it"),
            (|broken| broken.header.previous = Hash::ZERO, "a block follows the one before it"),
            (|broken| broken.header.time = 49, "block time never goes back"),
            (|broken| drop(broken.result.results.pop()), "each transaction has one verdict"),
            (|broken| broken.ids.push(Hash::ZERO), "each transaction has one verdict"),
            (|broken| broken.tip.digest = Hash::ZERO, "savepoint, header and result tell of one block"),
            (|broken| broken.header.root = Hash([3; 32]), "a block is named by its header"),
            (|broken| broken.ids = vec![Hash([7; 32]); 2], "an id is executed once"),
        ];
        for (broken, invariant) in breaks {
            let mut execution = execution();
            broken(&mut execution);
            let panic = catch_unwind(AssertUnwindSafe(|| execution.check(&previous()))).err();
            let text = panic.and_then(|panic| panic.downcast::<String>().ok()).unwrap_or_default();
            assert!(text.contains(invariant), "{invariant}: {text}");
        }
    }
}
