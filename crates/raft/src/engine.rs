//! The pump around the `raft` crate: inputs in, outputs out, nothing else.

mod acknowledged;
mod ahead;
mod behind;
mod chain;
mod complaints;
mod config;
mod doubt;
mod guard;
mod handover;
mod heads;
mod logger;
mod mandate;
mod promises;
mod pump;
mod receipt;
mod request;
mod standing;
mod status;
mod submit;
mod time;

pub use chain::{ExecutedBlocks, Link};
pub use config::{EngineConfig, EngineError};
pub use doubt::ClockDoubt;
pub use mandate::{Ballot, Ballots, Grievance, Handover, LogHead};
pub use receipt::{Receipt, ReceiptKey, Secret};
pub use status::{Deposition, PeerStatus, Replication, Status};
pub use time::TIME_AHEAD_MAX;

use crate::interface::{Input, Output, Role, RoleChange};
use crate::log::Log;
use crate::message::{PEER_MESSAGE_BYTES_MAX, PeerMessage, RaftKind};
use crate::queue::Queues;
use acknowledged::Acknowledged;
use ahead::Ahead;
use bytes::Bytes;
use chain::Chain;
use complaints::Complaints;
use heads::Heads;
use ledger::block::Payload;
use ledger::members::Membership;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::{BlockStore, STAGED_BYTES_MAX};
use ledger_storage::entry::EntryKind;
use mandate::Mandates;
use promises::Promised;
use raft::{RawNode, StateRole};
use receipt::Receipts;
use standing::Doubt;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use submit::no_leader;
use time::Times;

/// The number of entries, committed but not executed, beyond which a node does not stand for election. It could not
/// order before it has caught up, and counting changes of members among them would cost it the election timeout.
const CAMPAIGN_LAG_MAX: u64 = 10_000;
/// Entries looked at, from the end of the log, for the newest block time. Blocks without a time are the empty ones that
/// open a term. More of them in a row than this loses only the guarantee that a new leader's *proposed* time is not
/// older. The executor makes good for that.
const TIME_SCAN_ENTRIES_MAX: u64 = 64;
/// Bytes of entries that wait for the own disk beyond which a follower takes no more; the leader sends them again.
/// With the longest message on top it stays below what the block store stages.
const UNPERSISTED_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Bytes read from the store at once.
const READ_BYTES: usize = 4 * 1024 * 1024;

const _: () = assert!(UNPERSISTED_BYTES_MAX + PEER_MESSAGE_BYTES_MAX < STAGED_BYTES_MAX);

/// A ready of the `raft` crate whose consequences wait for the disk.
struct PendingReady {
    number: u64,
    needs_flush: bool,
    /// Of its entries.
    bytes: usize,
    messages: Vec<raft::eraftpb::Message>,
}

/// A block this leader proposed, until it is committed and persisted.
struct OwnBlock {
    index: u64,
    bytes: usize,
}

/// The orderer of one node. See the crate's documentation for the duties of its driver.
pub struct Engine {
    config: EngineConfig,
    raw: RawNode<Log>,
    store: Arc<BlockStore>,
    /// Transactions that wait to be ordered, or to be forwarded to the leader.
    queues: Queues,
    /// In order of number; the first always needs a flush.
    pending: VecDeque<PendingReady>,
    /// Bytes of entries in `pending`.
    unpersisted_bytes: usize,
    /// Appends that wait for the commit of what they bring, by learner.
    held: BTreeMap<u64, VecDeque<raft::eraftpb::Message>>,
    /// Own blocks under way, in order of index.
    own: VecDeque<OwnBlock>,
    /// Own blocks that are not executed.
    ahead: Ahead,
    /// Members as of `emitted`.
    membership: Membership,
    /// Last height handed out as committed.
    emitted: u64,
    /// Heights and bytes handed out and not yet applied.
    unapplied: VecDeque<(u64, usize)>,
    unapplied_bytes: usize,
    /// Last height that the driver has executed.
    applied: u64,
    /// A leader proposes once everything up to here is applied: the end of the log when it was elected.
    barrier: u64,
    /// Newest block time this leader knows; the next is not older.
    last_time: u64,
    /// Clocks, and block time that is ahead of them.
    times: Times,
    /// Why this node does not believe its clock.
    doubt: Option<ClockDoubt>,
    /// A deadline passed: order a block even if nothing waits.
    wants_empty: bool,
    /// The last reported role.
    told: RoleChange,
    /// The leader before the one that was reported last.
    leader_before: Option<u64>,
    /// Elections this node has started; varies its timeouts within a term.
    attempts: u64,
    /// Ticks since a leader was last known.
    leaderless_ticks: usize,
    /// Ticks until a transfer of leadership may be tried again without anybody asking for it.
    transfer_rest: usize,
    /// Ticks since the start.
    ticks: u64,
    /// When each member was last heard of, in ticks, as a leader counts: from its election or the member's coming in
    /// on. The crate's own mark (`recent_active`) is cleared with every check of the quorum.
    heard: BTreeMap<u64, u64>,
    /// When voters last ended a leader's term before its time, in ticks.
    ended_terms: BTreeMap<u64, u64>,
    /// A node of which this one does not know that it votes has spoken as a leader.
    stranger_leads: bool,
    /// A second leader of this term has shown that voters elected it: some have voted twice.
    second_leads: bool,
    /// The newest acknowledgement of this follower.
    acknowledged: Acknowledged,
    /// Receipts of the followers, and the means to make own ones.
    receipts: Receipts,
    /// The hashes of the log.
    chain: Chain,
    /// Signed votes, and who has shown them.
    mandates: Mandates,
    /// Signed heads of this leader, and of those that it follows.
    heads: Heads,
    /// Complaints about the leader, and leaders that were deposed.
    complaints: Complaints,
    /// The term in which a leader has handed over to this node last, and its signed word.
    handed_over: Option<(u64, Bytes)>,
    /// Reads taken in from others; makes their names unique, see `guard.rs`.
    reads: u64,
    /// Wall-clock time of this step, microseconds.
    now: u64,
    /// As of the last step.
    promised: Promised,
    /// Set once the store has failed.
    failed: bool,
}

