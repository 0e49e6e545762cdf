//! The work of nodes beside ordering: they drop old blocks, lose their disks, and fetch from others what replication
//! does not bring.

use super::Cluster;
use ledger_storage::block_store::Base;
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::HardState;
use std::sync::Arc;

/// The outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Nodes were told that they are behind.
    pub told: u64,
    /// Nodes went on after a snapshot.
    pub snapshots: u64,
    /// Nodes fetched blocks.
    pub fetched: u64,
}

impl Cluster {
    /// Saves the state of a node, and drops the blocks below it but the last `keep`.
    pub fn prune(&mut self, id: u64, keep: u64) {
        let node = self.nodes.get_mut(&id).unwrap();
        let Some((engine, store)) = &node.up else { return };
        let applied = engine.status().applied;
        node.saved = node.saved.max(applied as usize);
        store.prune((applied + 1).saturating_sub(keep)).unwrap();
    }

    /// The disk is replaced by an empty one.
    pub fn lose_disk(&mut self, id: u64) {
        self.crash(id);
        let disk = SimDisk::new(self.random.number());
        let node = self.nodes.get_mut(&id).unwrap();
        node.disk = disk;
        node.state.clear();
        node.saved = 0;
    }

    /// The process is stopped: it does nothing, and messages to it wait.
    pub fn pause(&mut self, id: u64) {
        self.nodes.get_mut(&id).unwrap().held = Some(Vec::new());
    }

    /// The process goes on, and finds all that has come meanwhile at once.
    pub fn resume(&mut self, id: u64) {
        for event in self.nodes.get_mut(&id).unwrap().held.take().into_iter().flatten() {
            self.schedule(id, 1, event);
        }
    }

    /// Ends the engine, fetches what is committed from the node that has executed most, and starts a new engine.
    pub(super) fn catch_up(&mut self, id: u64, first_index: u64) {
        self.behind.told += 1;
        let others = self.nodes.values().filter(|node| node.id != id && node.up.is_some());
        let Some(donor) = others.max_by_key(|node| node.state.len()).map(|node| node.state.clone()) else { return };
        let snapshot = self.random.percent(50);
        let node = self.nodes.get_mut(&id).unwrap();
        let Some((engine, store)) = node.up.take() else { return };
        drop(engine);
        store.flush().unwrap();
        let committed = store.committed();
        if donor.len() as u64 > committed {
            let last = donor.last().unwrap();
            let base = Base { index: last.index, term: last.term };
            if snapshot && store.begin_after(base).is_ok() {
                node.saved = donor.len();
                self.behind.snapshots += 1;
            } else {
                let HardState { term, vote, .. } = store.hard_state();
                let vote = if term >= last.term { vote } else { 0 };
                let hard_state = HardState { term: term.max(last.term), vote, commit: last.index };
                store.append(&donor[committed as usize..], Some(&hard_state)).unwrap();
                store.flush().unwrap();
                self.behind.fetched += 1;
            }
            node.state = donor;
            assert!(node.state.len() as u64 + 1 >= first_index.min(self.chosen.len() as u64));
        }
        assert!(Arc::into_inner(store).is_some(), "the engine has ended");
        self.start(id);
    }

    /// The process is stopped.
    pub fn is_paused(&self, id: u64) -> bool {
        self.nodes[&id].held.is_some()
    }
}
