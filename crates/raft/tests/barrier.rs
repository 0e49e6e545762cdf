//! A new leader orders only when it has executed everything that was there before it.
#![expect(clippy::unwrap_used, reason = "tests")]

use bytes::Bytes;
use ledger::block::Payload;
use ledger_hash::Hash;
use ledger_raft::{Engine, EngineConfig, Input, Lane, Membership, Output};
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::SimDisk;
use std::sync::Arc;

/// A lone voter on a disk, driven by hand: what it commits is executed only when the test says so.
struct Voter {
    engine: Engine,
    store: Arc<BlockStore>,
    /// Heights handed out and not yet reported as executed.
    committed: Vec<u64>,
}

impl Voter {
    fn start(disk: &SimDisk) -> Self {
        let options = Options::new(Hash::of(&[b"barrier"]).0, || 7);
        let (store, _) = BlockStore::open(Arc::new(disk.clone()), options).unwrap();
        let store = Arc::new(store);
        let engine = Engine::new(EngineConfig::new(1, Membership::new([1], []), 7), Arc::clone(&store)).unwrap();
        let mut voter = Self { engine, store, committed: Vec::new() };
        voter.step(Input::Tick);
        voter
    }

    fn step(&mut self, input: Input) {
        let mut inputs = vec![input];
        while let Some(input) = inputs.pop() {
            let mut outputs = Vec::new();
            self.engine.step(1_000_000, input, &mut outputs);
            for output in outputs {
                match output {
                    Output::Flush { ready } => {
                        self.store.flush().unwrap();
                        inputs.push(Input::Persisted { ready });
                    }
                    Output::Commit(entries) => self.committed.extend(entries.iter().map(|entry| entry.index)),
                    _ => {}
                }
            }
        }
    }

    fn submit(&mut self, transaction: &'static str) {
        self.step(Input::Submit { lane: Lane::Data, transaction: Bytes::from_static(transaction.as_bytes()) });
    }

    fn execute_all(&mut self) {
        while let Some(height) = self.committed.pop() {
            self.committed.clear();
            self.step(Input::Applied { height, at: 1_000_000 });
        }
    }

    fn holds(&self, transaction: &str) -> bool {
        let entries = self.store.entries(1..self.store.last_index() + 1, usize::MAX).unwrap();
        entries.into_iter().any(|entry| {
            Payload::from_bytes(entry.data)
                .unwrap()
                .transactions
                .contains(&Bytes::copy_from_slice(transaction.as_bytes()))
        })
    }
}

#[test]
fn a_new_leader_orders_only_when_it_has_executed_what_was_there() {
    let disk = SimDisk::new(1);
    let mut first = Voter::start(&disk);
    first.execute_all();
    first.submit("before");
    first.execute_all();
    assert!(first.holds("before"));
    drop(first);

    // The state machine was lost: everything is to be executed again, by a leader that leads already.
    let mut second = Voter::start(&disk);
    second.submit("after");
    assert!(second.engine.status().role.leader == Some(1), "it leads");
    assert!(!second.holds("after"), "ordered before what was there was executed");
    second.execute_all();
    assert!(second.holds("after"), "ordered as soon as it was");
}
