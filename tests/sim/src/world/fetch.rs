//! Carries out what the conductor and the machine that catches up say: engines end and start, blocks and snapshots come
//! from peers. `ledger_replica` decides.

use super::{Event as Happening, Timer, World};
use crate::clock::MILLISECOND;
use crate::coverage::Fault;
use crate::invariant::{Check, Violation};
use crate::people::organisation_of;
use ledger::block::Payload;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Input;
use ledger_replica::catch_up::{Batch, Behind, CatchUp, Got, Todo, install, store_holds};
use ledger_replica::conductor::{Happened, Next};
use ledger_replica::space::Wrote;
use ledger_replica::trust::{Attested, Trial, attestations, given, needless};
use ledger_replica::{Event, Last};
use ledger_storage::block_store::StoreError;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::snapshot::{Manifest, Snapshot};
use std::sync::Arc;

/// Most blocks of one message of a peer.
const MESSAGE_MAX: u64 = 16;

/// How a node reaches another one.
#[derive(Clone, Copy)]
pub(crate) struct Contact {
    /// Its number.
    pub(crate) id: u64,
    /// The join token vouches for it: what it says is believed.
    pub(crate) vouched: bool,
}

/// A node that catches up.
pub struct Fetching {
    machine: CatchUp<Contact>,
    /// The next thing to do.
    todo: Option<Todo<Contact>>,
    /// The peer of the open stream, and the block that comes next in it.
    stream: Option<(Contact, u64)>,
    /// The leader that said that the node is behind.
    leader: Option<u64>,
}

impl World {
    /// Tells the conductor of a node what happened, and does what it says.
    pub(super) fn conduct(&mut self, id: u64, happened: Happened) -> Check {
        let mut happened = happened;
        loop {
            let Some(running) = self.running(id) else { return Ok(()) };
            match running.conductor.step(happened) {
                Err(removed) if removed.code == Code::NotAMember => {
                    self.note(format_args!("n{id} was removed"));
                    self.stop(id, false);
                    return Ok(());
                }
                Err(fault) => return self.failed(id, &fault.to_string()),
                Ok(Next::Start) => return self.resume(id),
                Ok(Next::End(behind)) => {
                    self.end_engine(id, behind)?;
                    happened = Happened::Ended;
                }
                Ok(Next::Flush) => happened = Happened::Flushed(self.flush_rest(id)),
                Ok(Next::CatchUp(behind)) => {
                    self.catch_up_with(id, behind);
                    return Ok(());
                }
                Ok(Next::Pause(time)) => {
                    self.schedule_timer(id, time, Timer::Conduct);
                    return Ok(());
                }
                Ok(Next::StartAgain) => {
                    self.stop(id, false);
                    self.schedule(MILLISECOND, Happening::Start { node: id });
                    return Ok(());
                }
                Ok(Next::Nothing) => return Ok(()),
            }
        }
    }

    /// The order thread ends: what it has staged is written if there is room, and what was given is executed.
    fn end_engine(&mut self, id: u64, behind: Behind) -> Check {
        self.note(format_args!("n{id} fetches blocks before {}", behind.first_index));
        self.execute_given(id)?;
        while let Some(last) = self.running(id).and_then(|running| running.replica.as_mut()?.end()) {
            match last {
                Last::Write => {
                    let written = self.flush_rest(id);
                    self.step(id, Event::Written(written))?;
                }
                Last::Execute(entries) => {
                    self.execute_given(id)?;
                    self.committed(id, &entries)?;
                    self.execute_all(id, &entries)?;
                }
            }
        }
        let Some(running) = self.running(id) else { return Ok(()) };
        running.replica = None;
        (running.leading, running.flushing) = (false, false);
        let lost = std::mem::take(&mut running.inbox);
        self.lose_inputs(id, lost)
    }

