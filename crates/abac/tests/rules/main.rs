//! Blocks that were executed once are executed to the same results for ever: a chain of every released rules number is
//! stored in `tests/fixtures`, and replayed here.
//!
//! The chains hold what the [`story`] tells. To store the chain of a new number, delete its file if there is one, and run
//! this test with `STORE_RULES_CHAIN` set to the number. A chain of a released number is never stored again: the chains
//! of networks cannot be changed either.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests stop at the first surprise")]

mod chain;
mod contests;
mod defaults;
mod story;
mod teller;

use chain::{Block, Chain, path};
use ledger::Rules;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_storage::result::TransactionResult;

/// A block of a stored chain, as executing it again gives it.
#[derive(Debug, PartialEq)]
struct Replayed {
    height: u64,
    hash: Hash,
    digest: Hash,
    events: Hash,
    results: Option<Hash>,
}

#[test]
fn a_chain_of_every_released_rules_number_is_replayed_to_the_same_digests() {
    for rules in Rules::all().map(Rules::number) {
        let chain = Chain::load(rules);
        let ledger = chain::open(&chain.genesis);
        assert!(chain.blocks.len() > 40, "the chain of rules {rules} tells a story");
        for block in &chain.blocks {
            let height = block.entry.index;
            let outcome = ledger.apply(&block.entry).unwrap();
            let events = chain::digest_of_events(&outcome.events);
            let results = outcome.certifiable.as_ref().map(|it| it.results);
            let replayed = Replayed { height, hash: outcome.hash, digest: outcome.digest, events, results };
            let Block { hash, digest, events, results, .. } = *block;
            let stored = Replayed { height, hash, digest, events, results };
            assert_eq!(replayed, stored, "rules {rules}: {:?}", outcome.results);
        }
    }
}

#[test]
fn a_stored_chain_ends_each_call_of_the_story_as_a_new_one_does() {
    for rules in Rules::all().map(Rules::number) {
        let told = story::tell(rules);
        if std::env::var("STORE_RULES_CHAIN").is_ok_and(|number| number == rules.to_string()) {
            assert!(!path(rules).exists(), "{} exists; a released chain is never stored again", path(rules).display());
            std::fs::write(path(rules), told.to_bytes()).unwrap();
        }
        let codes = |chain: &Chain| -> Vec<Vec<Code>> {
            let ledger = chain::open(&chain.genesis);
            let apply = |block: &Block| ledger.apply(&block.entry).unwrap().results;
            chain.blocks.iter().map(|block| apply(block).iter().map(TransactionResult::code).collect()).collect()
        };
        assert_eq!(codes(&Chain::load(rules)), codes(&told), "rules {rules}");
    }
}
