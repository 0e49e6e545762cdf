//! How much an engine hands out, and on which state it starts.

use super::*;
use crate::EngineError;
use ledger_storage::block_store::Base;

fn store() -> Arc<BlockStore> {
    let mut options = Options::new([7; 32], || 1);
    options.segment_bytes = 1 << 16;
    let (store, _) = BlockStore::open(Arc::new(SimDisk::new(1)), options).unwrap();
    Arc::new(store)
}

#[test]
fn commits_stop_when_the_executor_falls_behind_and_go_on_when_it_catches_up() {
    let store = store();
    let mut config = EngineConfig::new(1, Membership::new([1], []), 1);
    config.unapplied_bytes = 1000;
    let mut engine = Engine::new(config, Arc::clone(&store), Arc::new(Genesis), Arc::new(Names(1))).unwrap();
    let (mut out, mut heights) = (Vec::new(), Vec::new());
    engine.step(0, Input::Tick, &mut out);
    let mut apply = true;
    for nth in 0..100u64 {
        if nth == 1 {
            apply = false;
        }
        engine.step(nth, Input::Submit { lane: Lane::Data, transaction: vec![1; 200].into() }, &mut out);
        while let Some(output) = out.pop() {
            match output {
                Output::Flush { ready } => {
                    store.flush().unwrap();
                    engine.step(nth, Input::Persisted { ready }, &mut out);
                }
                Output::Commit(entries) => {
                    heights.extend(entries.iter().map(|entry| entry.index));
                    if apply {
                        engine.step(nth, Input::Applied { height: *heights.last().unwrap(), at: nth }, &mut out);
                    }
                }
                _ => {}
            }
        }
    }
    assert!(heights.len() < 10, "found {heights:?}");
    assert!(engine.status().commit > 90);
    while heights.len() < 101 {
        engine.step(0, Input::Applied { height: *heights.last().unwrap(), at: 0 }, &mut out);
        for output in out.drain(..) {
            if let Output::Commit(entries) = output {
                heights.extend(entries.iter().map(|entry| entry.index));
            }
        }
    }
    assert_eq!(heights, (1..=101).collect::<Vec<_>>());
}

/// Execution went on from a snapshot of height 50.
struct Snapshot;

impl ExecutedBlocks for Snapshot {
    fn link(&self, height: u64) -> Option<Link> {
        (height == 50).then_some(Link { hash: Hash([5; 32]), time: 9 })
    }
}

#[test]
fn a_state_that_does_not_fit_the_log_is_refused() {
    let start = |applied| {
        let store = store();
        store.begin_after(Base { index: 50, term: 3 }).unwrap();
        let mut config = EngineConfig::new(1, Membership::new([1], []), 1);
        config.applied = applied;
        Engine::new(config, store, Arc::new(Snapshot), Arc::new(Names(1))).map(|engine| engine.status())
    };
    assert!(matches!(start(49), Err(EngineError::StateBehind { applied: 49, first: 51 })));
    assert!(matches!(start(51), Err(EngineError::StateAhead { applied: 51, last: 50 })));
    let status = start(50).unwrap();
    assert_eq!((status.first, status.last, status.commit, status.role.term), (51, 50, 50, 3));
}