    /// The execute thread comes to its end.
    fn execute_given(&mut self, id: u64) -> Check {
        while self.running(id).is_some_and(|running| !running.given.is_empty()) {
            self.execute(id)?;
        }
        Ok(())
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

    fn flush_rest(&mut self, id: u64) -> Result<(), StoreError> {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let written = running.write_log().map(drop);
        match &written {
            Ok(()) => self.invariants.acknowledged.flushed(id, &running.store),
            Err(StoreError::DiskFull { .. }) => self.coverage.full_at_end += 1,
            Err(_) => {}
        }
        written
    }

    fn catch_up_with(&mut self, id: u64, behind: Option<Behind>) {
        let organisation = organisation_of(id, self.plan.organisations);
        let root = self.people.organisations.first().and_then(|organisation| organisation.roots.first());
        let token = root.map(|root| Hash::of(&[root]));
        let Some(running) = self.running(id) else { return };
        let machine = CatchUp::new(Arc::clone(&running.ledger), organisation, behind, token);
        let leader = behind.map(|behind| behind.from);
        running.fetching = Some(Fetching { machine, todo: Some(Todo::Ask), stream: None, leader });
        self.schedule_timer(id, MILLISECOND, Timer::Fetch);
    }

    /// Does the next thing to catch up.
    pub(super) fn fetch(&mut self, id: u64) -> Check {
        let Some(running) = self.running(id) else { return Ok(()) };
        let Some(todo) = running.fetching.as_mut().and_then(|fetching| fetching.todo.take()) else { return Ok(()) };
        let got = match todo {
            Todo::Ask => Got::Offers(self.offers(id)),
            Todo::Open { peer, from } => {
                self.stream(id, peer, from);
                Got::Blocks(self.message(id))
            }
            Todo::More => Got::Blocks(self.message(id)),
            Todo::Confirm { peer, height } => Got::Hash(self.block_hash(id, peer, height)),
            Todo::TakeIn(batch) => Got::TakenIn(match self.take_in(id, &batch)? {
                Err(fault) if fault.code != Code::DiskFull => return self.failed(id, &fault.to_string()),
                taken => taken,
            }),
            Todo::Manifest { peer } => Got::Manifest(self.manifest(id, peer)),
            Todo::Fetch { peer, manifest, trial } => match self.receive(id, peer, manifest, &trial)? {
                Some(got) => got,
                // Power has failed.
                None => return Ok(()),
            },
            Todo::Install(snapshot) => Got::Installed(self.install(id, &snapshot)?),
            Todo::Pause(_) => Got::Waited,
            Todo::Done(caught) => {
                let Some(running) = self.running(id) else { return Ok(()) };
                running.fetching = None;
                let height = running.ledger.tip().height;
                self.note(format_args!("n{id} has fetched blocks up to {height}: {caught:?}"));
                return self.conduct(id, Happened::Caught(caught));
            }
            Todo::Failed(fault) => return self.failed(id, &fault.to_string()),
        };
        let delay = self.random.nodes.between(1, 20) * MILLISECOND;
        let Some(fetching) = self.running(id).and_then(|running| running.fetching.as_mut()) else { return Ok(()) };
        let todo = fetching.machine.step(got);
        let delay = if let Todo::Pause(time) = &todo { *time } else { delay };
        fetching.todo = Some(todo);
        self.schedule_timer(id, delay, Timer::Fetch);
        Ok(())
    }

    fn stream(&mut self, id: u64, peer: Contact, from: u64) {
        if let Some(fetching) = self.running(id).and_then(|running| running.fetching.as_mut()) {
            fetching.stream = Some((peer, from));
        }
    }

    /// A peer answers, or is silent.
    fn reach(&mut self, id: u64, Contact { id: peer, .. }: Contact) -> Result<(), Rejection> {
        let way = self.links.client(self.now, &mut self.random.network, &mut self.coverage);
        match (self.answers(id, peer), way) {
            (Some(true), Some(_)) => Ok(()),
            _ => Err(Rejection::new(Code::Unreachable, format!("node {peer} does not answer"))),
        }
    }

    /// The next message of a stream. A peer of another organisation may give blocks that nobody has ordered.
    fn message(&mut self, id: u64) -> Result<Option<Vec<Entry>>, Rejection> {
        let Some(fetching) = self.running(id).and_then(|running| running.fetching.as_ref()) else { return Ok(None) };
        let (Some((contact, next)), leader) = (fetching.stream, fetching.leader) else { return Ok(None) };
        self.reach(id, contact)?;
        let peer = contact.id;
        let Some(from) = self.nodes.get(&peer).and_then(|node| node.up.as_ref()) else { return Ok(None) };
        let until = (store_holds(&from.store) + 1).min(next + MESSAGE_MAX);
        if next >= until {
            return Ok(None);
        }
        if next < from.store.first_index() {
            return Err(Rejection::new(Code::Pruned, format!("node {peer} does not keep block {next} any more")));
        }
        let mut entries = from.store.entries(next..until, usize::MAX)?;
        let organisations = self.plan.organisations;
        let may_lie = organisation_of(peer, organisations) != organisation_of(id, organisations);
        let may_lie = may_lie && leader != Some(peer) && !contact.vouched;
        let lies = may_lie && self.chaos && self.plan.faults.contains(&Fault::ForgedBlocks);
        if lies && self.random.faults.percent(40) {
            let normal = entries.iter_mut().rfind(|entry| entry.kind == EntryKind::Normal && !entry.data.is_empty());
            let payload = normal.and_then(|entry| Some((Payload::from_bytes(entry.data.clone()).ok()?, entry)));
            if let Some((mut payload, entry)) = payload {
                payload.time += 1;
                entry.data = payload.to_bytes();
                self.coverage.fault(Fault::ForgedBlocks);
                self.note(format_args!("n{peer} forges a block for n{id}"));
            }
        }
        let last = entries.last().map_or(next, |entry| entry.index + 1);
        self.stream(id, contact, last);
        Ok(Some(entries))
    }

    fn block_hash(&mut self, id: u64, peer: Contact, height: u64) -> Result<Option<Hash>, Rejection> {
        self.reach(id, peer)?;
        let Some(from) = self.nodes.get(&peer.id).and_then(|node| node.up.as_ref()) else { return Ok(None) };
        let tip = from.ledger.tip();
        Ok(match height == tip.height {
            true => Some(tip.hash),
            false => from.ledger.block_hashes(height)?.map(|block| block.hash),
        })
    }

    /// Stores blocks and executes them.
    fn take_in(&mut self, id: u64, batch: &Batch) -> Result<Result<(), Rejection>, Violation> {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(Ok(())) };
        let stored = batch.store(&running.store);
        // The machine tries again by itself.
        let _again = running.space.wrote(&mut running.ground, Wrote::from(&stored));
        if let Err(fault) = stored {
            return Ok(Err(fault.into()));
        }
        let executor = Arc::clone(&running.executor);
        self.invariants.log_matching.look(id, &running.store)?;
        self.invariants.acknowledged.flushed(id, &running.store);
        self.coverage.fault(Fault::CatchUp);
        for entry in batch.entries() {
            self.invariants.committed.committed(id, entry)?;
        }
        let mut broken = Ok(());
        let executed = batch.execute(|entry| {
            broken = std::mem::replace(&mut broken, Ok(())).and_then(|()| self.execute_one(id, &executor, entry));
            match self.running(id) {
                Some(_) => Ok(executor.ledger().tip().hash),
                None => Err(Rejection::new(Code::UnknownRules, "the node has stopped before this block")),
            }
        });
        executor.look_at_deadline();
        broken?;
        if self.running(id).is_none() {
            return Ok(Ok(()));
        }
        self.catch_up(id)?;
        Ok(executed)
    }

