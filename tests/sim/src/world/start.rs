//! Nodes come and go.

use super::streams::{PLACES, WORKERS};
use super::{Event, Timer, World};
use crate::clock::{MILLISECOND, SECOND};
use crate::coverage::Fault;
use crate::invariant::{Check, Violation};
use crate::node::{Client, Keeping, Running, open_blocks};
use ledger::{Chaincode, Ledger, Registry, Rules, msp};
use ledger_abac::AccessControl;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Desired, ReceiptKey, Secret};
use ledger_replica::catch_up::{Ballot, Look, Own};
use ledger_replica::conductor::Conductor;
use ledger_replica::gateway::{Shares, Turns};
use ledger_replica::opening::Opening;
use ledger_replica::space::Space;
use ledger_replica::witness::Said;
use ledger_replica::{Executor, Reads, Replica, Retries, Settings, Voting, Waiters};
use ledger_storage::block_store::StoreError;
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::StateRead;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, mpsc};

/// The node that is broken when it ends for no reason that was injected.
const UNEXPLAINED: &str = "a node ends only for a reason";

/// The keys of robots that are stopped.
const STOPPED: &[u8] = b"abac\0stopped/";

/// The secret behind a node's receipts.
pub(super) fn secret(id: u64) -> Secret {
    Secret([u8::try_from(id % 251).unwrap_or(0); 32])
}

impl World {
    /// Switches a node on.
    pub(super) fn start(&mut self, id: u64) -> Check {
        let abac = self.access_control();
        let salt = self.random.nodes.number();
        let waits_for_disk = self.random.nodes.percent(70);
        let Some(node) = self.nodes.get_mut(&id).filter(|node| !node.lost && node.up.is_none()) else { return Ok(()) };
        let store = match open_blocks(node, self.network, self.plan.segment_bytes, salt) {
            Ok(store) => Arc::new(store),
            Err(fault) => return self.refused(id, &fault),
        };
        if let Some(file) = node.damaged.clone()
            && node.disk.contents(&file).is_some()
        {
            // A start does not read what is finished; the check that follows it does.
            return match store.check_finished(|_| true) {
                Err(fault) => self.refused(id, &fault),
                Ok(()) => self.undetected(id, &file),
            };
        }
        node.damaged = None;
        self.invariants.committed.reopened(id, &store)?;
        self.invariants.acknowledged.restarted(id, &store)?;
        ledger_base::mutation::set_wall_clock(node.clock.wall(self.now));
        let snapshots = Snapshots::open(Arc::new(node.snapshots.clone()), self.network);
        let snapshots = Arc::new(snapshots.map_err(|fault| does_not_start(id, &fault))?);
        let mut registry = Registry::new();
        registry.install(abac).unwrap();
        registry.install(Arc::new(node.rules.clone())).unwrap();
        registry.speak_up_to(node.speaks);
        let mut keeping = Keeping { node, network: self.network, replayed: Vec::new() };
        let opening = Opening {
            genesis: &self.genesis,
            registry: &registry,
            store: &store,
            snapshots: &snapshots,
            diverged: false,
            certified: None,
        };
        let ledger = match opening.open(&mut keeping) {
            Ok(ledger) => ledger,
            Err(fault) if fault.code == Code::UnknownRules => {
                let height = self.invariants.rules_by_height.newest_from();
                return self.outdated(id, height, &fault);
            }
            Err(fault) => return Err(does_not_start(id, &fault)),
        };
        let Keeping { node, replayed, .. } = keeping;
        self.coverage.restarts += u64::from(node.start > 0);
        node.start += 1;
        node.clock.start(self.now, ledger.tip().time);
        let mut ground = node.ground.clone();
        let ledger = Arc::new(ledger);
        let waiters = Arc::new(Waiters::default());
        let executor = Arc::new(Executor::new(Arc::clone(&ledger), vec![Arc::clone(&waiters) as _]));
        for (entry, outcome) in &replayed {
            self.observe(id, &ledger, entry, outcome)?;
        }
        let tip = ledger.tip().height;
        self.invariants.stops_last.opened(id, tip, &stopped(&ledger))?;
        let ballot = Ballot::default();
        let members = ledger.members().unwrap();
        self.invariants.log_matching.look(id, &store)?;
        let last = store.last_index();
        let attested = msp::attestations(&**ledger.state()).unwrap();
        let mut said = Said::default();
        for own in attested.iter().filter(|record| record.id == id) {
            said.note(&own.latest.attest);
            own.snapshot.iter().for_each(|snapshot| said.note(&snapshot.attest));
        }
        let certifier = self.certifier(id, &ledger, last);
        let (asked, election_time) = (self.asked_by(id, &ledger), self.plan.timing.election_time());
        let records = msp::nodes(&**ledger.state()).unwrap().into_iter();
        let voters = records.filter(|record| members.is_voter(record.id));
        let voters = voters.map(|record| (record.id, record.organisation)).collect();
        let key = ReceiptKey::new(id, &secret(id));
        let own = Own { id, voters, term: store.hard_state().term, last, key };
        let look = Look::new(self.now, own, asked.len(), election_time, ballot.clone());
        let running = Running {
            replica: None,
            executor,
            waiters,
            wanted: Desired::read(&**ledger.state()).unwrap(),
            wants_others: false,
            reads: Reads::new(tip),
            retries: Retries::default(),
            shares: Shares::new(PLACES),
            turns: Turns::new(WORKERS),
            streams: BTreeMap::new(),
            judged: BTreeMap::new(),
            answers: mpsc::channel(),
            waiting: BTreeMap::new(),
            store,
            snapshots,
            ledger: Arc::clone(&ledger),
            flushing: false,
            waits_for_disk,
            inbox: VecDeque::new(),
            given: VecDeque::new(),
            executing: false,
            turn_at: u64::MAX,
            reads_at: u64::MAX,
            behind: Vec::new(),
            space: Space::of(String::new(), &mut ground),
            ground,
            conductor: Conductor::new(id, ledger),
            look,
            look_at: 0,
            heard: Vec::new(),
            begun: false,
            ballot,
            fetching: None,
            said,
            certifier,
            certificates: BTreeMap::new(),
            stated: 0,
            ordinary: tip,
            leading: false,
        };
        if let Some(node) = self.nodes.get_mut(&id) {
            node.up = Some(running);
        }
        self.note(format_args!("n{id} starts at height {tip}, log up to {last}"));
        let housekeeping = self.random.nodes.below(self.plan.state_flush);
        self.schedule_timer(id, housekeeping, Timer::Housekeeping);
        let attest = self.random.nodes.below(2 * SECOND);
        self.schedule_timer(id, attest, Timer::Attest);
        self.schedule_timer(id, SECOND, Timer::Tell);
        self.ask_all(id, &asked)
    }

