//! The event queue, and the machines that are switched on and off.

use super::bridges::{Bridge, Driver};
use super::cast::{Cast, Keys};
use super::control::Control;
use super::copy::{Copy, Nobody, Up};
use super::judge::{Counts, Judge};
use super::operator::Client;
use super::plan::Plan;
use crate::clock::{Clock, EPOCH, MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use crate::node::{Keeping, Node, open_blocks};
use crate::trace::Trace;
use bytes::Bytes;
use ledger::network::{FoundingNode, Genesis};
use ledger::{Chaincode, Ledger, Registry, Rules};
use ledger_abac::AccessControl;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::Governance;
use ledger_raft::{Desired, Input, Secret};
use ledger_replica::certifier::{Certifier, Earlier, Era};
use ledger_replica::company::Company;
use ledger_replica::disputes::Disputes;
use ledger_replica::opening::Opening;
use ledger_replica::{Event, Executor, Now, Replica, Settings, Timing, Voting, Waiters};
use ledger_storage::snapshot::Snapshots;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use testkit::Random;

/// Events of one run before it is given up.
const EVENTS_MAX: u64 = 10_000_000;
/// Time between two looks at the time.
pub(super) const BEAT: u64 = 250 * MILLISECOND;
/// Time between two comparisons of chains.
pub(super) const ASK_EVERY: u64 = 2 * SECOND;
/// Long enough that no segment ends.
const SEGMENT_BYTES: u64 = 1024 * 1024;

/// Something that will happen.
pub(super) enum Happening {
    /// A node is switched on.
    Start { at: usize },
    /// Something of one start of a process.
    Process { at: usize, start: u64, work: Timer },
    /// A message of a node arrives at a copy.
    Deliver { from: u64, to: usize, bytes: Bytes },
    /// A client looks what it is to do.
    Client { client: usize },
    /// A robot's bridge looks after itself.
    Bridge { at: usize },
    /// A person drives.
    Drive { driver: usize },
    /// Honest nodes get into other parts.
    Parts,
    /// A liar sends something forged.
    Forge,
    /// An honest node crashes.
    Crash,
    /// The power of a node that has just voted fails for a moment.
    FailsAfterVote { at: usize },
}

/// The work of a process at its own time.
pub(super) enum Timer {
    Turn,
    Flushed,
    Beat,
    Ask,
}

/// The network.
pub(super) struct World {
    pub(super) plan: Plan,
    pub(super) now: u64,
    pub(super) cast: Arc<Cast>,
    /// Every machine that ever was.
    pub(super) copies: Vec<Copy>,
    pub(super) judge: Judge,
    pub(super) trace: Trace,
    pub(super) random: Random,
    /// Decides which voters fail.
    pub(super) votes: Random,
    pub(super) network: Hash,
    pub(super) genesis: Bytes,
    pub(super) founded: Governance,
    access: Arc<dyn Chaincode>,
    /// The part of each honest node, by number.
    pub(super) parts: BTreeMap<u64, usize>,
    /// Honest nodes of different parts do not reach each other.
    pub(super) is_cut: bool,
    /// The liars lie now.
    pub(super) lying: bool,
    pub(super) clients: Vec<Client>,
    /// The robots' bridges; none while one is being looked after.
    pub(super) bridges: Vec<Option<Bridge>>,
    pub(super) drivers: Vec<Driver>,
    pub(super) control: Control,
    /// Transactions that bridges and drivers have signed.
    pub(super) nonces: u64,
    /// The transactions that honest nodes have executed.
    pub(super) done: BTreeSet<Hash>,
    /// In calm seeds: the term and the honest leader that must not change.
    pub(super) reign: Option<(u64, u64)>,
    queue: BTreeMap<(u64, u64), Happening>,
    sequence: u64,
}

impl World {
    pub(super) fn new(seed: u64, cast: &Arc<Cast>, keep_text: bool) -> Self {
        let plan = Plan::new(seed);
        let name = |node: u64| {
            let organisation = plan.organisation_of(node);
            let before = (1..node).filter(|other| plan.organisation_of(*other) == organisation).count();
            (format!("Org{}", organisation + 1), format!("node{}", before + 1))
        };
        let nodes = (1..=plan.voters()).map(|id| {
            let ((organisation, name), address) = (name(id), format!("127.0.0.1:{}", 7000 + id));
            FoundingNode { id, name, organisation, address, voter: true }
        });
        let genesis = Genesis {
            rules: Rules::NEWEST.number(),
            label: "simulated".into(),
            created: EPOCH - SECOND,
            salt: Hash::of(&[&seed.to_be_bytes()]),
            organisations: cast.organisations[..plan.shape.len()].to_vec(),
            nodes: nodes.collect(),
            snapshot_every: 1_000_000,
        };
        let genesis = genesis.to_bytes().unwrap();
        let (_, network) = Genesis::from_bytes(&genesis).unwrap();
        let mut random = Random::new(seed, "twins at work");
        let mut copies = Vec::new();
        for id in 1..=plan.voters() {
            let (organisation, name) = name(id);
            let lies = plan.lies(plan.organisation_of(id));
            copies.push(Copy {
                node: Node::new(id, random.number(), Clock::new(0, 0)),
                name: format!("{organisation}/{name}"),
                face: 0,
                lies,
                gone: false,
                ended: None,
                evidence: Arc::default(),
                certificates: BTreeMap::new(),
                joins: None,
                up: None,
            });
        }
        let mut world = Self {
            now: 0,
            cast: Arc::clone(cast),
            judge: Judge::new(&plan),
            trace: Trace::new(keep_text),
            founded: Genesis::governance(&genesis).unwrap(),
            access: Arc::new(AccessControl::new().unwrap()),
            parts: BTreeMap::new(),
            is_cut: false,
            lying: false,
            clients: Vec::new(),
            bridges: Vec::new(),
            drivers: Vec::new(),
            control: Control::default(),
            nonces: 0,
            done: BTreeSet::new(),
            reign: None,
            queue: BTreeMap::new(),
            sequence: 0,
            copies,
            random,
            votes: Random::new(seed, "votes"),
            network,
            genesis,
            plan,
        };
        let plan = format!("{:?}", world.plan);
        world.note(format_args!("seed {seed} {plan}"));
        for at in 0..world.copies.len() {
            let delay = world.random.below(100 * MILLISECOND);
            world.schedule(delay, Happening::Start { at });
        }
        world.employ();
        world.build_bridges();
        world
    }

    /// The deeds.
    pub(super) fn counts(&self) -> Counts {
        Counts { time: self.now, ..self.judge.counts.clone() }
    }

    /// Adds a line to the trace.
    pub(super) fn note(&mut self, what: std::fmt::Arguments<'_>) {
        self.trace.note(self.now, what);
    }

    pub(super) fn schedule(&mut self, delay: u64, happening: Happening) {
        self.sequence += 1;
        self.queue.insert((self.now + delay, self.sequence), happening);
    }

    pub(super) fn schedule_timer(&mut self, at: usize, delay: u64, work: Timer) {
        let start = self.copies[at].node.start;
        self.schedule(delay, Happening::Process { at, start, work });
    }

    /// Handles everything up to a moment.
    pub(super) fn run_until(&mut self, until: u64) -> Check {
        while let Some(next) = self.queue.first_entry() {
            if next.key().0 > until {
                break;
            }
            let ((at, _), happening) = next.remove_entry();
            self.now = at;
            if self.sequence > EVENTS_MAX {
                return Err(Violation::new("progress", format!("{EVENTS_MAX} events and no end")));
            }
            self.handle(happening)?;
        }
        self.now = until;
        Ok(())
    }

    fn handle(&mut self, happening: Happening) -> Check {
        match happening {
            Happening::Start { at } => self.start(at),
            Happening::Process { at, start, work } => {
                if self.copies[at].up.is_none() || self.copies[at].node.start != start {
                    return Ok(());
                }
                match work {
                    Timer::Turn => self.turned(at),
                    Timer::Flushed => self.flushed(at),
                    Timer::Beat => self.beat(at),
                    Timer::Ask => self.ask(at),
                }
            }
            Happening::Deliver { from, to, bytes } => self.deliver(from, to, bytes),
            Happening::Client { client } => self.work(client),
            Happening::Bridge { at } => self.bridge(at),
            Happening::Drive { driver } => self.drive(driver),
            Happening::Parts => self.change_parts(),
            Happening::Forge => self.forge(),
            Happening::Crash => self.crash(),
            Happening::FailsAfterVote { at } => self.fail_power(at),
        }
    }

    pub(super) fn up(&mut self, at: usize) -> Option<&mut Up> {
        self.copies[at].up.as_mut()
    }

    /// Switches a machine on.
    fn start(&mut self, at: usize) -> Check {
        if !self.copies[at].lives() || self.copies[at].up.is_some() {
            return Ok(());
        }
        let salt = self.random.number();
        let keys = self.keys(at);
        let copy = &mut self.copies[at];
        let store = Arc::new(open_blocks(&copy.node, self.network, SEGMENT_BYTES, salt).unwrap());
        let snapshots = Snapshots::open(Arc::new(copy.node.snapshots.clone()), self.network).unwrap();
        let mut registry = Registry::new();
        registry.install(Arc::clone(&self.access)).unwrap();
        let snapshots = Arc::new(snapshots);
        let newest = copy.certificates.values().next_back();
        let newest = newest.map(|newest| (newest.statement.height, newest.statement.block));
        let opening = Opening {
            genesis: &self.genesis,
            registry: &registry,
            store: &store,
            snapshots: &snapshots,
            diverged: false,
            certified: newest,
        };
        let mut keeping = Keeping { node: &mut copy.node, network: self.network, replayed: Vec::new() };
        let ledger = Arc::new(opening.open(&mut keeping).unwrap());
        let headers = keeping.replayed.iter().map(|(_, outcome)| (outcome.header.height, outcome.header.clone()));
        let headers: BTreeMap<_, _> = headers.collect();
        copy.node.start += 1;
        copy.node.clock.start(self.now, ledger.tip().time);
        let id = copy.node.id;
        let executor = Arc::new(Executor::new(Arc::clone(&ledger), Vec::new()));
        let earlier = Earlier { end: store.last_index(), signed: copy.node.signed.iter().copied().collect() };
        let organisation = copy.name.split('/').next().unwrap_or_default().to_owned();
        let (own, evidence) = (Arc::clone(&ledger), Arc::clone(&copy.evidence));
        let settings = Settings {
            id,
            seed: salt,
            timing: Timing::default(),
            secret: Secret([(2 * id) as u8 + copy.face as u8; 32]),
        };
        let ballots = Arc::new(Voting::new(Arc::clone(&ledger), keys.clone()));
        let waiters = Arc::new(Waiters::<Nobody>::default());
        let replica = Replica::start(
            &settings,
            Arc::clone(&store),
            Arc::clone(&executor),
            waiters,
            Desired::read(&**ledger.state()).unwrap(),
            ballots,
        );
        copy.up = Some(Up {
            replica: replica.unwrap(),
            executor,
            store,
            certifier: Certifier::new(id, self.network, keys.clone(), era(&ledger), earlier),
            disputes: Disputes::new(id, own, self.founded.clone(), keys, evidence),
            company: Company::new(Arc::clone(&ledger), &organisation, BTreeMap::new()),
            ledger,
            headers,
            flushing: false,
            inbox: VecDeque::new(),
            turn_at: u64::MAX,
            forked: None,
            contradicting: BTreeSet::new(),
            beats: 0,
        });
        self.note(format_args!("{} starts", self.label(at)));
        let liars = self.copies[at].evidence.liars();
        self.step(at, Event::Input(Input::Exclude(liars)))?;
        self.schedule_timer(at, 0, Timer::Turn);
        self.schedule_timer(at, BEAT, Timer::Beat);
        let first = self.random.below(ASK_EVERY);
        self.schedule_timer(at, first, Timer::Ask);
        self.look_back_at(at)
    }

    fn keys(&self, at: usize) -> Keys {
        let copy = &self.copies[at];
        Keys { id: copy.node.id, name: copy.name.clone(), cast: Arc::clone(&self.cast) }
    }

    /// `n3`, or `n3'` for the second copy.
    pub(super) fn label(&self, at: usize) -> String {
        let copy = &self.copies[at];
        format!("n{}{}", copy.node.id, if copy.face == 1 { "'" } else { "" })
    }

    /// Ends a process.
    pub(super) fn stop(&mut self, at: usize, power_fails: bool) {
        let copy = &mut self.copies[at];
        copy.up = None;
        for disk in copy.node.disks() {
            if power_fails { disk.crash() } else { disk.kill() }
        }
        self.note(format_args!("{} stops", self.label(at)));
    }

    /// A node stops by itself.
    pub(super) fn end(&mut self, at: usize, code: Code) {
        self.note(format_args!("{} ends: {code}", self.label(at)));
        self.stop(at, false);
        self.copies[at].ended = Some(code);
    }

    pub(super) fn clocks(&self, at: usize) -> Now {
        let clock = &self.copies[at].node.clock;
        Now {
            clock: clock.now(self.now),
            elapsed: self.now,
            accepts_until: clock.accepts_until(self.now),
            doubt: clock.doubt(self.now),
        }
    }
}

/// The voters whose statements count for the blocks after the newest.
pub(super) fn era(ledger: &Ledger) -> Era {
    Era { from: ledger.tip().height + 1, voters: ledger.voters().unwrap(), msps: ledger.msps() }
}