    fn manifest(&mut self, id: u64, peer: Contact) -> Result<(Manifest, Vec<Attested>), Rejection> {
        self.reach(id, peer)?;
        let none = || Rejection::new(Code::NotFound, "there is no snapshot here");
        let from = self.nodes.get(&peer.id).and_then(|node| node.up.as_ref()).ok_or_else(none)?;
        let given = given(&from.ledger, &from.snapshots)?.ok_or_else(none)?;
        let block = |height: u64| {
            let kept = height >= from.store.first_index();
            let block = self.blocks.get(height as usize - 1).filter(|_| kept);
            Ok(block.map(|block| block.outcome.transactions.clone()))
        };
        Ok((given.manifest().clone(), attestations(&from.ledger, &given, block)?))
    }

    /// Chunk by chunk; power may fail before it is used.
    fn receive(
        &mut self,
        id: u64,
        peer: Contact,
        manifest: Manifest,
        trial: &Trial,
    ) -> Result<Option<Got<Contact>>, Violation> {
        if let Err(silent) = self.reach(id, peer) {
            return Ok(Some(Got::Unfetched(silent)));
        }
        let from = self.nodes.get(&peer.id).and_then(|node| node.up.as_ref()?.snapshots.get(manifest.height));
        let Some(from) = from.filter(|from| from.content() == manifest.content()) else {
            let gone = Rejection::new(Code::NotFound, "the snapshot is not kept any more");
            return Ok(Some(Got::Unfetched(gone)));
        };
        let interrupted = self.random.nodes.percent(10);
        let Some(running) = self.running(id) else { return Ok(None) };
        let known = running.snapshots.get(manifest.height).filter(|known| known.content() == manifest.content());
        if let Some(known) = known {
            return Ok(Some(Got::Snapshot(Ok(known))));
        }
        let chunks: Result<Vec<_>, _> = (0..manifest.chunks.len()).map(|number| from.chunk(number)).collect();
        let chunks = match chunks {
            Ok(chunks) => chunks,
            Err(damaged) => return Ok(Some(Got::Unfetched(damaged))),
        };
        let fetched = (|| {
            let mut installer = running.snapshots.install(manifest)?;
            while let Some(number) = installer.wanted() {
                installer.put(chunks.get(number).map_or(&[][..], |chunk| chunk))?;
            }
            if interrupted { Ok(None) } else { trial.conclude(installer).map(Some) }
        })();
        if matches!(fetched, Ok(None)) {
            self.stop(id, true);
            self.schedule(MILLISECOND, Happening::Start { node: id });
            return Ok(None);
        }
        Ok(fetched.transpose().map(Got::Snapshot))
    }

