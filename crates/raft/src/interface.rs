//! The inputs and outputs of the engine.

use crate::message::PeerMessage;
use bytes::Bytes;
use ledger::members::{Membership, MembershipChange};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_light::BranchLink;
use ledger_storage::entry::Entry;
use std::collections::BTreeSet;

/// How urgent a transaction is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Lane {
    /// Release, preempt, revoke, stop, grants: never waits behind data.
    Control,
    /// Everything else.
    Data,
}

/// An event, told to the engine.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "most inputs are messages; a box would cost an allocation for each")]
pub enum Input {
    /// One step of the logical clock. Timeouts are counted in these.
    Tick,
    /// A message came from the authenticated peer `from`.
    Message {
        /// The sender: from the connection's certificate, never from the message.
        from: u64,
        /// The message.
        message: PeerMessage,
    },
    /// A client wants this transaction ordered.
    Submit {
        /// How urgent it is.
        lane: Lane,
        /// The signed bytes.
        transaction: Bytes,
    },
    /// A deadline has passed: a leader orders an empty block if nothing else is waiting. Others ignore it.
    ProposeEmpty,
    /// The flush that [`Output::Flush`] asked for has returned; also counts for every smaller number.
    Persisted {
        /// The number of [`Output::Flush`].
        ready: u64,
    },
    /// Every block up to this height is executed.
    Applied {
        /// The height.
        height: u64,
        /// When that was, by the clock that goes with inputs, microseconds: how much may be ordered ahead of execution
        /// depends on how long it takes.
        at: u64,
    },
    /// A linearizable read wants to know how far this node must be. The answer is [`Output::ReadReady`] or
    /// [`Output::Refused`]. There is none when a message is lost, when the leader changes meanwhile, or when it is so
    /// new that it has committed nothing and drops questions of others. Then ask again after a timeout, with another
    /// context.
    ReadIndex {
        /// Comes back with the answer; must not repeat while the engine lives.
        context: u64,
    },
    /// A leader hands over to this voter. Proposals pause until it is done or an election timeout has passed; see
    /// `Status::transferring_to`. Asking again for the same voter meanwhile changes nothing; for another is refused.
    TransferLeadership {
        /// The voter that shall lead.
        to: u64,
    },
    /// A leader orders a change of the members.
    ChangeMembership(MembershipChange),
    /// Stand for election now, without waiting for the timeout.
    Campaign,
    /// These nodes have lied, by proof: nothing that they send as leaders or as candidates is taken any more. Replaces the set
    /// before.
    Exclude(BTreeSet<u64>),
    /// A message to this peer could not be delivered; replication to it becomes careful.
    Unreachable {
        /// The peer.
        peer: u64,
    },
}

/// An action for the driver. In the order given.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Send this message; losing it is allowed, holding it back is not needed.
    Send {
        /// The peer.
        to: u64,
        /// The message.
        message: PeerMessage,
    },
    /// Make everything that is staged in the block store durable, then answer [`Input::Persisted`].
    Flush {
        /// The number to answer with.
        ready: u64,
    },
    /// These blocks are committed: execute them. Each comes exactly once, in order of height.
    Commit(Vec<Entry>),
    /// The leader has changed.
    Role(RoleChange),
    /// The members have changed with the block of this height. The execution of the block keeps them
    /// ([`ledger::Ledger::members`]), so that [`crate::EngineConfig`] knows them at the next start.
    Membership {
        /// Height of the change.
        height: u64,
        /// The members from there on.
        membership: Membership,
    },
    /// A read with this context may be answered once this node has executed everything up to `index`.
    ReadReady {
        /// From [`Input::ReadIndex`].
        context: u64,
        /// The height to wait for.
        index: u64,
    },
    /// This transaction was not ordered. It may be submitted again, unchanged.
    Dropped {
        /// The signed bytes.
        transaction: Bytes,
        /// Why.
        reason: Rejection,
    },
    /// A read, transfer or change of members cannot be done now.
    Refused {
        /// The request.
        input: Box<Input>,
        /// Why.
        reason: Rejection,
    },
    /// Blocks before `first_index` do not come by themselves any more: the leader has dropped them, or takes them for
    /// held here. Repeated with every heartbeat until the driver ends this engine, fetches at least the blocks up to
    /// `first_index - 1` from its peers, and starts a new one.
    Behind {
        /// The leader that says so.
        from: u64,
        /// The first block that replication still brings.
        first_index: u64,
    },
    /// A message of a peer is ignored: no honest peer sends it, or this node cannot take it now.
    Ignored {
        /// The peer.
        from: u64,
        /// Why.
        reason: &'static str,
    },
    /// A voter has signed votes for two candidates in one term. No honest one does: this proves it.
    VotedTwice(Box<VotedTwice>),
    /// A leader has signed two logs in one term. No honest one does: this proves it.
    TwoHeads(Box<DoubleHead>),
    /// Another node has another chain than this node. One of the two, or a leader before them, has lied, or has lost what it
    /// had promised. Nothing is appended, and nothing is counted.
    Contradicted(Contradiction),
    /// The block store failed, or has lost what this voter promised to keep. The engine does nothing any more; the
    /// process should end.
    Failed(Rejection),
}

/// Two signed votes of one voter in one term.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VotedTwice {
    /// The term.
    pub term: u64,
    /// The voter.
    pub voter: u64,
    /// The candidates, each with the signed vote for it ([`crate::Ballots`]).
    pub votes: [(u64, Bytes); 2],
}

/// Two signed heads of one leader in one term, above different blocks of one height.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DoubleHead {
    /// The leader.
    pub leader: u64,
    /// The term.
    pub term: u64,
    /// The height at which the two logs differ.
    pub height: u64,
    /// The log that this node has, and the other one.
    pub branches: [HeadBranch; 2],
}

/// One of two logs of a leader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeadBranch {
    /// Hash of its block at the height at which the two differ.
    pub base: Hash,
    /// The blocks after it, up to the head.
    pub links: Vec<BranchLink>,
    /// The vote of the leader for itself, which has the certificate of the signature.
    pub vote: Bytes,
    /// The signature of the head.
    pub signature: Bytes,
}

/// Two nodes have different entries where Raft takes them for equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contradiction {
    /// The other node.
    pub node: u64,
    /// It leads, and wanted to append. Otherwise it follows this leader, and has acknowledged its own chain.
    pub leads: bool,
    /// The term.
    pub term: u64,
    /// Height of a block that differs. Earlier ones may differ, too.
    pub height: u64,
    /// Hash of this node's chain up to there.
    pub own: Hash,
    /// Hash of the other node's chain up to there.
    pub other: Hash,
}

/// The role of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Follows, and may vote if it is a voter.
    Follower,
    /// Asks for votes.
    Candidate,
    /// Orders.
    Leader,
}

/// The leader, as far as this node knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RoleChange {
    /// The leader, if one is known.
    pub leader: Option<u64>,
    /// The term; grows with every election.
    pub term: u64,
    /// This node's own role.
    pub role: Role,
}
