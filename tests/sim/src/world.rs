//! The whole cluster in one thread: nodes, network, clients and what befalls them, as events in virtual time.
//!
//! Nothing here reads a clock, starts a thread or opens a socket; every choice is a number of a sequence that the seed
//! decides. Events of the same moment happen in the order in which they were scheduled.

mod chaos;
mod drive;
mod execute;
mod fetch;
mod flood;
mod gateway;
mod hostile;
mod lies;
mod look;
mod operator;
mod robot;
mod start;
mod statements;
mod streams;
mod witness;

pub(crate) use fetch::Contact;
pub use fetch::Fetching;
pub use operator::Replacement;
pub use robot::Untruth;
pub use statements::Keys;

use crate::client::{Book, Client, Heard};
use crate::clock::{Clock, EPOCH, MILLISECOND, SECOND};
use crate::confidential::Sealed;
use crate::coverage::{Coverage, Fault};
use crate::history::History;
use crate::invariant::{Check, Invariants, Violation};
use crate::links::Links;
use crate::lists::Lists;
use crate::node::{Answer, Node, Reply, Request};
use crate::people::{People, organisation_of};
use crate::plan::Plan;
use crate::robot::Robot;
use crate::trace::Trace;
use bytes::Bytes;
use ledger::members::{Membership, spare_one};
use ledger::msp::NodeRecord;
use ledger::network::{FoundingNode, Genesis};
use ledger::{Chaincode, Outcome, Rules};
use ledger_base::hash::Hash;
use ledger_raft::{Desired, SignedVote};
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;
use std::sync::Arc;
use testkit::Random;

/// Events that are scheduled in one run before it is given up: something goes round in circles.
const EVENTS_MAX: u64 = 30_000_000;

/// Something that will happen.
pub(crate) enum Event {
    /// To the process of a node, if that start of it still runs.
    Node { node: u64, start: u64, timer: Timer },
    /// A message arrives.
    Deliver { from: u64, to: u64, bytes: Bytes },
    /// A statement about a block arrives.
    Statement { from: u64, to: u64, signed: Bytes },
    /// A node is switched on.
    Start { node: u64 },
    /// A request arrives at a node.
    Request { node: u64, request: Request },
    /// An answer arrives at a client, with the node's clock.
    Answer { reply: Reply, clock: u64, answer: Answer },
    /// A client looks what it is to do, if it still waits for that.
    Client { client: usize, attempt: u64 },
    /// Something goes wrong.
    Fault,
    /// The operator looks after the members.
    Operator,
    /// A fault ends.
    Undo(Undo),
    /// Something happens to the robot.
    Robot(robot::Happening),
}

/// The work of a process at its own time.
pub(crate) enum Timer {
    /// The order thread has something to do.
    Turn,
    /// The flush of the log is done.
    Flushed,
    /// Committed blocks are executed.
    Execute,
    /// Readers that wait until the state is current are looked after.
    Reads,
    /// A stream has waited long enough for a height.
    Stream(u64),
    /// The turn of a stream is over.
    TurnOver(u64),
    /// The next thing is done to catch up.
    Fetch,
    /// A pause of the conductor is over.
    Conduct,
    /// A peer that was asked when the process started answers.
    Answered(u64),
    /// The question of the start goes on although nobody answers.
    Look,
    /// The node attests what it has computed.
    Attest,
    /// Its newest statement is told again.
    Tell,
    /// The world state is flushed, who waits too long is told.
    Housekeeping,
}

/// The end of a fault.
pub(crate) enum Undo {
    /// These links work again.
    Cut(u64),
    /// There is room on the disk.
    FullDisk(u64),
    /// A clock is set right that was far ahead.
    ClockHours,
}

/// Random sequences, one for each purpose.
pub(crate) struct Randoms {
    pub(crate) network: Random,
    pub(crate) disk: Random,
    pub(crate) faults: Random,
    pub(crate) clients: Random,
    pub(crate) nodes: Random,
    pub(crate) statements: Random,
    pub(crate) robot: Random,
    pub(crate) contests: Random,
    pub(crate) governance: Random,
    pub(crate) confidential: Random,
}

