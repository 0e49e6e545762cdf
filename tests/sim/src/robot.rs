//! A robot of the network: the real guard of each of its services, and what it knows of its node and of the voters.

use crate::client::BRIDGE;
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::confidential;
use bytes::Bytes;
use ledger::CallRef;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_confidential::Keyring;
use ledger_gate::gate::{Now, Settings};
use ledger_gate::guard::Guard;
use ledger_gate::standing::{Members, Standing};
use ledger_light::{Change, Governance, Proof};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Its certificate.
pub(crate) const IDENTITY: &str = "Org2/Rover";
/// For how long an answer of the voters counts, microseconds.
pub(crate) const STALE_AFTER: u64 = SECOND;
/// The robots, with their services.
pub(crate) const ROBOTS: [(&str, &[&str]); 2] =
    [("Turtlebot4", &["Turtlebot4/cmd_vel"]), ("Husky", &["Husky/cmd_vel", "Husky/arm"])];
/// The robot with the confidential service, which is looked at where there is one.
pub(crate) const CONFIDENTIAL: (&str, &[&str]) = (confidential::ROBOT, &[confidential::SERVICE]);
/// Largest message.
const SAMPLE_BYTES_MAX: usize = 1024;

/// A robot, and the bridge on it.
pub struct Robot {
    /// Its name on the ledger.
    pub name: &'static str,
    /// Its services.
    pub watched: Vec<Watched>,
    /// The client as which it submits its questions.
    pub client: usize,
    /// The node that lies to it, if one does.
    pub liar: Option<u64>,
    /// How much its wall clock is ahead, or behind.
    pub offset: i64,
    /// How often its bridge was started.
    pub openings: u64,
    /// By how much the nodes' time is ahead of virtual time, as they said last.
    pub ahead: u64,
    /// The stream from its node.
    pub stream: Option<Stream>,
    /// Counts streams.
    pub streams: u64,
    /// The next height that it wants.
    pub next: u64,
    /// The governance that it believes, from the genesis on.
    pub governance: Governance,
    /// The members by it.
    pub members: Members,
    /// The question under way.
    pub question: Option<Question>,
    /// Too few of the voters that it knows have signed the way to those of today, at the node that it asked last.
    pub lost: bool,
    /// Counts questions.
    pub questions: u64,
    /// Services that wait for an answer to a question that was asked at that time or later.
    pub waiting: Vec<(usize, u64)>,
    /// The newest answer, when it was asked for, and for which stops.
    pub answered: Option<(u64, BTreeSet<CallRef>, Standing)>,
    /// When it looks after itself next.
    pub wakes_at: u64,
    /// The transactions that its node has told of, by the message in them.
    pub told: BTreeMap<Bytes, Transaction>,
    /// Services, and publishers of which messages have passed since everything was healed.
    pub passed: BTreeSet<(String, String)>,
    /// Earlier answers that the liar remembers: response and proof.
    pub old: Vec<(Bytes, Proof)>,
    /// Deliveries that the liar holds back.
    pub held_back: Vec<Delivery>,
    /// The heights of the first and the last block of whose hashes it was told since its start, without a gap.
    pub heads: Option<(u64, u64)>,
    /// Since when nothing goes wrong any more.
    pub calm_since: Option<u64>,
}

/// A service of the robot.
pub struct Watched {
    /// `Husky/arm`.
    pub id: &'static str,
    /// Decides.
    pub guard: Guard,
}

/// A stream of events from a node.
#[derive(Clone, Debug)]
pub struct Stream {
    /// Its number.
    pub number: u64,
    /// The node.
    pub node: u64,
    /// Which start of it.
    pub start: u64,
    /// The next height that the node looks at.
    pub next: u64,
    /// The height up to which it has told the hashes of blocks.
    pub heads: u64,
    /// Creators whose certificate it has shown, by the subject of the events.
    pub shown: BTreeSet<(String, Hash)>,
    /// When it was opened.
    pub opened: u64,
    /// When the last delivery was sent, and when it arrives.
    pub sent: u64,
    /// See `sent`.
    pub arrives: u64,
    /// When the robot last heard of the node.
    pub heard: u64,
    /// Nothing is sent before this time.
    pub silent_until: u64,
}

/// The events of a block, as a node delivers them.
#[derive(Clone, Debug)]
pub struct Delivery {
    /// Height.
    pub height: u64,
    /// Block time.
    pub time: u64,
    /// The events.
    pub events: Vec<Told>,
    /// Did they not happen yet?
    pub early: bool,
    /// The first bytes of the hashes of the blocks since the last delivery.
    pub heads: Vec<u8>,
}

