//! The pump around the `raft` crate: inputs in, outputs out, nothing else.

mod guard;
mod logger;
mod pump;
mod submit;

use crate::interface::{Input, Output, Role, RoleChange};
use crate::log::Log;
use crate::membership::Membership;
use crate::message::{PEER_MESSAGE_BYTES_MAX, PeerMessage};
use crate::queue::{QueueStatus, Queues};
use ledger::block::Payload;
use ledger::block_store::{BlockStore, STAGED_BYTES_MAX};
use ledger::entry::EntryKind;
use ledger::{Code, Rejection};
use raft::{ProgressState, RawNode, StateRole};
use std::collections::VecDeque;
use std::sync::Arc;

/// Entries committed but not executed beyond which a node does not stand for election: it could not order before it
/// has caught up, and counting changes of members among them would cost it the election timeout.
const CAMPAIGN_LAG_MAX: u64 = 10_000;
/// Reads that wait for a majority to confirm the leader.
const READS_PENDING_MAX: usize = 4096;
/// Entries looked at, from the end of the log, for the newest block time. Blocks without a time are the empty ones
/// that open a term; more of them in a row than this loses only the guarantee that a new leader's *proposed* time
/// is not older, which the executor makes good.
const TIME_SCAN_ENTRIES_MAX: u64 = 64;
/// Bytes of entries that wait for the own disk beyond which a follower takes no more; the leader sends them again.
/// With the longest message on top it stays below what the block store stages.
const UNPERSISTED_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Bytes read from the store at once.
const READ_BYTES: usize = 4 * 1024 * 1024;

const _: () = assert!(UNPERSISTED_BYTES_MAX + PEER_MESSAGE_BYTES_MAX < STAGED_BYTES_MAX);

/// How an engine is set up. Times are counted in ticks.
#[derive(Clone, Debug)]
pub struct EngineConfig {
    /// This node; never 0.
    pub id: u64,
    /// The members as of `membership_height`: those of the genesis at height 0, or a pair that
    /// [`Output::Membership`] told. Later changes up to `applied` are read from the log.
    pub membership: Membership,
    /// See `membership`.
    pub membership_height: u64,
    /// Last height that the state machine holds. Blocks after it come as [`Output::Commit`].
    pub applied: u64,
    /// Ticks without a leader after which a node stands for election; the real timeout is drawn from once to twice.
    pub election_tick: usize,
    /// Ticks between a leader's heartbeats; less than `election_tick`.
    pub heartbeat_tick: usize,
    /// Messages of entries on their way to one peer.
    pub max_inflight_msgs: usize,
    /// Bytes of entries in one message; a single larger block still goes, alone.
    pub message_bytes: usize,
    /// Bytes after which a block is closed although more waits. A larger block delays what comes behind it.
    pub block_bytes: usize,
    /// Own blocks that may be on their way to the own disk. One would leave the disk idle while the next block is
    /// formed; more would only cut what waits into smaller blocks.
    pub blocks_unpersisted: usize,
    /// Own blocks that may wait for a majority. Bounds memory when the others are slow or gone.
    pub blocks_uncommitted: usize,
    /// Bytes of own blocks that may wait for a majority.
    pub uncommitted_bytes: usize,
    /// Bytes of committed blocks handed out and not yet executed.
    pub unapplied_bytes: usize,
    /// Randomness: election timeouts and the names of reads. Different on every node and at every start.
    pub seed: u64,
}

impl EngineConfig {
    /// The defaults, for ticks of about 10 ms.
    pub fn new(id: u64, membership: Membership, seed: u64) -> Self {
        Self {
            id,
            membership,
            membership_height: 0,
            applied: 0,
            election_tick: 20,
            heartbeat_tick: 4,
            max_inflight_msgs: 64,
            message_bytes: 1024 * 1024,
            block_bytes: 1024 * 1024,
            blocks_unpersisted: 2,
            blocks_uncommitted: 256,
            uncommitted_bytes: 64 * 1024 * 1024,
            unapplied_bytes: 32 * 1024 * 1024,
            seed,
        }
    }
}