/// A block as the first node executed it.
pub struct Block {
    /// The log entry.
    pub entry: Entry,
    /// The outcome.
    pub outcome: Outcome,
}

/// The cluster.
pub struct World {
    /// The circumstances.
    pub plan: Plan,
    /// Virtual time, microseconds.
    pub now: u64,
    /// Everybody.
    pub people: Arc<People>,
    /// All nodes that ever were.
    pub nodes: BTreeMap<u64, Node>,
    /// The clients' calls and answers.
    pub history: History,
    /// The promises.
    pub invariants: Invariants,
    /// The deeds.
    pub coverage: Coverage,
    /// The events.
    pub trace: Trace,
    /// The chain, as executed first.
    pub blocks: Vec<Block>,
    /// The members after the block of each height; the first are those of the genesis.
    pub members: Vec<Membership>,
    /// Were certificates of the next block strict, as of each block?
    pub(crate) strict: Vec<bool>,
    /// Name of the network.
    pub network: Hash,
    pub(crate) genesis: Bytes,
    /// The robot that is looked at, if there is one.
    pub(crate) robot: Option<Box<Robot>>,
    pub(crate) clients: Vec<Client>,
    /// The newest tasks that clients have heard of and that may not have ended.
    pub(crate) tasks: BTreeMap<u64, Heard>,
    /// The sets and proposals of policies, as admins read them.
    pub(crate) book: Book,
    /// Every message that was sealed.
    pub(crate) sealed: Sealed,
    /// Every revocation list that a CA has signed.
    pub(crate) lists: Lists,
    pub(crate) links: Links,
    pub(crate) random: Randoms,
    /// Faults still happen.
    pub(crate) chaos: bool,
    pub(crate) replacement: Option<Replacement>,
    /// The voters and followers, as the operator wants them.
    pub desired: Desired,
    /// The nodes as they stand on the ledger, by the newest block that any node has executed.
    pub records: Vec<NodeRecord>,
    /// The client that does what the operator wants, and how many did before.
    pub(crate) operating: (Option<usize>, usize),
    /// The height from which on the organisations want newer rules, once they have thought of one.
    pub(crate) activation: Option<u64>,
    pub(crate) access: Option<Arc<dyn Chaincode>>,
    /// A member forges a copy of the next transaction that it hears of.
    pub(crate) forges_next: bool,
    /// A node that lies about what executing gave, if one does.
    pub(crate) liar: Option<u64>,
    /// The votes of the newest election.
    pub(crate) old_votes: Vec<SignedVote>,
    queue: BTreeMap<(u64, u64), Event>,
    sequence: u64,
    /// The node whose clock is hours ahead, and by how much.
    pub(crate) hours_ahead: Option<(u64, i64)>,
    /// Names faults that end.
    pub(crate) faults: u64,
    /// Counts calls that nobody waits for.
    pub(crate) floods: u64,
    /// When the last flood began.
    pub(crate) flooded: u64,
}

enum Awake {
    Yes,
    At(u64),
    No,
}