    fn install(&mut self, id: u64, snapshot: &Snapshot) -> Result<Result<(), Rejection>, Violation> {
        let (height, content) = (snapshot.manifest().height, snapshot.content());
        self.invariants.snapshot_trust.installed(id, height, content)?;
        let Some(running) = self.running(id) else { return Ok(Ok(())) };
        let installed = install(&running.store, snapshot);
        if installed.is_ok() {
            self.coverage.fault(Fault::Snapshot);
            self.note(format_args!("n{id} takes the snapshot of height {height}"));
        }
        Ok(installed)
    }

    /// An engine starts.
    fn resume(&mut self, id: u64) -> Check {
        let seed = self.random.nodes.number();
        let Some(running) = self.nodes.get(&id).and_then(|node| node.up.as_ref()) else { return Ok(()) };
        let replica = self.replica(id, seed, running)?;
        let Some(running) = self.running(id) else { return Ok(()) };
        running.replica = Some(replica);
        self.schedule_timer(id, 0, Timer::Turn);
        Ok(())
    }

    /// Drops old blocks, as far as neither the node's own world state nor others need them.
    pub(super) fn prune(&mut self, id: u64) -> Check {
        let Some(node) = self.nodes.get(&id) else { return Ok(()) };
        let (Some(keep), Some(running)) = (node.keep, node.up.as_ref()) else { return Ok(()) };
        let before = running.store.first_index();
        let limit = needless(&running.ledger, &running.snapshots, false).unwrap().unwrap_or(0);
        let keep_from = node.saved.saturating_sub(keep).min(limit + 1);
        let Some(running) = self.running(id) else { return Ok(()) };
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
