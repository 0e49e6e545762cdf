//! A node that the leader cannot serve any more fetches blocks from others that have them. The engine ends, blocks come
//! in batches, are written and executed, and a new engine goes on from there (`src/catch_up/` of the node).

use super::{Event as Happening, Timer, World};
use crate::clock::MILLISECOND;
use crate::coverage::Fault;
use crate::invariant::{Check, Violation};
use crate::node::Running;
use ledger_raft::Input;
use ledger_rejection::{Code, Rejection};
use ledger_replica::Event;
use ledger_storage::block_store::Base;
use ledger_storage::block_store::StoreError;
use ledger_storage::entry::Entry;
use ledger_storage::entry::HardState;
use ledger_storage::snapshot::Snapshot;

/// Most blocks of one answer of a peer.
const BATCH_MAX: u64 = 64;

impl World {
    /// The leader says that its log begins after what this node needs.
    pub(super) fn behind(&mut self, id: u64, first_index: u64) -> Check {
        self.coverage.fault(Fault::CatchUp);
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        running.replica = None;
        (running.leading, running.flushing) = (false, false);
        let lost = std::mem::take(&mut running.inbox);
        running.catch_up_to = first_index.saturating_sub(1);
        // What it wrote is durable when the next one begins, which takes everything in the log for durable.
        let written = running.store.flush();
        match written {
            Ok(_) => self.invariants.acknowledged.flushed(id, &running.store),
            Err(StoreError::DiskFull { .. }) => {}
            Err(error) => return self.failed(id, &error.to_string()),
        }
        self.note(format_args!("n{id} fetches blocks up to {first_index}"));
        self.schedule_timer(id, MILLISECOND, Timer::CatchUp);
        self.lose_inputs(id, lost)
    }

    /// Nobody takes these in any more.
    fn lose_inputs(&mut self, id: u64, lost: impl IntoIterator<Item = Event>) -> Check {
        let behind = || Rejection::new(Code::Behind, "this node fetches blocks that it missed");
        for event in lost {
            if let Event::Input(Input::ReadIndex { context }) = event {
                self.reads(id, |reads, now, out| reads.answered(now, context, Err(behind()), out))?;
            }
        }
        Ok(())
    }

    /// Asks a peer for the next blocks.
    pub(super) fn fetch(&mut self, id: u64) -> Check {
        let pause = self.random.nodes.between(5, 60) * MILLISECOND;
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        if running.replica.is_some() {
            return Ok(());
        }
        // What is committed here comes first; it cannot be written again.
        let next = running.ledger.tip().height + 1;
        let own = running.store.entries(next..running.store.committed() + 1, usize::MAX).unwrap_or_default();
        running.given.clear();
        let target = running.catch_up_to;
        if !own.is_empty() {
            self.take(id, own)?;
        } else if next > target {
            return self.resume(id);
        } else if self.install(id, next)? {
            // The process goes on with what it has now, as after a start.
            return Ok(());
        } else if let Some(entries) = self.ask(id, next) {
            match self.write(id, &entries) {
                Ok(()) => self.take(id, entries)?,
                Err(StoreError::DiskFull { .. }) => {}
                Err(error) => return self.failed(id, &error.to_string()),
            }
        }
        self.schedule_timer(id, pause, Timer::CatchUp);
        Ok(())
    }

    /// Blocks from some peer that is reachable and has them; it may be slow or silent.
    fn ask(&mut self, id: u64, next: u64) -> Option<Vec<Entry>> {
        let now = self.now;
        let able: Vec<u64> = self
            .nodes
            .values()
            .filter(|peer| peer.id != id && peer.paused_until <= now && !self.links.is_cut((id, peer.id)))
            .filter(|peer| !self.links.is_cut((peer.id, id)))
            .filter_map(|peer| Some((peer.id, peer.up.as_ref()?)))
            .filter(|(_, peer)| peer.store.first_index() <= next && peer.ledger.tip().height >= next)
            .map(|(peer, _)| peer)
            .collect();
        let peer = self.random.nodes.pick(&able).copied()?;
        self.links.client(now, &mut self.random.network, &mut self.coverage)?;
        let peer = self.nodes.get(&peer)?.up.as_ref()?;
        let until = (peer.ledger.tip().height + 1).min(next + BATCH_MAX);
        peer.store.entries(next..until, usize::MAX).ok().filter(|entries| !entries.is_empty())
    }