impl World {
    /// A network that is about to start.
    pub fn new(seed: u64, people: &Arc<People>, keep_text: bool) -> Self {
        let plan = Plan::new(seed);
        let (genesis, network) = found(&plan, people, seed);
        let sequence = |purpose| Random::new(seed, purpose);
        let mut random = Randoms {
            network: sequence("network"),
            disk: sequence("disk"),
            faults: sequence("faults"),
            clients: sequence("clients"),
            nodes: sequence("nodes"),
            statements: sequence("statements"),
            robot: sequence("robot"),
            contests: sequence("contests"),
            governance: sequence("governance"),
            confidential: sequence("confidential"),
        };
        let (voters, all) = (plan.voters, plan.voters + plan.learners);
        let statements = &mut random.statements;
        let liar = statements.percent(50).then(|| 1 + statements.below(all));
        let mut coverage = Coverage { seeds: 1, ..Coverage::default() };
        let mut nodes = BTreeMap::new();
        for id in 1..=all {
            let drifts = plan.faults.contains(&Fault::ClockDrift);
            if drifts {
                coverage.fault(Fault::ClockDrift);
            }
            let clock = clock(&mut random.faults, drifts);
            let mut node = Node::new(id, random.disk.number(), clock);
            if plan.faults.contains(&Fault::Pruning) {
                node.keep = Some(random.faults.between(5, 60));
            }
            if plan.activates && !random.nodes.percent(60) {
                node.speaks = Rules::OF_TESTS;
            }
            nodes.insert(id, node);
        }
        let hand = |id| (id, organisation_of(id, plan.organisations));
        let mut world = Self {
            now: 0,
            people: Arc::clone(people),
            nodes,
            history: History::default(),
            invariants: Invariants::new(people),
            coverage,
            trace: Trace::new(keep_text),
            blocks: Vec::new(),
            members: vec![Membership::new(1..=voters, voters + 1..=all)],
            strict: vec![spare_one(&(1..=voters).collect(), &(1..=voters).map(hand).collect())],
            network,
            genesis,
            clients: Vec::new(),
            tasks: BTreeMap::new(),
            book: Book::default(),
            sealed: Sealed::default(),
            lists: Lists::default(),
            links: Links::new(plan.network.clone()),
            random,
            chaos: true,
            replacement: None,
            records: Vec::new(),
            operating: (None, 0),
            desired: Desired {
                voters: (1..=voters).collect(),
                learners: (voters + 1..=all).collect(),
                ..Desired::default()
            },
            activation: None,
            access: None,
            forges_next: false,
            liar,
            old_votes: Vec::new(),
            robot: None,
            queue: BTreeMap::new(),
            sequence: 0,
            hours_ahead: None,
            faults: 0,
            floods: 0,
            flooded: 0,
            plan,
        };
        let plan = format!("{:?}", world.plan);
        world.note(format_args!("seed {seed} {plan}"));
        for id in 1..=all {
            let delay = world.random.nodes.below(200 * MILLISECOND);
            world.schedule(delay, Event::Start { node: id });
        }
        world.employ();
        world.build_robot(seed);
        world.schedule(300 * MILLISECOND, Event::Operator);
        if !world.plan.faults.is_empty() {
            let first = SECOND + world.random.faults.around(world.plan.between_faults);
            world.schedule(first, Event::Fault);
        }
        world
    }

    /// Handles everything up to a moment.
    ///
    /// # Errors
    /// The first promise that is broken.
    pub fn run_until(&mut self, until: u64) -> Check {
        while let Some(next) = self.queue.first_entry() {
            if next.key().0 > until {
                break;
            }
            let ((at, _), event) = next.remove_entry();
            self.now = at;
            if self.sequence > EVENTS_MAX {
                return Err(Violation::new("progress", format!("{EVENTS_MAX} events and no end")));
            }
            self.handle(event)?;
        }
        self.now = until;
        self.coverage.time = until;
        Ok(())
    }

    fn handle(&mut self, event: Event) -> Check {
        // What is meant for a process that stands still waits until it goes on.
        let addressee = match &event {
            Event::Node { node, .. } | Event::Request { node, .. } => Some(*node),
            Event::Deliver { to, .. } | Event::Statement { to, .. } => Some(*to),
            _ => None,
        };
        match addressee.map_or(Awake::Yes, |id| self.awake(id)) {
            Awake::Yes => {}
            Awake::At(later) => {
                self.schedule_at(later, event);
                return Ok(());
            }
            Awake::No => return Ok(()),
        }
        match event {
            Event::Node { node, start, timer } if self.start_of(node) == start => return self.timer(node, timer),
            Event::Node { .. } => {}
            Event::Deliver { from, to, bytes } => return self.deliver(from, to, bytes),
            Event::Statement { from, to, signed } => return self.hear(from, to, &signed),
            Event::Request { node, request } => return self.request(node, request),
            Event::Start { node } => return self.start(node),
            Event::Answer { reply, clock, answer } => return self.answered(reply, clock, answer),
            Event::Client { client, attempt } => self.work(client, attempt),
            Event::Fault => return self.misfortune(),
            Event::Operator => return self.operate(),
            Event::Undo(undo) => self.undo(undo),
            Event::Robot(happening) => return self.robot_event(happening),
        }
        Ok(())
    }

