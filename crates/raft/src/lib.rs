//! Ordering: which transaction comes when, agreed by a majority of the voters.
//!
//! The [`Engine`] is a synchronous state machine around the Raft of the `raft` crate. It owns no thread, socket, clock
//! or random source: the driver hands it an [`Input`] and the time, and carries out the [`Output`]s. So a whole
//! cluster runs in a deterministic simulator as it runs in nodes. One voter goes through the same code as five.
//!
//! ```text
//! Submit -> queues (two lanes) -> block -> raft log = block store -> Send to the others, Flush on the own disk
//!                                                  Persisted, messages -> majority -> Commit in order, once
//! ```
//!
//! Its limits: it has no key, executes nothing and knows no addresses. A transaction is bytes. Votes are signed and checked
//! behind [`Ballots`].
//!
//! The driver's duties, all of them:
//! - call [`Engine::step`] with [`Input::Tick`] at a steady pace, and once at the start;
//! - on [`Output::Flush`], call `flush` of the block store on the disk thread and answer [`Input::Persisted`]; several
//!   flushes may be served by one, answered with the largest number;
//! - on [`Output::Commit`], execute the blocks in order and answer [`Input::Applied`]. Store nothing durably of what
//!   was executed above `BlockStore::durable_index`: a learner hands out what its own disk does not have yet;
//! - on [`Output::Behind`], end this engine and fetch the blocks (or a snapshot and the blocks after it) from peers
//!   into the block store and the state machine. Start a new engine from there;
//! - drop old blocks (`BlockStore::prune`) only up to the last [`Input::Applied`] that is stored durably;
//! - send [`Output::Send`] over a connection whose peer is authenticated; hand in what comes with that peer's id.
//!   Messages may be lost, repeated and reordered.
//!
//! The `raft` crate panics when its invariants are broken (a committed entry lost, a disk that forgot), and so does the
//! engine when a step took back a promise (`engine/promises.rs`). The process ends then, and the disk is the truth.
//! Messages of peers cannot reach those panics: see `engine/guard.rs`.
//!
//! Only `engine`, `log` and `message` name the `raft` crate, so that it can be replaced.

mod engine;
mod interface;
mod log;
mod message;
mod queue;
mod reconcile;

pub use engine::{
    Ballot, Ballots, ClockDoubt, Deposition, Engine, EngineConfig, EngineError, ExecutedBlocks, Grievance, Handover,
    Link, LogHead, PeerStatus, Receipt, ReceiptKey, Replication, Secret, Status, TIME_AHEAD_MAX,
};
pub use interface::{Contradiction, DoubleHead, HeadBranch, Input, Lane, Output, Role, RoleChange, VotedTwice};
pub use ledger::members::{Change, Membership, MembershipChange, MembershipError, NODES_MAX};
pub use message::{
    CONTEXT_BYTES_MAX, EARLY_BYTES_MAX, ENTRIES_MAX, EVIDENCE_BYTES_MAX, EarlyCall, Evidence, HEAD_BYTES_MAX,
    LeaderHead, LogBegin, Mandate, MandateWanted, MessageError, PEER_MESSAGE_BYTES_MAX, PeerMessage, RaftKind,
    RaftMessage, STATEMENT_BYTES_MAX, SignedComplaint, SignedStatement, SignedVote, Transactions, UNANSWERED_BYTES_MAX,
    UnansweredCall, VOTE_BYTES_MAX, WireEntry,
};
pub use queue::{
    CONTROL_QUEUE_BYTES_MAX, CONTROL_QUEUE_TRANSACTIONS_MAX, Creators, DATA_QUEUE_BYTES_MAX,
    DATA_QUEUE_TRANSACTIONS_MAX, QueueStatus,
};
pub use reconcile::{Desired, PROMOTION_LAG_MAX, next_step, successor};
