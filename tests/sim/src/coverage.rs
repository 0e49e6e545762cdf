//! The damage that was really done to the cluster, counted where it is done: a fault that was only planned tests
//! nothing.

mod confidential;
mod governance;

use crate::client::READERS;
use crate::world::Untruth;
use confidential::CONFIDENTIAL;
use governance::GOVERNANCE;
use ledger::Outcome;
use ledger_base::rejection::Code;
use ledger_storage::result::Event;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt;

macro_rules! faults {
    ($($(#[$doc:meta])* $variant:ident $name:literal;)*) => {
        /// A kind of fault.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault { $($(#[$doc])* $variant,)* }

        impl Fault {
            /// Every kind.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The name in reports.
            pub const fn name(self) -> &'static str { match self { $(Self::$variant => $name,)* } }
        }
    };
}

faults! {
    /// A message between nodes is lost.
    Loss "message lost";
    /// It comes twice.
    Duplication "message duplicated";
    /// It overtakes one that was sent before.
    Reordering "message overtook another";
    /// It takes much longer than the others.
    Delay "message delayed";
    /// A link holds everything back for a while, then lets it all through.
    Clog "link clogged";
    /// Two groups of nodes do not hear each other.
    Partition "partition";
    /// One group does not hear the other, which hears it.
    OneWay "one-way partition";
    /// A node loses power; unsynced writes are lost.
    Crash "crash";
    /// … in the middle of a write, of which some sectors survive.
    TornWrite "crash that tears a write";
    /// The process dies, the machine goes on.
    Kill "process killed";
    /// A flush takes very long.
    SlowDisk "slow flush";
    /// An fsync fails.
    FailedSync "failed fsync";
    /// A write of the log fails, or stores only its beginning.
    FailedWrite "failed write";
    /// A bit of a durable record flips.
    BitFlip "bit flipped";
    /// The disk is full for a while.
    FullDisk "disk full";
    /// The world state is lost, and rebuilt from the blocks.
    StateLost "world state lost";
    /// Somebody sets a machine's clock.
    ClockStep "clock step";
    /// Somebody sets a machine's clock hours ahead, and right again after a while.
    ClockHours "clock hours ahead";
    /// A machine's clock runs wrong.
    ClockDrift "clock drift";
    /// A process stands still while the others go on.
    Pause "pause";
    /// A client dies and forgets what it was doing.
    ClientCrash "client crash";
    /// The leadership is handed over on demand.
    Transfer "leadership transfer";
    /// A voter becomes a learner, or a learner a voter.
    MembershipChange "change of members";
    /// A node whose disk is lost is taken out, and a new one takes its place.
    Replacement "node replaced";
    /// Old blocks are dropped.
    Pruning "old blocks dropped";
    /// A node fetches blocks from its peers.
    CatchUp "caught up from peers";
    /// Nobody has the blocks any more that a node needs: it takes a snapshot.
    Snapshot "snapshot taken";
    /// A node gives another blocks that nobody has ordered.
    ForgedBlocks "forged block offered";
    /// Newer rules of execution come into force.
    Activation "newer rules activated";
    /// A node does not speak the rules of the next block, and stops.
    Outdated "stopped before newer rules";
    /// A member orders what no honest gateway would let through.
    Hostile "hostile transaction";
    /// A learner says what only a leader or a voter may say.
    Lie "lie of a learner";
    /// A voter says that it was elected, although it was not, and tells each member of another block.
    Pose "voter posed as leader";
    /// A client sends much at once, over many streams, and waits for nothing.
    Flood "flood of calls";
}

/// The events that must happen where several want a service, and to robots in an emergency.
const CONTESTS: [&str; 26] = [
    "queued",
    "turn came",
    "limited turn came",
    "limited",
    "preempted",
    "left the line",
    "sent away from the line",
    "taken",
    "stopped",
    "resumed",
    "task scheduled",
    "task waits",
    "task runs",
    "task's turn came",
    "task goes on",
    "task done",
    "task failed",
    "task cancelled",
    "task preempted",
    "task waits again",
    "task expired",
    "place taken",
    "place queued",
    "place's turn came",
    "place preempted",
    "place full",
];

/// Seeds from which on every kind of fault must have happened. A rare one happens in about one of twenty.
pub const SEEDS_ENOUGH: u64 = 40;

/// Counts of one run, or of many.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    /// How often each fault was injected.
    pub faults: BTreeMap<Fault, u64>,
    /// Transactions on the chain, by verdict.
    pub verdicts: BTreeMap<Code, u64>,
    /// Transactions refused at a gateway, by reason.
    pub refusals: BTreeMap<Code, u64>,
    /// Runs.
    pub seeds: u64,
    /// Virtual time, microseconds.
    pub time: u64,
    /// Blocks of the longest chain of each run.
    pub blocks: u64,
    /// Leaders elected.
    pub elections: u64,
    /// Starts of nodes after the first.
    pub restarts: u64,
    /// Operations that clients began, and of which they know the outcome.
    pub operations: u64,
    /// See `operations`.
    pub answered: u64,
    /// Attempts that nobody answered in time.
    pub timeouts: u64,
    /// Reads that had to be linearizable and were answered.
    pub linearizable: u64,
    /// Groups of blocks that the order thread executed itself.
    pub in_place: u64,
    /// Attestations that nodes submitted.
    pub attestations: u64,
    /// Certificates that nodes made.
    pub certificates: u64,
    /// Statements of liars.
    pub lies: u64,
    /// Proofs of lies.
    pub lies_proved: u64,
    /// Proofs of faults.
    pub faults_proved: u64,
    /// Engines that could not write what they had when they ended, for lack of space.
    pub full_at_end: u64,
    /// Messages at a robot's gate: what passed, and why others did not.
    pub gate: BTreeMap<&'static str, u64>,
    /// Stops of robots, by reason.
    pub stops: BTreeMap<&'static str, u64>,
    /// Lies to a robot.
    pub untruths: BTreeMap<Untruth, u64>,
    /// The events where several wanted a service, or of robots in an emergency.
    pub contests: BTreeMap<&'static str, u64>,
    /// The answers to admins about sets of policies and revocation lists.
    pub governance: BTreeMap<&'static str, u64>,
    /// The answers to those around the confidential service, and who read what.
    pub confidential: BTreeMap<&'static str, u64>,
    /// Questions of robots, answers that were believed, and why others were not.
    pub questions: u64,
    /// See `questions`.
    pub believed: u64,
    /// See `questions`.
    pub unbelieved: BTreeMap<Code, u64>,
    /// Bridges of robots that started anew.
    pub reopened: u64,
    /// Stops that came to the robot before they were ordered.
    pub early_stops: u64,
    /// Stops that their gateway lost after it had notified the robot.
    pub lost_stops: u64,
    /// Facts checked by the oracle.
    pub checks: u64,
}

impl Coverage {
    /// Counts a fault.
    pub fn fault(&mut self, fault: Fault) {
        *self.faults.entry(fault).or_default() += 1;
    }

    /// Counts something that happened where several want a service.
    pub fn contest(&mut self, what: &'static str) {
        *self.contests.entry(what).or_default() += 1;
    }

    /// Counts what the events of a block tell of contests and emergencies.
    pub fn follow(&mut self, outcome: &Outcome) {
        for emitted in &outcome.events {
            let event = &emitted.event;
            let says = |text: &str| std::str::from_utf8(&event.payload).is_ok_and(|payload| payload.contains(text));
            let limited = || says(r#""mode":"limited""#);
            if let Some(what) = of_a_task(event).or_else(|| of_a_place(event, emitted.index.is_none())) {
                self.contest(what);
                continue;
            }
            let what = match (&*event.chaincode, &*event.name) {
                ("abac", "queued") => "queued",
                ("abac", "granted") if emitted.index.is_none() && limited() => "limited turn came",
                ("abac", "granted") if emitted.index.is_none() => "turn came",
                ("abac", "granted") if says(r#""taken":""#) => "taken",
                ("abac", "granted") if limited() => "limited",
                ("abac", "released") if says(r#""reason":"preempted""#) => "preempted",
                ("abac", "left") if says(r#""reason":"left""#) => "left the line",
                ("abac", "left") => "sent away from the line",
                ("abac", "stopped") => "stopped",
                ("abac", "resumed") => "resumed",
                ("abac", "policy_approvals") => {
                    *self.governance.entry("rule of the network in force").or_default() += 1;
                    continue;
                }
                _ => continue,
            };
            self.contest(what);
        }
    }

    /// Adds what another run covered.
    pub fn add(&mut self, other: &Self) {
        for (fault, count) in &other.faults {
            *self.faults.entry(*fault).or_default() += count;
        }
        for (code, count) in &other.verdicts {
            *self.verdicts.entry(*code).or_default() += count;
        }
        for (code, count) in &other.refusals {
            *self.refusals.entry(*code).or_default() += count;
        }
        for (what, count) in &other.gate {
            *self.gate.entry(what).or_default() += count;
        }
        for (why, count) in &other.stops {
            *self.stops.entry(why).or_default() += count;
        }
        for (kind, count) in &other.untruths {
            *self.untruths.entry(*kind).or_default() += count;
        }
        for (what, count) in &other.contests {
            *self.contests.entry(what).or_default() += count;
        }
        for (what, count) in &other.governance {
            *self.governance.entry(what).or_default() += count;
        }
        for (what, count) in &other.confidential {
            *self.confidential.entry(what).or_default() += count;
        }
        for (code, count) in &other.unbelieved {
            *self.unbelieved.entry(*code).or_default() += count;
        }
        self.questions += other.questions;
        self.believed += other.believed;
        self.reopened += other.reopened;
        self.early_stops += other.early_stops;
        self.lost_stops += other.lost_stops;
        self.seeds += other.seeds;
        self.time += other.time;
        self.blocks += other.blocks;
        self.elections += other.elections;
        self.restarts += other.restarts;
        self.operations += other.operations;
        self.answered += other.answered;
        self.timeouts += other.timeouts;
        self.linearizable += other.linearizable;
        self.in_place += other.in_place;
        self.attestations += other.attestations;
        self.certificates += other.certificates;
        self.lies += other.lies;
        self.lies_proved += other.lies_proved;
        self.faults_proved += other.faults_proved;
        self.full_at_end += other.full_at_end;
        self.checks += other.checks;
    }

    /// The kinds of faults that never happened.
    pub fn missing(&self) -> Vec<String> {
        let never = Fault::ALL.iter().filter(|fault| !self.faults.contains_key(fault));
        let untold = Untruth::ALL.iter().filter(|kind| !self.untruths.contains_key(kind));
        let idle = ["passed"].into_iter().filter(|what| !self.gate.contains_key(what));
        let idle = idle.map(|what| format!("a message at a robot {what}"));
        let contests = CONTESTS.into_iter().filter(|what| !self.contests.contains_key(what)).map(str::to_owned);
        let refused = |code: &Code| self.verdicts.contains_key(code) || self.refusals.contains_key(code);
        let refusals = [Code::LineFull, Code::Stopped].into_iter().filter(|code| !refused(code));
        let refusals = refusals.map(|code| format!("refused with {}", code.name()));
        let never = never.map(|fault| fault.name().to_owned()).chain(untold.map(Untruth::to_string));
        let ungoverned = GOVERNANCE.into_iter().filter(|what| !self.governance.contains_key(what)).map(str::to_owned);
        let open = CONFIDENTIAL.into_iter().filter(|what| !self.confidential.contains_key(what)).map(str::to_owned);
        never.chain(idle).chain(contests).chain(ungoverned).chain(open).chain(refusals).collect()
    }

    /// Was so much done that every kind of fault should have happened?
    pub fn is_enough(&self) -> bool {
        self.seeds >= SEEDS_ENOUGH
    }
}

/// The fields that are read of what is told of tasks and grants.
#[derive(Deserialize)]
struct Told {
    state: Option<String>,
    #[serde(default)]
    reason: String,
    reached: Option<u64>,
    task: Option<u64>,
}

/// The name for what an event tells of a task.
fn of_a_task(event: &Event) -> Option<&'static str> {
    if event.chaincode != "abac" || event.name != "task" {
        return None;
    }
    let Told { state, reason, reached, .. } = serde_json::from_slice(&event.payload).ok()?;
    Some(match &*state? {
        "scheduled" => "task scheduled",
        "waiting" if !reason.is_empty() => "task waits again",
        "waiting" => "task waits",
        "running" if reached? > 0 => "task goes on",
        "running" => "task runs",
        "done" => "task done",
        "failed" => "task failed",
        "cancelled" => "task cancelled",
        "preempted" => "task preempted",
        _ => "task expired",
    })
}

/// The name for what an event tells of a place of a reader, or of the grant of a task.
fn of_a_place(event: &Event, is_turn: bool) -> Option<&'static str> {
    let told = || serde_json::from_slice::<Told>(&event.payload).ok();
    if event.chaincode != "abac" {
        return None;
    }
    match &*event.name {
        "granted" if is_turn && told()?.task.is_some() => Some("task's turn came"),
        _ if !event.subject.ends_with(READERS) => None,
        "granted" if is_turn => Some("place's turn came"),
        "granted" => Some("place taken"),
        "queued" => Some("place queued"),
        "released" if told()?.reason == "preempted" => Some("place preempted"),
        _ => None,
    }
}

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, blocks) = (self.time / 1_000_000, self.blocks);
        writeln!(f, "seeds             {}", self.seeds)?;
        writeln!(f, "virtual time      {}.{:02} hours", seconds / 3600, seconds % 3600 * 100 / 3600)?;
        writeln!(f, "blocks            {blocks}")?;
        writeln!(f, "elections         {}", self.elections)?;
        writeln!(f, "restarts          {}", self.restarts)?;
        writeln!(
            f,
            "operations        {} begun, {} answered, {} attempts timed out",
            self.operations, self.answered, self.timeouts
        )?;
        writeln!(f, "linearizable      {} reads", self.linearizable)?;
        writeln!(f, "in place          {} times", self.in_place)?;
        writeln!(f, "attestations      {}", self.attestations)?;
        writeln!(f, "certificates      {}", self.certificates)?;
        let (proved, faults) = (self.lies_proved, self.faults_proved);
        writeln!(f, "lies              {} told, {proved} proved, and {faults} faults", self.lies)?;
        writeln!(
            f,
            "robots            {} questions, {} answers believed, {} starts anew",
            self.questions, self.believed, self.reopened
        )?;
        writeln!(f, "early stops       {}, {} lost by their gateway", self.early_stops, self.lost_stops)?;
        writeln!(f, "full at the end   {} engines", self.full_at_end)?;
        writeln!(f, "facts checked     {}", self.checks)?;
        writeln!(f, "faults injected")?;
        for fault in Fault::ALL {
            writeln!(f, "  {:<26} {:>9}", fault.name(), self.faults.get(fault).unwrap_or(&0))?;
        }
        for (kind, count) in &self.untruths {
            writeln!(f, "  {:<40} {count:>9}", kind.to_string())?;
        }
        writeln!(f, "contests and emergencies")?;
        for (what, count) in &self.contests {
            writeln!(f, "  {what:<26} {count:>9}")?;
        }
        writeln!(f, "policies and revocation lists")?;
        for (what, count) in &self.governance {
            writeln!(f, "  {what:<40} {count:>9}")?;
        }
        writeln!(f, "the confidential service")?;
        for (what, count) in &self.confidential {
            writeln!(f, "  {what:<40} {count:>9}")?;
        }
        writeln!(f, "answers that a robot did not believe")?;
        for (code, count) in &self.unbelieved {
            writeln!(f, "  {:<26} {count:>9}", code.name())?;
        }
        writeln!(f, "messages at a robot's gate, and its stops")?;
        for (what, count) in self.gate.iter().chain(&self.stops) {
            writeln!(f, "  {what:<26} {count:>9}")?;
        }
        writeln!(f, "verdicts on the chain")?;
        for (code, count) in &self.verdicts {
            writeln!(f, "  {:<26} {count:>9}", code.name())?;
        }
        writeln!(f, "refused before ordering")?;
        for (code, count) in &self.refusals {
            writeln!(f, "  {:<26} {count:>9}", code.name())?;
        }
        Ok(())
    }
}