    /// A node does not start on the log that it finds.
    fn refused(&mut self, id: u64, fault: &StoreError) -> Check {
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        match fault {
            StoreError::DiskFull { .. } => {}
            StoreError::Io { .. } if node.disk_will_fail.is_some() => {
                node.disk.kill();
                if let Some(fault) = node.disk_will_fail {
                    self.coverage.fault(fault);
                }
            }
            StoreError::Corrupt { .. } if node.damaged.is_some() => {
                self.lose(id);
                return Ok(());
            }
            fault => return Err(Violation::new(UNEXPLAINED, format!("node {id} does not start: {fault}"))),
        }
        self.note(format_args!("n{id} cannot start: {fault}"));
        self.schedule(SECOND, Event::Start { node: id });
        Ok(())
    }

    /// Ends a process. Unsynced writes survive if the machine goes on, and not (or in parts) if power fails.
    pub(super) fn stop(&mut self, id: u64, power_fails: bool) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.up = None;
        node.paused_until = 0;
        if power_fails {
            node.disk_will_fail = None;
            node.disks().into_iter().for_each(SimDisk::crash);
        } else {
            node.disks().into_iter().for_each(SimDisk::kill);
        }
        self.note(format_args!("n{id} stops, power fails: {power_fails}"));
    }

    /// A node's disk is gone for good.
    pub(super) fn lose(&mut self, id: u64) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        node.up = None;
        node.lost = true;
        self.coverage.fault(Fault::Replacement);
        self.replace(id);
    }

    /// A process has failed by itself; it starts again soon.
    pub(super) fn failed(&mut self, id: u64, why: &str) -> Check {
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        match node.disk_will_fail {
            Some(fault) => self.coverage.fault(fault),
            None if node.damaged.is_some() => {}
            None => return Err(Violation::new(UNEXPLAINED, format!("node {id}: {why}"))),
        }
        // The machine may live on with pages that were never written, or not.
        let power_fails = self.random.faults.percent(50);
        self.stop(id, power_fails);
        let delay = self.random.faults.between(5 * MILLISECOND, 2 * SECOND);
        self.schedule(delay, Event::Start { node: id });
        Ok(())
    }

    /// A node stops before a block whose rules it does not speak. Somebody installs a newer release there.
    fn outdated(&mut self, id: u64, height: u64, fault: &Rejection) -> Check {
        let Some(node) = self.nodes.get(&id) else { return Ok(()) };
        self.invariants.rules_by_height.stopped(id, height, node.speaks.number())?;
        self.note(format_args!("n{id} stops: {fault}"));
        self.coverage.fault(Fault::Outdated);
        self.upgrade(id)
    }

    /// A node gets a release that speaks the newer rules.
    pub(super) fn upgrade(&mut self, id: u64) -> Check {
        self.stop(id, false);
        if let Some(node) = self.nodes.get_mut(&id) {
            node.speaks = Rules::OF_TESTS;
        }
        let delay = self.random.nodes.between(10, 3_000) * MILLISECOND;
        self.schedule(delay, Event::Start { node: id });
        Ok(())
    }

    /// A node executes a block.
    pub(super) fn executed(&mut self, id: u64, executor: &Executor, entry: &Entry) -> Check {
        if let Some(node) = self.nodes.get(&id) {
            ledger_base::mutation::set_wall_clock(node.clock.wall(self.now));
        }
        if self.running(id).is_none() {
            // It has stopped before an earlier one of these blocks.
            return Ok(());
        }
        let index = entry.index;
        let outcome = match executor.execute(entry) {
            Ok(outcome) => outcome,
            Err(fault) if fault.code == Code::UnknownRules => return self.outdated(id, index, &fault),
            Err(fault) => {
                return Err(Violation::new(UNEXPLAINED, format!("node {id} cannot execute block {index}: {fault}")));
            }
        };
        self.observe(id, executor.ledger(), entry, &outcome)
    }

    /// A new replica that goes on from what is executed.
    pub(super) fn replica(&self, id: u64, seed: u64, running: &Running) -> Result<Replica<Client>, Violation> {
        let settings = Settings { id, seed, timing: self.plan.timing, secret: secret(id) };
        let Running { store, executor, waiters, wanted, .. } = running;
        let (store, executor, waiters) = (Arc::clone(store), Arc::clone(executor), Arc::clone(waiters));
        let ballots = Arc::new(Voting::new(Arc::clone(executor.ledger()), self.keys(id)));
        Replica::start(&settings, store, executor, waiters, wanted.clone(), ballots)
            .map_err(|fault| Violation::new(UNEXPLAINED, format!("node {id} cannot order: {fault}")))
    }

    /// Access control for one start of a node. Most runs share one, which is faster; the others give every start its
    /// own, with caches of its own, as a process has.
    fn access_control(&mut self) -> Arc<dyn Chaincode> {
        if let Some(shared) = &self.access {
            return Arc::clone(shared);
        }
        let new: Arc<dyn Chaincode> = Arc::new(AccessControl::new().unwrap());
        if self.plan.shares_caches {
            self.access = Some(Arc::clone(&new));
        }
        new
    }

    /// Height, block hash and digest that a node has reached.
    pub(crate) fn tip(&self, id: u64) -> Option<(u64, Hash, Hash)> {
        let tip = self.nodes.get(&id)?.up.as_ref()?.ledger.tip();
        Some((tip.height, tip.hash, tip.digest))
    }
}

/// The robots that are stopped, by what a node has stored.
fn stopped(ledger: &Ledger) -> BTreeSet<String> {
    let stops = ledger.state().range(STOPPED, None, usize::MAX).unwrap();
    let names = stops.iter().filter_map(|(key, _)| std::str::from_utf8(key.strip_prefix(STOPPED)?).ok());
    names.map(str::to_owned).collect()
}

fn does_not_start(id: u64, fault: &Rejection) -> Violation {
    Violation::new(UNEXPLAINED, format!("node {id} does not start: {fault}"))
}