/// An event as a node tells it.
#[derive(Clone, Debug)]
pub struct Told {
    /// Position of the transaction.
    pub index: u32,
    /// The chaincode.
    pub chaincode: String,
    /// The event's name.
    pub name: String,
    /// Its subject.
    pub subject: String,
    /// Its JSON.
    pub payload: Bytes,
    /// The transaction; empty if an event before has carried it.
    pub transaction: Bytes,
    /// The certificate of its creator, if it is shown.
    pub certificate: Bytes,
}

/// A question under way.
#[derive(Clone, Debug)]
pub struct Question {
    /// Its number.
    pub number: u64,
    /// The node that is asked.
    pub node: u64,
    /// When it was asked.
    pub asked: u64,
    /// Its transaction.
    pub id: Hash,
    /// The stops whose verdicts it asks for.
    pub stops: BTreeSet<CallRef>,
    /// The answer of the function, when there is one.
    pub response: Option<Bytes>,
}

/// A step of the way that a node shows: a change, or the proof of the block of one.
#[derive(Clone, Debug)]
pub enum Step {
    /// Height and writes.
    Change(Change),
    /// The proof.
    Proof(Proof),
}

impl Robot {
    /// The robot's bridge before its first start.
    pub fn new(
        (name, services): (&'static str, &'static [&'static str]),
        client: usize,
        offset: i64,
        governance: Governance,
    ) -> Self {
        let members = Members::of(&governance).unwrap();
        let mut robot = Self {
            name,
            watched: Vec::new(),
            client,
            liar: None,
            offset,
            openings: 0,
            ahead: EPOCH,
            stream: None,
            streams: 0,
            next: 0,
            governance: governance.clone(),
            members,
            question: None,
            lost: false,
            questions: 0,
            waiting: Vec::new(),
            answered: None,
            wakes_at: u64::MAX,
            told: BTreeMap::new(),
            passed: BTreeSet::new(),
            old: Vec::new(),
            held_back: Vec::new(),
            heads: None,
            calm_since: None,
        };
        robot.open(services, &governance, 0);
        robot
    }

    /// The bridge starts, and begins with the genesis.
    pub fn open(&mut self, services: &[&'static str], founded: &Governance, now: u64) {
        let settings = Settings {
            network: founded.network(),
            sample_bytes_max: SAMPLE_BYTES_MAX,
            max_age: None,
            stale_after: Duration::from_micros(STALE_AFTER),
            command_timeout: None,
        };
        let now = self.clocks(now);
        let watch = |id: &&'static str| {
            let mut guard = Guard::new(settings.clone(), id, now);
            guard.read_with(Keyring::new(founded.network(), BRIDGE.to_owned(), confidential::pair(BRIDGE, 0)));
            Watched { id, guard }
        };
        self.watched = services.iter().map(watch).collect();
        self.openings += 1;
        self.governance = founded.clone();
        self.members = Members::of(founded).unwrap();
        (self.stream, self.question, self.answered) = (None, None, None);
        (self.next, self.waiting) = (0, Vec::new());
        self.heads = None;
    }

    /// Its clocks.
    pub fn clocks(&self, now: u64) -> Now {
        Now { wall: (EPOCH + now).saturating_add_signed(self.offset), steady: now }
    }

    /// When it must look after itself at the latest: a stop, a question, or a node that is silent or gone.
    pub fn due(&self, now: u64) -> u64 {
        let guards = self.watched.iter().flat_map(|Watched { guard, .. }| {
            [guard.stop_at().map(|(due, _)| due), guard.asks_at()].into_iter().flatten()
        });
        let silent = self.stream.as_ref().map(|stream| stream.heard + QUIET_MAX);
        let late = self.question.as_ref().map(|question| question.asked + ANSWER_MAX);
        let unconnected = self.stream.is_none().then_some(now + 100 * MILLISECOND);
        guards.chain(silent).chain(late).chain(unconnected).min().unwrap_or(u64::MAX)
    }
}

/// Silence of a node after which its robot asks another, microseconds.
pub(crate) const QUIET_MAX: u64 = 750 * MILLISECOND;
/// How long an answer may take, microseconds.
pub(crate) const ANSWER_MAX: u64 = 5 * SECOND;
