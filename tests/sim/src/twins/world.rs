//! The event queue, the network between the parts, and the threads of the nodes.

use super::cast::{Cast, Keys};
use super::copy::{Copy, Nobody, Up};
use super::judge::{Counts, Judge};
use super::operator::Client;
use super::plan::Plan;
use crate::clock::{Clock, EPOCH, MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use crate::node::{Keeping, Node, open_blocks};
use crate::trace::Trace;
use bytes::Bytes;
use ledger::members::Membership;
use ledger::network::{FoundingNode, Genesis};
use ledger::{Chaincode, Ledger, Outcome, Registry, Rules, msp};
use ledger_abac::AccessControl;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::{Governance, Signed};
use ledger_raft::{Desired, Evidence as SentEvidence, Input, PeerMessage, RaftKind, Role, Secret, SignedStatement};
use ledger_replica::catch_up::{Holding, Who};
use ledger_replica::certifier::{self, Certifiable, Certifier, Earlier, Era};
use ledger_replica::company::{Company, Follows, Place, Said};
use ledger_replica::disputes::{self, Disputes, View};
use ledger_replica::opening::Opening;
use ledger_replica::{Circumstances, Effect, Event, Executor, Now, Replica, Settings, Timing, Voting, Waiters, Work};
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::Snapshots;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use testkit::Random;

/// Events of one run before it is given up.
const EVENTS_MAX: u64 = 10_000_000;
/// Most statements in the record of a node.
const SIGNED_MAX: usize = 256;
/// Time between two looks at the time.
const BEAT: u64 = 250 * MILLISECOND;
/// Looks at the time until proofs are sent again.
const BEATS_AGAIN: u64 = 16;
/// Time between two comparisons of chains.
const ASK_EVERY: u64 = 2 * SECOND;
/// For so long a node whose history most voters do not have looks for a certificate (`src/peers/chain_monitor.rs`).
const FORKED_PATIENCE: u64 = 10 * SECOND;
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
    /// Honest nodes get into other parts.
    Parts,
    /// A liar sends something forged.
    Forge,
    /// An honest node crashes.
    Crash,
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
    pub(super) network: Hash,
    pub(super) genesis: Bytes,
    founded: Governance,
    access: Arc<dyn Chaincode>,
    /// The part of each honest node, by number.
    pub(super) parts: BTreeMap<u64, usize>,
    /// Honest nodes of different parts do not reach each other.
    pub(super) is_cut: bool,
    /// The liars lie now.
    pub(super) lying: bool,
    pub(super) clients: Vec<Client>,
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
            done: BTreeSet::new(),
            reign: None,
            queue: BTreeMap::new(),
            sequence: 0,
            copies,
            random,
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

    fn schedule_timer(&mut self, at: usize, delay: u64, work: Timer) {
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
            Happening::Parts => self.change_parts(),
            Happening::Forge => self.forge(),
            Happening::Crash => self.crash(),
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
        let replica =
            Replica::start(&settings, Arc::clone(&store), Arc::clone(&executor), waiters, wanted(&ledger), ballots);
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
            is_contradicted: false,
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
    fn end(&mut self, at: usize, code: Code) {
        self.note(format_args!("{} ends: {code}", self.label(at)));
        self.stop(at, false);
        self.copies[at].ended = Some(code);
    }

    fn clocks(&self, at: usize) -> Now {
        let clock = &self.copies[at].node.clock;
        Now {
            clock: clock.now(self.now),
            elapsed: self.now,
            accepts_until: clock.accepts_until(self.now),
            doubt: clock.doubt(self.now),
        }
    }

    pub(super) fn input(&mut self, at: usize, input: Input) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        if up.flushing {
            up.inbox.push_back(Event::Input(input));
            return Ok(());
        }
        self.turn(at, [Event::Input(input)])
    }

    /// One turn of the order thread, as in `src/ordering/orderer/order.rs`.
    fn turn(&mut self, at: usize, events: impl IntoIterator<Item = Event>) -> Check {
        for event in events {
            self.step(at, event)?;
        }
        self.step(at, Event::Time { full: false })?;
        self.begin_write(at);
        self.execute(at)?;
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return Ok(()) };
        let wait = if up.flushing { 50 * MILLISECOND } else { up.replica.wait(now) };
        let due = now.elapsed.saturating_add(wait);
        if due < up.turn_at || up.turn_at <= now.elapsed {
            up.turn_at = due;
            self.schedule_timer(at, wait, Timer::Turn);
        }
        Ok(())
    }

    fn turned(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at).filter(|up| !up.flushing) else { return Ok(()) };
        let inbox = std::mem::take(&mut up.inbox);
        self.turn(at, inbox)
    }

    pub(super) fn step(&mut self, at: usize, mut event: Event) -> Check {
        if self.withholds(at, &mut event) {
            return Ok(());
        }
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return Ok(()) };
        let mut effects = Vec::new();
        up.replica.step(now, event, &mut effects);
        effects.into_iter().try_for_each(|effect| self.carry_out(at, effect))
    }

    fn carry_out(&mut self, at: usize, effect: Effect) -> Check {
        match effect {
            Effect::Send { to, message } => return self.send(at, to, &message),
            Effect::Role(change) => {
                let label = self.label(at);
                self.note(format_args!(
                    "{label} {:?} of term {}, leader {:?}",
                    change.role, change.term, change.leader
                ));
                let (id, is_honest) = (self.copies[at].node.id, !self.copies[at].lies);
                if change.role == Role::Leader {
                    self.judge.leads(id, at, change.term);
                }
                let liars = self.copies[at].evidence.liars();
                if let Some(leader) = change.leader.filter(|leader| is_honest && liars.contains(leader)) {
                    let what = format!("{label} follows node {leader} in term {}", change.term);
                    return Err(Violation::new("nobody follows a liar of whom it has the proof", what));
                }
                return self.keeps_its_leader(at, change.term, change.leader);
            }
            Effect::Members { height, membership } => {
                self.note(format_args!("{} members at {height}: {membership:?}", self.label(at)));
            }
            Effect::Misbehaved(proof) => {
                let Some(up) = self.up(at) else { return Ok(()) };
                let mut found = Vec::new();
                up.disputes.found(*proof, &mut found);
                return self.follow(at, found);
            }
            Effect::Contradicted(found) => {
                self.note(format_args!("{} contradicted by {found:?}", self.label(at)));
                if let Some(up) = self.up(at) {
                    up.is_contradicted = true;
                }
            }
            Effect::Ignored { from, reason } => {
                self.note(format_args!("{} ignores a message of n{from}: {reason}", self.label(at)));
            }
            Effect::Failed(reason) => {
                return Err(Violation::new("a node ends only for a reason", format!("{}: {reason}", self.label(at))));
            }
            Effect::Status(_)
            | Effect::Reconciles(_)
            | Effect::Read { .. }
            | Effect::Denied(_)
            | Effect::Refused { .. }
            | Effect::Behind { .. } => {}
        }
        Ok(())
    }

    /// The copies that hear what this one sends to a number.
    pub(super) fn heard_by(&mut self, at: usize, to: u64) -> Vec<usize> {
        let part = |world: &Self, id: u64| world.parts.get(&id).copied().unwrap_or_default();
        let from = &self.copies[at];
        let (lies, face, own) = (from.lies, from.face, part(self, from.node.id));
        let eavesdrops = self.lying && !lies && self.random.percent(10);
        let hears = |copy: &Copy| match (lies, copy.lies) {
            (false, false) => !self.is_cut || part(self, copy.node.id) == own,
            (false, true) => copy.face == own || eavesdrops,
            (true, false) => part(self, copy.node.id) == face,
            (true, true) => copy.face == face,
        };
        let all = self.copies.iter().enumerate();
        all.filter(|(_, copy)| copy.node.id == to && !copy.gone && hears(copy)).map(|(at, _)| at).collect()
    }

    pub(super) fn send(&mut self, at: usize, to: u64, message: &PeerMessage) -> Check {
        if let PeerMessage::Raft(raft) = message {
            let (kind, id) = (raft.kind(), self.copies[at].node.id);
            match kind {
                RaftKind::VoteResponse if !raft.reject => self.judge.votes(id, raft.term, to)?,
                RaftKind::Vote => self.judge.votes(id, raft.term, id)?,
                _ => {}
            }
            if !matches!(kind, RaftKind::Heartbeat | RaftKind::HeartbeatResponse) {
                let (term, index, entries, refused) = (raft.term, raft.index, raft.entries.len(), raft.reject);
                let label = self.label(at);
                self.note(format_args!(
                    "{label} > n{to} {kind:?} term {term} index {index} +{entries} refused {refused}"
                ));
            }
        }
        if let PeerMessage::Complaint(complaint) = message {
            self.note(format_args!("{} complains about n{} to n{to}", self.label(at), complaint.leader));
            let is_liar = self.copies.iter().any(|copy| copy.lies && copy.node.id == complaint.leader);
            if is_liar && !self.copies[at].lies {
                self.judge.counts.count("a voter complains about a withholding leader");
            }
        }
        let bytes = message.to_bytes();
        for target in self.heard_by(at, to) {
            if self.random.per_mille(self.plan.lose_per_mille) {
                continue;
            }
            let (from, delay) = (self.copies[at].node.id, self.random.between(100, self.plan.delay_max));
            self.schedule(delay, Happening::Deliver { from, to: target, bytes: bytes.clone() });
        }
        Ok(())
    }

    fn send_all(&mut self, at: usize, message: &PeerMessage, except: u64) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        let (members, me) = (up.ledger.members().unwrap().nodes(), self.copies[at].node.id);
        members.into_iter().filter(|to| ![me, except].contains(to)).try_for_each(|to| self.send(at, to, message))
    }

    fn deliver(&mut self, from: u64, at: usize, bytes: Bytes) -> Check {
        let now = self.now;
        let copy = &mut self.copies[at];
        let certified = copy.certified();
        let (certificates, Some(up)) = (&copy.certificates, &mut copy.up) else { return Ok(()) };
        let message = PeerMessage::decode(bytes).unwrap();
        let mut found = Vec::new();
        match message {
            PeerMessage::Statement(SignedStatement { signed }) => {
                let Ok(signed) = Signed::from_bytes(&signed) else { return Ok(()) };
                let certificate = |height| certificates.get(&height).cloned();
                let view = View { certifier: &up.certifier, certified, certificate: &certificate };
                up.disputes.heard(now, from, &signed, &view, &mut found);
                self.follow(at, found)?;
                self.certify(at, certifier::Event::Heard { from, signed })
            }
            PeerMessage::Evidence(SentEvidence { proof }) => {
                up.disputes.shown(from, &proof, &mut found);
                self.follow(at, found)
            }
            message if up.company.withholds(from, &message) => Ok(()),
            message => self.input(at, Input::Message { from, message }),
        }
    }

    fn begin_write(&mut self, at: usize) {
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return };
        if up.replica.must_write(now) && !std::mem::replace(&mut up.flushing, true) {
            let time = 50 + self.random.below(self.plan.disk_max);
            self.schedule_timer(at, time, Timer::Flushed);
        }
    }

    fn flushed(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        up.flushing = false;
        let written = up.store.flush().map(drop);
        let inbox = std::mem::take(&mut up.inbox);
        self.step(at, Event::Written(written))?;
        self.execute(at)?;
        self.certify(at, certifier::Event::Time)?;
        self.turn(at, inbox)
    }

    fn execute(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        let now = Circumstances { inputs_wait: false, other_is_idle: true };
        let Some(work) = up.replica.work(now) else { return Ok(()) };
        let executor = Arc::clone(&up.executor);
        let (Work::Here(entries) | Work::Elsewhere(entries)) = &work;
        for entry in entries {
            let outcome = executor.execute(entry).map_err(|fault| {
                Violation::new("a node ends only for a reason", format!("block {}: {fault}", entry.index))
            })?;
            self.observe(at, entry, &outcome)?;
        }
        executor.look_at_deadline();
        let height = entries.last().map_or(0, |entry| entry.index);
        match work {
            Work::Here(_) => self.step(at, Event::Executed { height, took: 100 }),
            Work::Elsewhere(_) => {
                let at_clock = self.clocks(at).clock;
                self.step(at, Event::Input(Input::Applied { height, at: at_clock }))
            }
        }
    }

    /// A node has executed a block.
    fn observe(&mut self, at: usize, entry: &Entry, outcome: &Outcome) -> Check {
        let (height, label) = (outcome.header.height, self.label(at));
        let codes: Vec<&str> = outcome.results.iter().map(|result| result.code().name()).collect();
        self.note(format_args!("{label} block {height} term {} {} {codes:?}", entry.term, outcome.hash));
        let now = self.now;
        let copy = &mut self.copies[at];
        copy.node.clock.observe(now, outcome.header.time);
        let (id, lies) = (copy.node.id, copy.lies);
        let Some(up) = &mut copy.up else { return Ok(()) };
        up.headers.insert(height, outcome.header.clone());
        let ledger = Arc::clone(&up.ledger);
        let leads = up.replica.leads();
        self.judge.executed(id, (height, entry.term), &entry.data, outcome.hash)?;
        if !lies {
            self.done.extend(outcome.ids.iter().copied());
            let strict = ledger.voters().unwrap().rule.strict_since.is_some();
            self.judge.is_strict(id, height, strict)?;
            if leads {
                self.is_held(at, entry)?;
            }
        }
        if outcome.governs {
            let wanted = wanted(&ledger);
            self.step(at, Event::Wanted(wanted))?;
        }
        if let Some(roots) = outcome.certifiable {
            let (time, block) = (outcome.header.time, outcome.hash);
            let block = Certifiable { height, time, block, results: roots.results };
            self.certify(at, certifier::Event::Executed { block, governs: outcome.governs })?;
        }
        if outcome.governs { self.certify(at, certifier::Event::Voters(era(&ledger))) } else { Ok(()) }
    }

    /// A leader executes what a majority has, liars whatever they say. A node that is down may have it.
    fn is_held(&self, at: usize, entry: &Entry) -> Check {
        let leader = &self.copies[at];
        let Some(up) = &leader.up else { return Ok(()) };
        let Membership { voters, .. } = up.ledger.members().unwrap();
        let holds = |id: &&u64| {
            let mut all = self.copies.iter().filter(|copy| copy.node.id == **id);
            all.any(|copy| match &copy.up {
                Some(up) if !copy.lies => up.entry(entry.index) == Some((entry.term, entry.data.clone())),
                _ => true,
            })
        };
        let holders: Vec<_> = voters.iter().filter(holds).collect();
        if 2 * holders.len() > voters.len() {
            return Ok(());
        }
        let what = format!("{} executes block {}, which {holders:?} of {voters:?} may have", leader.name, entry.index);
        Err(Violation::new("a leader counts only those who have its log", what))
    }

    pub(super) fn certify(&mut self, at: usize, event: certifier::Event) -> Check {
        let now = self.now;
        let Some(up) = self.up(at) else { return Ok(()) };
        let (mut effects, mut found) = (Vec::new(), Vec::new());
        let durable = up.store.durable_index();
        up.certifier.step(now, event, &mut effects);
        up.certifier.step(now, certifier::Event::Durable(durable), &mut effects);
        for effect in effects {
            let copy = &mut self.copies[at];
            let id = copy.node.id;
            match effect {
                certifier::Effect::Record(statement) => {
                    copy.node.signed.push_back(statement);
                    if copy.node.signed.len() > SIGNED_MAX {
                        copy.node.signed.pop_front();
                    }
                }
                certifier::Effect::Tell(signed) => {
                    self.judge.signs(id, &signed.statement)?;
                    self.tell(at, &signed)?;
                }
                certifier::Effect::Pass(signed) => self.tell(at, &signed)?,
                certifier::Effect::Certified { certificate, .. } => {
                    let height = certificate.statement.height;
                    copy.certificates.insert(height, certificate.clone());
                    if !copy.lies {
                        self.judge.made(id, &certificate, self.lying)?;
                    }
                    let label = self.label(at);
                    self.note(format_args!("{label} certifies {height} {}", certificate.statement.block));
                }
                certifier::Effect::Misbehaved(proof) => {
                    if let Some(up) = self.up(at) {
                        up.disputes.found(*proof, &mut found);
                    }
                }
            }
        }
        let certified = self.copies[at].certified();
        if let Some(up) = self.up(at) {
            up.disputes.look(certified, &mut found).unwrap();
        }
        self.follow(at, found)
    }

    fn tell(&mut self, at: usize, signed: &Signed) -> Check {
        let message = PeerMessage::Statement(SignedStatement { signed: signed.to_bytes() });
        self.send_all(at, &message, 0)
    }

    /// Does what follows from something that contradicts. A liar does not care.
    pub(super) fn follow(&mut self, at: usize, found: Vec<disputes::Effect>) -> Check {
        for effect in found {
            let (id, lies) = (self.copies[at].node.id, self.copies[at].lies);
            match effect {
                disputes::Effect::Pass(signed) => self.tell(at, &signed)?,
                _ if lies => {}
                disputes::Effect::Show { proof, except } => {
                    let message = PeerMessage::Evidence(SentEvidence { proof: proof.to_bytes() });
                    self.send_all(at, &message, except)?;
                }
                disputes::Effect::Keep(proof) => {
                    self.note(format_args!("{} proves that n{} has misbehaved", self.label(at), proof.node()));
                    self.judge.proves(id, &proof)?;
                }
                disputes::Effect::Exclude(liars) => self.input(at, Input::Exclude(liars))?,
                disputes::Effect::Diverged { height } => {
                    return Err(Violation::new(
                        "a node ends only for a reason",
                        format!("n{id} computed {height} twice"),
                    ));
                }
                disputes::Effect::Contradicted { branch, .. } => {
                    let own = &self.copies[at].certificates;
                    self.judge.contradicted(id, branch.certificate(), branch.height(), own)?;
                    self.end(at, Code::Contradicted);
                }
                disputes::Effect::TwoCertificates(branch) => {
                    self.note(format_args!("{} shows two certificates of {}", self.label(at), branch.height()));
                    if self.judge.is_binding() {
                        let what = format!("n{id} shows two certificates of block {}", branch.height());
                        return Err(Violation::new("no two certificates for one height", what));
                    }
                    self.judge.counts.count("two strict certificates where two organisations lie");
                }
                disputes::Effect::Refused { from, reason } => {
                    self.note(format_args!("{} refuses a proof of n{from}: {}", self.label(at), reason.code));
                }
            }
        }
        Ok(())
    }

    fn beat(&mut self, at: usize) -> Check {
        self.schedule_timer(at, BEAT, Timer::Beat);
        self.certify(at, certifier::Event::Time)?;
        let Some(up) = self.up(at) else { return Ok(()) };
        up.beats += 1;
        if !up.beats.is_multiple_of(BEATS_AGAIN) {
            return Ok(());
        }
        let mut found = Vec::new();
        up.disputes.again(&mut found);
        self.follow(at, found)
    }

    /// A node compares its chain with those of the voters that it reaches (`src/peers/chain_monitor.rs`).
    fn ask(&mut self, at: usize) -> Check {
        self.schedule_timer(at, ASK_EVERY, Timer::Ask);
        if self.copies[at].lies {
            return Ok(());
        }
        let Some(up) = self.up(at) else { return Ok(()) };
        let members = up.ledger.members().unwrap();
        let known = msp::nodes(&**up.ledger.state()).unwrap();
        let organisation = |id: &u64| known.iter().find(|node| node.id == *id).map(|node| node.organisation.clone());
        let voters = members.voters.iter().filter_map(|id| Some((*id, organisation(id)?)));
        let place = Place { voters: voters.collect(), members: members.nodes(), cut_off: false };
        let mut height = None;
        loop {
            let said = self.said_to(at, &place, height.unwrap_or(u64::MAX));
            self.ask_for_certificates(at, &said)?;
            let Some(up) = self.up(at) else { return Ok(()) };
            match up.company.heard(&said, &place, height).unwrap() {
                Follows::Ask(other) if height.is_none() => height = Some(other),
                Follows::Stop(reason) if reason.code == Code::Forked => {
                    let now = self.now;
                    let Some(up) = self.up(at) else { return Ok(()) };
                    let strict = up.ledger.voters().unwrap().rule.strict_since.is_some();
                    let since = *up.forked.get_or_insert(now);
                    if !strict || now - since > FORKED_PATIENCE {
                        self.end(at, Code::Forked);
                    }
                    return Ok(());
                }
                Follows::Stop(reason) => {
                    let what = format!("{}: {reason}", self.label(at));
                    return Err(Violation::new("a node ends only for a reason", what));
                }
                Follows::Nothing | Follows::Ask(_) | Follows::Fetch(_) => {
                    if let Some(up) = self.up(at) {
                        up.forked = None;
                    }
                    return Ok(());
                }
            }
        }
    }

    fn said_to(&mut self, at: usize, place: &Place, height: u64) -> Vec<Said> {
        let me = self.copies[at].node.id;
        let own = self.copies[at].up.as_ref().and_then(|up| up.point(height)).map_or(0, |own| own.height);
        let mut said = Vec::new();
        for (id, organisation) in place.voters.iter().filter(|(id, _)| **id != me) {
            for target in self.heard_by(at, *id) {
                let copy = &self.copies[target];
                let Some(up) = &copy.up else { continue };
                let tip = up.ledger.tip().height;
                let has =
                    Holding { height: tip, durable: up.store.durable_index(), first_height: 1, ..Holding::default() };
                let who = Who { id: *id, organisation: organisation.clone(), name: copy.name.clone(), vouched: false };
                said.push(Said { who, has, at: up.point(own.min(height)), stranger: false });
                break;
            }
        }
        said
    }

    /// Asks those that have another block for the certificate that covers it.
    fn ask_for_certificates(&mut self, at: usize, said: &[Said]) -> Check {
        for one in said {
            let Some(there) = one.at else { continue };
            let Some(own) = self.copies[at].up.as_ref().and_then(|up| up.point(there.height)) else { return Ok(()) };
            if own.height != there.height || own.hash == there.hash {
                continue;
            }
            let Some(target) = self.heard_by(at, one.who.id).into_iter().next() else { continue };
            let copy = &self.copies[target];
            let branch = copy.up.as_ref().and_then(|up| up.branch(there.height, &copy.certificates));
            let Some(branch) = branch else { continue };
            let (certified, mut found) = (self.copies[at].certified(), Vec::new());
            if let Some(up) = self.up(at) {
                up.disputes.branch(branch, certified, &mut found);
            }
            self.follow(at, found)?;
        }
        Ok(())
    }
}

/// The members that a ledger wants.
fn wanted(ledger: &Ledger) -> Desired {
    let (voters, learners) = msp::desired(&msp::nodes(&**ledger.state()).unwrap());
    Desired { voters, learners, strict_hands: msp::strict_hands(&**ledger.state()).unwrap() }
}

/// The voters whose statements count for the blocks after the newest.
fn era(ledger: &Ledger) -> Era {
    Era { from: ledger.tip().height + 1, voters: ledger.voters().unwrap(), msps: ledger.msps() }
}