impl Engine {
    /// Starts from what the store holds. Nothing is sent before the first [`Engine::step`]. `executed` has the blocks up to the
    /// state machine's height, `ballots` the key of this node.
    ///
    /// # Errors
    /// [`EngineError`] when the store, the state machine's height and the configuration do not fit together.
    pub fn new(
        config: EngineConfig,
        store: Arc<BlockStore>,
        executed: Arc<dyn ExecutedBlocks>,
        ballots: Arc<dyn Ballots>,
    ) -> Result<Self, EngineError> {
        let (applied, last, stored) = (config.applied, store.last_index(), store.hard_state());
        if applied > last {
            return Err(EngineError::StateAhead { applied, last });
        }
        if stored.commit > last {
            return Err(EngineError::LogLost { last, commit: stored.commit });
        }
        let first = store.first_index();
        if applied + 1 < first {
            return Err(EngineError::StateBehind { applied, first });
        }
        let membership = config.membership.clone();
        let log = Log::new(Arc::clone(&store), &membership, applied);
        let settings = raft::Config {
            id: config.id,
            election_tick: config.election_tick,
            heartbeat_tick: config.heartbeat_tick,
            applied,
            max_size_per_msg: config.message_bytes as u64,
            max_inflight_msgs: config.max_inflight_msgs,
            check_quorum: true,
            pre_vote: true,
            // Learners deliver commands to robots: they hear of a commit at once, not with the next block.
            skip_bcast_commit: false,
            // Would join messages without any limit; `pump.rs` joins them within one.
            batch_append: false,
            max_committed_size_per_ready: READ_BYTES as u64,
            ..raft::Config::default()
        };
        if config.id == 0 {
            return Err(EngineError::Config("found node id 0, wanted 1 or more".to_owned()));
        }
        let limits = [config.blocks_unpersisted, config.blocks_uncommitted, config.unapplied_bytes, config.ahead_bytes];
        if limits.contains(&0) {
            return Err(EngineError::Config("limits of blocks under way must be 1 or more".to_owned()));
        }
        let raw = RawNode::new(&settings, log, &logger::to_tracing())
            .map_err(|error| EngineError::Config(error.to_string()))?;
        let chain = Chain::start(executed, &store, applied)?;
        let told = RoleChange { leader: None, term: raw.raft.term, role: Role::Follower };
        let mut engine = Self {
            raw,
            store,
            queues: Queues::new(&config.creators),
            pending: VecDeque::new(),
            unpersisted_bytes: 0,
            held: BTreeMap::new(),
            own: VecDeque::new(),
            ahead: Ahead::new(config.ahead_bytes),
            now: 0,
            membership,
            emitted: applied,
            unapplied: VecDeque::new(),
            unapplied_bytes: 0,
            applied,
            barrier: 0,
            last_time: 0,
            times: Times::new(),
            doubt: None,
            wants_empty: false,
            told,
            attempts: 0,
            leaderless_ticks: 0,
            transfer_rest: 0,
            ticks: 0,
            leader_before: None,
            heard: BTreeMap::new(),
            ended_terms: BTreeMap::new(),
            stranger_leads: false,
            second_leads: false,
            acknowledged: Acknowledged::NONE,
            receipts: Receipts::new(config.id, &config.secret),
            chain,
            mandates: Mandates::new(ballots),
            heads: Heads::default(),
            complaints: Complaints::default(),
            handed_over: None,
            reads: 0,
            promised: Promised::NONE,
            failed: false,
            config,
        };
        engine.store.set_committed(engine.raw.raft.raft_log.committed);
        engine.draw_timeout();
        Ok(engine)
    }