    fn awake(&self, id: u64) -> Awake {
        match self.nodes.get(&id) {
            Some(node) if node.up.is_some() && node.paused_until > self.now => Awake::At(node.paused_until),
            Some(node) if node.up.is_some() => Awake::Yes,
            _ => Awake::No,
        }
    }

    fn start_of(&self, id: u64) -> u64 {
        self.nodes.get(&id).map_or(0, |node| node.start)
    }

    /// Schedules an event after a delay.
    pub(crate) fn schedule(&mut self, delay: u64, event: Event) {
        self.schedule_at(self.now + delay, event);
    }

    /// Schedules an event at a time.
    pub(crate) fn schedule_at(&mut self, at: u64, event: Event) {
        self.sequence += 1;
        self.queue.insert((at, self.sequence), event);
    }

    /// Schedules what a process does later, unless it ends before.
    pub(crate) fn schedule_timer(&mut self, node: u64, delay: u64, timer: Timer) {
        let start = self.start_of(node);
        self.schedule(delay, Event::Node { node, start, timer });
    }

    /// Adds a line to the trace.
    pub(crate) fn note(&mut self, what: std::fmt::Arguments<'_>) {
        self.trace.note(self.now, what);
    }

    /// The node that leads and may order, if there is one; of two, the one of the higher term.
    pub fn leader(&self) -> Option<u64> {
        let leading = self.nodes.values().filter_map(|node| {
            let replica = node.up.as_ref()?.replica.as_ref()?;
            let status = replica.leads().then(|| replica.status())?;
            status.may_propose.then_some((status.role.term, node.id))
        });
        leading.max().map(|(_, id)| id)
    }

    /// The members as of the newest block that any node has executed.
    pub fn newest_members(&self) -> &Membership {
        &self.members[self.members.len() - 1]
    }

    /// Nodes that run or could run.
    pub(crate) fn usable(&self) -> Vec<u64> {
        self.nodes.values().filter(|node| !node.lost).map(|node| node.id).collect()
    }
}

/// A machine's clock: about right, or wrong and running wrong.
pub(crate) fn clock(random: &mut Random, drifts: bool) -> Clock {
    let about = |random: &mut Random, most: u64| random.below(2 * most + 1) as i64 - most as i64;
    if drifts {
        let offset = about(random, 200 * MILLISECOND);
        return Clock::new(offset, about(random, 200));
    }
    Clock::new(about(random, MILLISECOND), 0)
}

/// Where a node would be reached.
pub(crate) fn address(id: u64) -> String {
    format!("127.0.0.1:{}", 7000 + id)
}

/// The genesis: nodes in turn of the organisations.
fn found(plan: &Plan, people: &People, seed: u64) -> (Bytes, Hash) {
    let nodes = (1..=plan.voters + plan.learners).map(|id| FoundingNode {
        id,
        name: format!("node{id}"),
        organisation: organisation_of(id, plan.organisations),
        address: address(id),
        voter: id <= plan.voters,
    });
    let genesis = Genesis {
        rules: Rules::NEWEST.number(),
        label: "simulated".into(),
        created: EPOCH - SECOND,
        salt: Hash::of(&[&seed.to_be_bytes()]),
        organisations: people.organisations.clone(),
        nodes: nodes.collect(),
        snapshot_every: plan.snapshot_every,
    };
    let genesis = genesis.to_bytes().unwrap();
    let (_, network) = Genesis::from_bytes(&genesis).unwrap();
    (genesis, network)
}