/// Why an engine cannot start.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The state machine holds blocks that the log does not.
    #[error(
        "state is ahead of the log: found state at height {applied}, wanted at most {last}; move the state aside so that it is rebuilt"
    )]
    StateAhead {
        /// Height of the state.
        applied: u64,
        /// Last height of the log.
        last: u64,
    },
    /// The log lost what it knew to be committed.
    #[error(
        "log has lost committed blocks: found last height {last}, wanted at least {commit}; restore the disk, or join again as a new node"
    )]
    LogLost {
        /// Last height of the log.
        last: u64,
        /// Height known to be committed.
        commit: u64,
    },
    /// Members cannot be recovered.
    #[error("members are known at height {height} only: found the log starting at {first}, wanted at most {}", height + 1)]
    MembersUnknown {
        /// Height of the members given.
        height: u64,
        /// First height of the log.
        first: u64,
    },
    /// A block cannot be read.
    #[error("log cannot be read: {0}")]
    Store(String),
    /// The configuration contradicts itself.
    #[error("ordering cannot be configured so: {0}")]
    Config(String),
}

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
    /// What waits to be ordered, or to be forwarded to the leader.
    queues: Queues,
    /// In order of number; the first always needs a flush.
    pending: VecDeque<PendingReady>,
    /// Bytes of entries in `pending`.
    unpersisted_bytes: usize,
    /// Own blocks under way, in order of index.
    own: VecDeque<OwnBlock>,
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
    /// A deadline passed: order a block even if nothing waits.
    wants_empty: bool,
    /// What was last told.
    told: RoleChange,
    /// Elections this node has started; varies its timeouts within a term.
    attempts: u64,
    /// Ticks since a leader was last known.
    leaderless_ticks: usize,
    /// Set once the store has failed.
    failed: bool,
}