    /// Takes one input at wall-clock time `now` (microseconds since the UNIX epoch; only proposed as block time) and
    /// appends what the driver must do to `out`.
    pub fn step(&mut self, now: u64, input: Input, out: &mut Vec<Output>) {
        if self.failed {
            return;
        }
        self.now = now;
        match input {
            Input::Tick => self.tick(out),
            Input::Message { from, message } => self.receive(from, message, out),
            Input::Submit { lane, transaction } => self.submit(lane, transaction, out),
            Input::ProposeEmpty => self.wants_empty = self.is_leader(),
            Input::Persisted { ready } => self.persisted(ready, out),
            Input::Applied { height, at } => self.set_applied(height, at),
            Input::ReadIndex { context } => self.read_index(context, out),
            Input::TransferLeadership { .. } | Input::ChangeMembership(_) => self.administer(input, out),
            Input::Campaign => self.campaign(),
            Input::Exclude(nodes) => self.mandates.exclude(nodes),
            Input::Complain { term, leader } => self.complain(term, leader, out),
            Input::Unreachable { peer } => self.raw.report_unreachable(peer),
        }
        if self.failed {
            return;
        }
        if self.membership.is_alone(self.config.id) && !self.is_leader() {
            // Nobody else can lead, so there is nothing to wait for.
            self.campaign();
        }
        if let Err(error) = self.pump(out) {
            let reason = Rejection::new(Code::DiskFailed, format!("block store failed: {error}"));
            self.fail(reason, out);
        }
        self.draw_timeout();
        self.chain.end_step();
        if !self.failed {
            self.keep_promises();
        }
    }

    fn fail(&mut self, reason: Rejection, out: &mut Vec<Output>) {
        self.failed = true;
        tracing::error!(code = reason.code.name(), %reason, "ordering stopped");
        out.push(Output::Failed(reason));
    }

    fn tick(&mut self, out: &mut Vec<Output>) {
        let raft = &mut self.raw.raft;
        let due = raft.election_elapsed + 1 >= raft.randomized_election_timeout();
        if raft.state != StateRole::Leader && due && !self.may_campaign() {
            // Time goes on (a dead leader's lease must end, so that this node votes for another), but no election.
            self.raw.raft.election_elapsed += 1;
        } else {
            self.raw.tick();
            let raft = &self.raw.raft;
            if raft.state != StateRole::Leader && raft.election_elapsed == 0 {
                self.attempts += 1;
            }
        }
        self.ticks += 1;
        self.transfer_rest = self.transfer_rest.saturating_sub(1);
        self.tell_who_is_behind(out);
        self.leaderless_ticks = if self.told.leader.is_some() { 0 } else { self.leaderless_ticks + 1 };
        if self.leaderless_ticks > 2 * self.config.election_tick {
            self.drop_waiting(&no_leader(), out);
        }
        self.look_for_leader(out);
        self.show_head(out);
    }

