//! How an engine is set up, and what keeps it from starting.

use super::receipt::Secret;
use crate::queue::Creators;
use ledger::members::Membership;

/// How an engine is set up. Times are counted in ticks.
#[derive(Clone, Debug)]
pub struct EngineConfig {
    /// This node; never 0.
    pub id: u64,
    /// The members as of `applied`, which the state machine holds.
    pub membership: Membership,
    /// Last height that the state machine holds. Blocks after it come as [`Output::Commit`](crate::Output::Commit).
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
    /// Longest time that data waits for its block, microseconds: what waited longer is refused, so that the latency of the
    /// rest stays bounded. Control waits as long as it takes.
    pub data_wait_us: u64,
    /// Most committed data of a leader that may wait for its execution, in bytes. Each transaction counts some hundred
    /// more, for what its execution costs beside them. It is less while execution takes long, as control waits behind
    /// it. A block takes at most half of it. Two keep disk and executor busy; more would only wait.
    pub ahead_bytes: usize,
    /// Known to this node alone, and the same after every start: see [`Secret`].
    pub secret: Secret,
    /// The organisations of creators, between which the queues are fair.
    pub creators: Creators,
    /// Randomness: election timeouts and the names of reads. Different on every node and at every start.
    pub seed: u64,
}

impl EngineConfig {
    /// The defaults, for ticks of about 10 ms.
    pub fn new(id: u64, membership: Membership, seed: u64) -> Self {
        Self {
            id,
            membership,
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
            data_wait_us: 200_000,
            ahead_bytes: 64 * 1024,
            secret: Secret::default(),
            creators: Creators::default(),
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
    /// The log begins after the block that the state machine needs next.
    #[error(
        "state is behind the log: found state at height {applied}, log from {first} on; fetch a snapshot from a peer, or blocks from {applied} on"
    )]
    StateBehind {
        /// Height of the state.
        applied: u64,
        /// First height of the log.
        first: u64,
    },
    /// The log lost what it knew to be committed.
    #[error(
        "log has lost committed blocks: found last height {last}, wanted at least {commit}; ledgerd rejoin --config FILE brings it back as a new node"
    )]
    LogLost {
        /// Last height of the log.
        last: u64,
        /// Height known to be committed.
        commit: u64,
    },
    /// The hash of the newest executed block is not known.
    #[error("hash of executed block {height} is not known; move state and results aside so that they are rebuilt")]
    NoHash {
        /// Height of the block.
        height: u64,
    },
    /// The end of the log cannot be read.
    #[error("log cannot be read at height {height}: {error}")]
    Log {
        /// Where.
        height: u64,
        /// Why.
        error: String,
    },
    /// The configuration contradicts itself.
    #[error("ordering cannot be configured so: {0}")]
    Config(String),
}