    /// If nobody has the next block any more, takes the newest snapshot of a peer. Answers whether it did.
    fn install(&mut self, id: u64, next: u64) -> Result<bool, Violation> {
        let now = self.now;
        let peers = self.nodes.values().filter(|peer| peer.id != id && peer.paused_until <= now);
        let peers: Vec<&Running> = peers
            .filter(|peer| !self.links.is_cut((id, peer.id)) && !self.links.is_cut((peer.id, id)))
            .filter_map(|peer| peer.up.as_ref())
            .collect();
        if peers.iter().any(|peer| peer.store.first_index() <= next && peer.ledger.tip().height >= next) {
            return Ok(false);
        }
        let newest =
            peers.iter().filter_map(|peer| peer.snapshots.newest()).max_by_key(|found| found.manifest().height);
        let Some(snapshot) = newest.filter(|snapshot| snapshot.manifest().height >= next) else { return Ok(false) };
        let interrupted = self.random.nodes.percent(10);
        match self.receive(id, &snapshot, interrupted) {
            Ok(()) => {}
            Err(fault) if matches!(fault.code, Code::DiskFull) => return Ok(false),
            Err(fault) => {
                self.failed(id, &fault.to_string())?;
                return Ok(true);
            }
        }
        self.coverage.fault(Fault::Snapshot);
        let height = snapshot.manifest().height;
        self.note(format_args!("n{id} takes the snapshot of height {height}, interrupted: {interrupted}"));
        self.stop(id, interrupted);
        self.schedule(MILLISECOND, Happening::Start { node: id });
        Ok(true)
    }

    /// Chunk by chunk; power may fail before it is used.
    fn receive(&mut self, id: u64, from: &Snapshot, interrupted: bool) -> Result<(), Rejection> {
        let Some(running) = self.nodes.get(&id).and_then(|node| node.up.as_ref()) else { return Ok(()) };
        let mut installer = running.snapshots.install(from.manifest().clone())?;
        while let Some(number) = installer.wanted() {
            installer.put(&from.chunk(number)?)?;
        }
        if interrupted {
            return Ok(());
        }
        installer.accept()?;
        let tip = &from.manifest().tip;
        running.store.begin_after(Base { index: tip.height, term: tip.term })?;
        let seed = self.random.nodes.number();
        if let Some(node) = self.nodes.get_mut(&id) {
            node.forget_state(seed);
        }
        Ok(())
    }

    fn write(&mut self, id: u64, entries: &[Entry]) -> Result<(), StoreError> {
        let Some(running) = self.nodes.get(&id).and_then(|node| node.up.as_ref()) else { return Ok(()) };
        let Some(last) = entries.last() else { return Ok(()) };
        let HardState { term, vote, .. } = running.store.hard_state();
        let vote = if last.term > term { 0 } else { vote };
        let state = HardState { term: term.max(last.term), vote, commit: last.index };
        if running.store.last_index() < last.index || running.store.term(last.index) != Some(last.term) {
            running.store.append(entries, Some(&state))?;
        }
        running.store.flush().map(drop)
    }

    /// Executes blocks that are on the own disk.
    fn take(&mut self, id: u64, entries: Vec<Entry>) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        self.invariants.log_matching.look(id, &running.store)?;
        self.invariants.acknowledged.flushed(id, &running.store);
        for entry in &entries {
            self.invariants.committed.committed(id, entry)?;
        }
        running.given.extend(entries);
        self.execute(id)
    }

    /// Everything that was missing is here: ordering goes on.
    fn resume(&mut self, id: u64) -> Check {
        let seed = self.random.nodes.number();
        let Some(running) = self.nodes.get(&id).and_then(|node| node.up.as_ref()) else { return Ok(()) };
        let replica = self.replica(id, seed, &running.store, &running.executor, &running.waiters)?;
        let Some(running) = self.running(id) else { return Ok(()) };
        running.replica = Some(replica);
        let height = running.ledger.tip().height;
        self.note(format_args!("n{id} has fetched blocks up to {height}"));
        self.schedule_timer(id, 0, Timer::Turn);
        Ok(())
    }

    /// Drops old blocks, as far as the node's own world state does not need them.
    pub(super) fn prune(&mut self, id: u64) -> Check {
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        let (Some(keep), Some(running)) = (node.keep, node.up.as_ref()) else { return Ok(()) };
        let before = running.store.first_index();
        let oldest = running.snapshots.oldest().map_or(0, |snapshot| snapshot.manifest().height);
        let keep_from = node.saved.saturating_sub(keep).min(oldest + 1);
        if let Err(fault) = running.ledger.prune_results(keep_from) {
            return self.failed(id, &fault.to_string());
        }
        match running.store.prune(keep_from) {
            Ok(first) if first > before => {
                self.coverage.fault(Fault::Pruning);
                self.note(format_args!("n{id} begins at {first}"));
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(error) => self.failed(id, &error.to_string()),
        }
    }
}