    fn receive(&mut self, from: u64, message: PeerMessage, out: &mut Vec<Output>) {
        if let Some(heard) = self.heard.get_mut(&from) {
            *heard = self.ticks;
        }
        if self.mandates.excludes(from, &message) {
            return out.push(Output::Ignored {
                from,
                reason: "it has lied, by proof, and neither leads nor stands for election",
            });
        }
        if self.is_from_deposed(from, &message) {
            return out
                .push(Output::Ignored { from, reason: "it was deposed, and neither leads nor stands for election" });
        }
        match message {
            PeerMessage::Raft(mut message) => {
                self.count_campaign(from, &message);
                match self.check_standing(from, &mut message, out) {
                    Ok(()) => {}
                    Err(Doubt::Unproven { term }) => return self.want_mandate(from, term, out),
                    Err(Doubt::Because(reason)) => return out.push(Output::Ignored { from, reason }),
                }
                let checked = self.check_chain(from, &message, out);
                if let Err(reason) = checked.and_then(|()| self.check_time(from, &mut message)) {
                    return out.push(Output::Ignored { from, reason });
                }
                if let Some(acknowledged) = self.has_lost_blocks(&message) {
                    return self.stop_or_fetch(from, acknowledged, out);
                }
                let heartbeat = (message.kind == i32::from(RaftKind::Heartbeat)).then_some(message.commit);
                let acknowledged = self.receipt_in(from, &message);
                match self.admit(from, message) {
                    Ok(message) => {
                        if let Err(error) = self.raw.step(message) {
                            tracing::debug!(from, %error, "message of a peer has no effect");
                        }
                    }
                    Err(reason) => return out.push(Output::Ignored { from, reason }),
                }
                if let Some(known) = heartbeat {
                    self.tell_what_is_held(from, known);
                }
                if let Some(receipt) = acknowledged {
                    self.receipts.keep(from, receipt);
                }
            }
            PeerMessage::Behind(behind) => self.told_behind(from, behind.first_index, out),
            PeerMessage::Forward(transactions) => self.forwarded(from, transactions, out),
            PeerMessage::Returned(transactions) if self.took_transactions(from) => self.returned(transactions, out),
            PeerMessage::Returned(_) => {
                out.push(Output::Ignored { from, reason: "it returns transactions that it was not given" });
            }
            PeerMessage::Mandate(mandate) => self.mandate_shown(from, &mandate, out),
            PeerMessage::MandateWanted(wanted) => self.mandate_wanted(from, wanted.term, out),
            PeerMessage::Head(shown) => self.head_shown(from, &shown, out),
            PeerMessage::Complaint(shown) => self.complaint_shown(from, &shown, out),
            // The node gives these to its certifier, its readers, and the calls that it waits for.
            PeerMessage::Statement(_)
            | PeerMessage::Evidence(_)
            | PeerMessage::Early(_)
            | PeerMessage::Unanswered(_) => {}
        }
    }

    fn campaign(&mut self) {
        if self.may_campaign() && !self.is_leader() {
            self.attempts += 1;
            if let Err(error) = self.raw.campaign() {
                tracing::debug!(%error, "cannot start an election");
            }
        }
    }

    /// Standing for election needs three things. They are an own vote (the crate forgets to ask when told to), a
    /// log that is on the own disk, and a state machine that is not far behind. A node that was deposed waits.
    fn may_campaign(&self) -> bool {
        let raft = &self.raw.raft;
        let log = &raft.raft_log;
        raft.promotable()
            && !self.is_banned()
            && log.persisted == log.last_index()
            // The crate reads what is not applied, and fails if it was dropped (`Raft::hup`).
            && log.applied + 1 >= self.store.first_index()
            && log.committed - self.applied.min(log.committed) <= CAMPAIGN_LAG_MAX
    }

    /// The leader, as far as this node knows. The crate lets a learner believe in a leader for ever, as it never stands
    /// for election itself. Here a leader that was not heard of for the longest election timeout is unknown.
    fn leader(&self) -> Option<u64> {
        let raft = &self.raw.raft;
        let silent = !self.is_leader() && raft.election_elapsed > 2 * self.config.election_tick;
        (raft.leader_id != raft::INVALID_ID && !silent).then_some(raft.leader_id)
    }

    /// The node has said something within the shortest election timeout; as a leader knows.
    fn is_active(&self, node: u64) -> bool {
        self.heard.get(&node).is_some_and(|heard| self.ticks - heard <= self.config.election_tick as u64)
    }

    fn is_leader(&self) -> bool {
        self.raw.raft.state == StateRole::Leader
    }

    /// The `raft` crate draws timeouts from a thread's random source whenever it resets one. We replace them by a
    /// function of seed, term and attempt, always, so that a run can be repeated.
    fn draw_timeout(&mut self) {
        let ticks = self.config.election_tick as u64;
        let drawn = mix(self.config.seed ^ mix(self.raw.raft.term) ^ mix(mix(self.attempts))) % ticks;
        let timeout = usize::try_from(ticks + drawn).unwrap_or(self.config.election_tick);
        self.raw.raft.set_randomized_election_timeout(timeout);
    }

    /// Time of the newest block that has one.
    fn newest_time(&self) -> u64 {
        let last = self.store.last_index();
        let from = last.saturating_sub(TIME_SCAN_ENTRIES_MAX).max(self.store.first_index());
        for index in (from..=last).rev() {
            if let Ok(Some(entry)) = self.store.entry(index)
                && entry.kind == EntryKind::Normal
                && let Ok(payload) = Payload::from_bytes(entry.data)
                && payload.time > 0
            {
                return payload.time;
            }
        }
        0
    }
}

/// A well-mixed function of a number (splitmix64).
fn mix(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests;