impl Engine {
    /// Starts from what the store holds. Nothing is sent before the first [`Engine::step`].
    ///
    /// # Errors
    /// [`EngineError`] when the store, the state machine's height and the configuration do not fit together.
    pub fn new(config: EngineConfig, store: Arc<BlockStore>) -> Result<Self, EngineError> {
        let (applied, last, stored) = (config.applied, store.last_index(), store.hard_state());
        if applied > last {
            return Err(EngineError::StateAhead { applied, last });
        }
        if stored.commit > last {
            return Err(EngineError::LogLost { last, commit: stored.commit });
        }
        let membership = recover_members(&config, &store)?;
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
        if config.blocks_unpersisted == 0 || config.blocks_uncommitted == 0 || config.unapplied_bytes == 0 {
            return Err(EngineError::Config("limits of blocks under way must be 1 or more".to_owned()));
        }
        let raw = RawNode::new(&settings, log, &logger::to_tracing())
            .map_err(|error| EngineError::Config(error.to_string()))?;
        let told = RoleChange { leader: None, term: raw.raft.term, role: Role::Follower };
        let mut engine = Self {
            raw,
            store,
            queues: Queues::new(),
            pending: VecDeque::new(),
            unpersisted_bytes: 0,
            own: VecDeque::new(),
            membership,
            emitted: applied,
            unapplied: VecDeque::new(),
            unapplied_bytes: 0,
            applied,
            barrier: 0,
            last_time: 0,
            wants_empty: false,
            told,
            attempts: 0,
            leaderless_ticks: 0,
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
        match input {
            Input::Tick => self.tick(out),
            Input::Message { from, message } => self.receive(from, message, out),
            Input::Submit { lane, transaction } => self.submit(lane, transaction, out),
            Input::ProposeEmpty => self.wants_empty = self.is_leader(),
            Input::Persisted { ready } => self.persisted(ready, out),
            Input::Applied { height } => self.set_applied(height),
            Input::ReadIndex { context } => self.read_index(context, out),
            Input::TransferLeadership { .. } | Input::ChangeMembership(_) => self.administer(input, out),
            Input::Campaign => self.campaign(),
            Input::Unreachable { peer } => self.raw.report_unreachable(peer),
        }
        if self.membership.is_alone(self.config.id) && !self.is_leader() {
            // Nobody else can lead, so there is nothing to wait for.
            self.campaign();
        }
        if let Err(error) = self.pump(now, out) {
            self.failed = true;
            tracing::error!(%error, "block store failed; ordering stops");
            let reason = Rejection::new(Code::DiskFailed, format!("block store failed: {error}"))
                .next("see the log; restart the node when the disk is in order");
            out.push(Output::Failed(reason));
        }
        self.draw_timeout();
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
        self.leaderless_ticks = if self.told.leader.is_some() { 0 } else { self.leaderless_ticks + 1 };
        if self.leaderless_ticks > 2 * self.config.election_tick {
            self.drop_waiting(out);
        }
    }

    fn receive(&mut self, from: u64, message: PeerMessage, out: &mut Vec<Output>) {
        match message {
            PeerMessage::Raft(message) => match self.admit(from, message) {
                Ok(message) => {
                    if let Err(error) = self.raw.step(message) {
                        tracing::debug!(from, %error, "message has no effect");
                    }
                }
                Err(reason) => tracing::warn!(from, reason, "message of a peer is ignored"),
            },
            PeerMessage::Forward(transactions) => self.forwarded(from, transactions, out),
            PeerMessage::Returned(transactions) => self.returned(transactions, out),
        }
    }

    /// Names of reads: node, start, the caller's context. A late answer to a read of an earlier start must not
    /// answer one of this start.
    fn read_name(&self, context: u64) -> Vec<u8> {
        [self.config.id, self.config.seed, context].iter().flat_map(|part| part.to_be_bytes()).collect()
    }

    /// The context in the name of a read, if it is of this start of this node.
    fn read_context(&self, name: &[u8]) -> Option<u64> {
        let (_, context) = name.split_at_checked(16)?;
        let context = u64::from_be_bytes(context.try_into().ok()?);
        (self.read_name(context) == name).then_some(context)
    }

    fn read_index(&mut self, context: u64, out: &mut Vec<Output>) {
        let raft = &self.raw.raft;
        let reason = if self.leader().is_none() {
            Rejection::new(Code::NoLeader, "no leader is known, so nobody can confirm a read").next("ask again later")
        } else if self.is_leader() && !raft.commit_to_current_term() {
            Rejection::new(Code::NoLeader, "the leader is new and has committed nothing yet").next("ask again later")
        } else if raft.pending_read_count() >= READS_PENDING_MAX {
            Rejection::new(Code::Overloaded, "too many reads wait for confirmation")
                .found(raft.pending_read_count().to_string())
                .wanted(format!("at most {READS_PENDING_MAX}"))
                .next("ask again later")
        } else {
            let name = self.read_name(context);
            return self.raw.read_index(name);
        };
        out.push(Output::Refused { input: Box::new(Input::ReadIndex { context }), reason });
    }

    /// Transfers of leadership and changes of members: both only by a leader that is ready to order.
    fn administer(&mut self, input: Input, out: &mut Vec<Output>) {
        let result = if !self.may_propose() {
            Err(Rejection::new(Code::NoLeader, "this node is not the leader, or not ready to order")
                .found(format!("leader {:?}", self.told.leader))
                .next("ask the leader, or again later"))
        } else {
            match &input {
                Input::TransferLeadership { to } if !self.membership.is_voter(*to) => {
                    Err(Rejection::new(Code::BadArgument, format!("node {to} is not a voter"))
                        .wanted(format!("one of {:?}", self.membership.voters)))
                }
                Input::TransferLeadership { to } => {
                    self.raw.transfer_leader(*to);
                    Ok(())
                }
                Input::ChangeMembership(change) => self.change_membership(change),
                _ => Ok(()),
            }
        };
        if let Err(reason) = result {
            out.push(Output::Refused { input: Box::new(input), reason });
        }
    }

    fn change_membership(&mut self, change: &crate::MembershipChange) -> Result<(), Rejection> {
        let bad = |error: String| Rejection::new(Code::BadArgument, error);
        if self.raw.raft.has_pending_conf() {
            return Err(Rejection::new(Code::Overloaded, "another change of members is not complete")
                .next("ask again when it is"));
        }
        let data = change.to_bytes();
        crate::MembershipChange::from_bytes(&data).map_err(|error| bad(error.to_string()))?;
        let next = self.membership.apply(change).map_err(|error| bad(error.to_string()))?;
        if !next.voters.contains(&self.config.id) {
            return Err(bad("the leader cannot take away its own vote".to_owned())
                .next("transfer the leadership to another voter first"));
        }
        let proposal = crate::message::convert::proposal(self.config.id, EntryKind::ConfChangeV2, data);
        self.raw.step(proposal).map_err(|error| bad(error.to_string()))
    }

    fn campaign(&mut self) {
        if self.may_campaign() && !self.is_leader() {
            self.attempts += 1;
            if let Err(error) = self.raw.campaign() {
                tracing::debug!(%error, "cannot stand for election");
            }
        }
    }

    /// Standing for election needs a vote of one's own (the crate forgets to ask when told to), a log that is on the own
    /// disk, and a state machine that is not far behind.
    fn may_campaign(&self) -> bool {
        let raft = &self.raw.raft;
        let log = &raft.raft_log;
        raft.promotable()
            && log.persisted == log.last_index()
            && log.committed - self.applied.min(log.committed) <= CAMPAIGN_LAG_MAX
    }

    /// Who leads, as far as this node knows. The crate lets a learner believe in a leader for ever, as it never stands
    /// for election itself; here a leader that was not heard of for the longest election timeout is unknown.
    fn leader(&self) -> Option<u64> {
        let raft = &self.raw.raft;
        let silent = !self.is_leader() && raft.election_elapsed > 2 * self.config.election_tick;
        (raft.leader_id != raft::INVALID_ID && !silent).then_some(raft.leader_id)
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

    /// How things stand.
    pub fn status(&self) -> Status {
        let raft = &self.raw.raft;
        let replication = |state| match state {
            ProgressState::Probe => Replication::Probing,
            ProgressState::Replicate => Replication::Streaming,
            ProgressState::Snapshot => Replication::Snapshot,
        };
        let mut peers: Vec<_> = match raft.state {
            StateRole::Leader => raft
                .prs()
                .iter()
                .filter(|(node, _)| **node != self.config.id)
                .map(|(node, progress)| PeerStatus {
                    node: *node,
                    matched: progress.matched,
                    next: progress.next_idx,
                    replication: replication(progress.state),
                    recently_active: progress.recent_active,
                })
                .collect(),
            _ => Vec::new(),
        };
        peers.sort_by_key(|peer| peer.node);
        Status {
            id: self.config.id,
            role: self.told,
            commit: raft.raft_log.committed,
            applied: self.applied,
            persisted: raft.raft_log.persisted,
            last: raft.raft_log.last_index(),
            may_propose: self.may_propose(),
            membership: self.membership.clone(),
            peers,
            control: self.queues.control.status(),
            data: self.queues.data.status(),
        }
    }
}

/// How an engine stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// This node.
    pub id: u64,
    /// Who leads, in which term, and what this node is.
    pub role: RoleChange,
    /// Last height known to be committed.
    pub commit: u64,
    /// Last height executed.
    pub applied: u64,
    /// Last height on the own disk.
    pub persisted: u64,
    /// Last height of the log.
    pub last: u64,
    /// It leads and has executed everything that was there when it was elected.
    pub may_propose: bool,
    /// The members as of the last height handed out.
    pub membership: Membership,
    /// The others, as a leader sees them; empty elsewhere. In order of node.
    pub peers: Vec<PeerStatus>,
    /// The control lane.
    pub control: QueueStatus,
    /// The data lane.
    pub data: QueueStatus,
}

/// One peer as the leader sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PeerStatus {
    /// The peer.
    pub node: u64,
    /// Its log is known to be equal up to here.
    pub matched: u64,
    /// The next height it will be sent.
    pub next: u64,
    /// How entries are sent to it.
    pub replication: Replication,
    /// It was heard of within the last election timeout.
    pub recently_active: bool,
}

/// How entries are sent to a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Replication {
    /// One message at a time, to find where its log ends.
    Probing,
    /// As they come.
    Streaming,
    /// It needs blocks that the log does not hold any more.
    Snapshot,
}

/// Folds the changes after the known height into the members.
fn recover_members(config: &EngineConfig, store: &BlockStore) -> Result<Membership, EngineError> {
    let (known, first) = (config.membership_height, store.first_index());
    if known < config.applied && first > known + 1 {
        return Err(EngineError::MembersUnknown { height: known, first });
    }
    let mut members = config.membership.clone();
    let mut next = known + 1;
    while next <= config.applied {
        let entries = store
            .entries(next..config.applied + 1, READ_BYTES)
            .map_err(|error| EngineError::Store(error.to_string()))?;
        let Some(last) = entries.last().map(|entry| entry.index) else {
            return Err(EngineError::Store(format!("block {next} is missing")));
        };
        members = members.fold(&entries);
        next = last + 1;
    }
    Ok(members)
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
