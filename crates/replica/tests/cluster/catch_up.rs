//! The work of nodes beside ordering: they drop old blocks, lose their disks, and fetch from others what replication
//! does not bring. The replica's machine decides which blocks they fetch, and from whom.

use super::drive::secret;
use super::people::{ORGANISATION, PEOPLE, call};
use super::{Cluster, Event};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_raft::ReceiptKey;
use ledger_replica::catch_up::{Behind, CatchUp, Caught, Got, Holding, Offer, Todo, Who, install, store_holds};
use ledger_replica::trust::{Attested, Trial};
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::{Manifest, Snapshot};
use std::sync::Arc;

/// Most blocks of one message of a peer.
const MESSAGE_MAX: u64 = 64;

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
    /// Stores the world state of a node with its snapshots, and drops the blocks below but the last `keep`, as far as a
    /// snapshot stands for them.
    pub fn prune(&mut self, id: u64, keep: u64) {
        let Some(up) = &self.nodes[&id].up else { return };
        up.ledger().flush_up_to(up.store.durable_index(), Some(&up.snapshots)).unwrap();
        let stored = up.ledger().state().stored().map_or(0, |tip| tip.height);
        let oldest = up.snapshots.oldest().map_or(0, |snapshot| snapshot.manifest().height);
        let keep_from = (stored + 1).saturating_sub(keep).min(oldest + 1);
        up.ledger().prune_results(keep_from).unwrap();
        up.store.prune(keep_from).unwrap();
    }

    /// The disk is replaced by an empty one.
    pub fn lose_disk(&mut self, id: u64) {
        self.crash(id);
        let seed = self.random.number();
        self.nodes.get_mut(&id).unwrap().lose_disks(seed);
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

    /// The process is stopped.
    pub fn is_paused(&self, id: u64) -> bool {
        self.nodes[&id].held.is_some()
    }

    /// The execute thread of a node stands still, or goes on.
    pub fn stall(&mut self, id: u64, stalled: bool) {
        self.nodes.get_mut(&id).unwrap().stalled = stalled;
        self.schedule(id, 1, Event::Execute);
    }

    /// Ends the engine, lets the machine fetch what it lacks, and starts a new engine.
    pub(super) fn catch_up(&mut self, id: u64, behind: Behind) {
        self.behind.told += 1;
        let up = self.nodes.get_mut(&id).unwrap().up.as_mut().unwrap();
        up.replica = None;
        let given = std::mem::take(&mut up.given);
        self.execute(id, &given);
        let up = self.nodes[&id].up.as_ref().unwrap();
        up.store.flush().unwrap();
        let begun = up.ledger().tip().height;
        let mut machine = CatchUp::new(Arc::clone(up.ledger()), ORGANISATION.into(), Some(behind), None);
        let (mut todo, mut stream) = (Todo::Ask, (0, 0));
        let caught = loop {
            let got = match todo {
                Todo::Done(caught) => break caught,
                Todo::Failed(reason) => panic!("node {id} cannot catch up: {reason}"),
                todo => self.do_next(id, todo, &mut stream),
            };
            todo = machine.step(got);
        };
        match caught {
            Caught::Snapshot => {
                self.behind.snapshots += 1;
                self.nodes.get_mut(&id).unwrap().end();
                self.start(id);
            }
            Caught::Up | Caught::Nothing => {
                self.behind.fetched += u64::from(self.height(id) > begun);
                self.begin(id);
            }
        }
    }

    /// `stream`: the peer of the open stream, and the block that comes next in it.
    fn do_next(&mut self, id: u64, todo: Todo<u64>, stream: &mut (u64, u64)) -> Got<u64> {
        match todo {
            Todo::Ask => Got::Offers(self.offers(id)),
            Todo::Open { peer, from } => {
                *stream = (peer, from);
                Got::Blocks(Ok(self.message(stream)))
            }
            Todo::More => Got::Blocks(Ok(self.message(stream))),
            Todo::Confirm { peer, height } => {
                let from = self.nodes[&peer].up.as_ref().unwrap();
                Got::Hash(from.ledger().block_hashes(height).map(|block| block.map(|block| block.hash)))
            }
            Todo::TakeIn(batch) => {
                let up = self.nodes[&id].up.as_ref().unwrap();
                let executor = Arc::clone(&up.executor);
                batch.store(&up.store).unwrap();
                Got::TakenIn(batch.execute(|entry| {
                    self.execute_one(id, &executor, entry);
                    Ok(executor.ledger().tip().hash)
                }))
            }
            Todo::Manifest { peer } => {
                let from = self.nodes[&peer].up.as_ref().unwrap();
                let manifest = from.snapshots.newest().unwrap().manifest().clone();
                let attested = self.attested(&manifest);
                Got::Manifest(Ok((manifest, vec![attested])))
            }
            Todo::Fetch { peer, manifest, trial } => Got::Snapshot(self.receive(id, peer, manifest, &trial)),
            Todo::Install(snapshot) => Got::Installed(install(&self.nodes[&id].up.as_ref().unwrap().store, &snapshot)),
            Todo::Pause(_) | Todo::Done(_) | Todo::Failed(_) => Got::Waited,
        }
    }

    /// The blocks of the others.
    fn offers(&self, id: u64) -> Vec<Offer<u64>> {
        let others = self.nodes.values().filter(|node| node.id != id && node.held.is_none());
        let offers = others.filter_map(|node| {
            let (up, peer) = (node.up.as_ref()?, node.id);
            let status = up.replica.as_ref().map(ledger_replica::Replica::status);
            let key = ReceiptKey::new(peer, &secret(peer));
            let has = Holding::of((up.ledger(), &up.store, &up.snapshots), status.as_ref(), (id, None), &key);
            let who = Who { id: peer, organisation: ORGANISATION.into(), name: format!("node{peer}"), vouched: false };
            Some(Offer { who, has, peer })
        });
        offers.collect()
    }

    fn message(&self, (peer, next): &mut (u64, u64)) -> Option<Vec<Entry>> {
        let store = &self.nodes[peer].up.as_ref().unwrap().store;
        let until = (store_holds(store) + 1).min(*next + MESSAGE_MAX);
        if *next >= until {
            return None;
        }
        let entries = store.entries(*next..until, usize::MAX).unwrap();
        *next = until;
        Some(entries)
    }

    /// A node's word for a snapshot.
    fn attested(&self, manifest: &Manifest) -> Attested {
        let (height, content) = (manifest.height, manifest.content());
        let statement = Bytes::from(format!("{{\"height\":{height},\"content\":\"{content}\"}}"));
        let attested = call(&PEOPLE.node, self.network(), manifest.tip.time, ("msp", "attest"), statement);
        Attested { transaction: attested.encoded().clone(), certificate: PEOPLE.node.certificate.clone() }
    }

    fn receive(&self, id: u64, peer: u64, manifest: Manifest, trial: &Trial) -> Result<Arc<Snapshot>, Rejection> {
        let (up, from) = (self.nodes[&id].up.as_ref().unwrap(), self.nodes[&peer].up.as_ref().unwrap());
        let from = from.snapshots.get(manifest.height).unwrap();
        let mut installer = up.snapshots.install(manifest)?;
        while let Some(number) = installer.wanted() {
            installer.put(&from.chunk(number)?)?;
        }
        trial.conclude(installer)
    }
}
