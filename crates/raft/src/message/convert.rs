//! Between our messages and those of the `raft` crate, field by field: its own codec parses nothing that came from
//! outside.

use super::{RaftKind, RaftMessage, WireEntry};
use bytes::Bytes;
use ledger::members::MembershipChange;
use ledger_storage::entry::{Entry, EntryKind};
use raft::eraftpb;
use raft::eraftpb::MessageType;

const KINDS: [(RaftKind, MessageType); 11] = [
    (RaftKind::Append, MessageType::MsgAppend),
    (RaftKind::AppendResponse, MessageType::MsgAppendResponse),
    (RaftKind::Heartbeat, MessageType::MsgHeartbeat),
    (RaftKind::HeartbeatResponse, MessageType::MsgHeartbeatResponse),
    (RaftKind::Vote, MessageType::MsgRequestVote),
    (RaftKind::VoteResponse, MessageType::MsgRequestVoteResponse),
    (RaftKind::PreVote, MessageType::MsgRequestPreVote),
    (RaftKind::PreVoteResponse, MessageType::MsgRequestPreVoteResponse),
    (RaftKind::TimeoutNow, MessageType::MsgTimeoutNow),
    (RaftKind::ReadIndex, MessageType::MsgReadIndex),
    (RaftKind::ReadIndexResponse, MessageType::MsgReadIndexResp),
];

impl RaftMessage {
    /// A message from the engine; `None` for what never crosses the wire.
    pub(crate) fn from_raft(mut message: eraftpb::Message) -> Option<Self> {
        let (kind, _) = KINDS.iter().find(|(_, of)| *of == message.get_msg_type())?;
        let mut entries: Vec<eraftpb::Entry> = message.take_entries().into();
        let (context, hash) = match kind {
            RaftKind::ReadIndex | RaftKind::ReadIndexResponse => {
                (entries.drain(..).next().map(|mut entry| entry.take_data()).unwrap_or_default(), Bytes::new())
            }
            // The engine has named it there (`engine/chain.rs`).
            RaftKind::Append | RaftKind::AppendResponse => (Bytes::new(), message.take_context()),
            _ => (message.take_context(), Bytes::new()),
        };
        Some(Self {
            kind: (*kind).into(),
            term: message.term,
            log_term: message.log_term,
            index: message.index,
            commit: message.commit,
            commit_term: message.commit_term,
            reject: message.reject,
            reject_hint: message.reject_hint,
            context,
            entries: entries.into_iter().map(WireEntry::from_raft).collect(),
            receipt_index: 0,
            receipt: Bytes::new(),
            accepts_until: 0,
            vote: Bytes::new(),
            hash,
            transfer: Bytes::new(),
            head: Bytes::new(),
        })
    }

    /// A message to the engine; `None` for an unknown kind.
    pub(crate) fn into_raft(self, from: u64, to: u64) -> Option<eraftpb::Message> {
        let (kind, of) = KINDS.iter().find(|(kind, _)| i32::from(*kind) == self.kind)?;
        let mut message = eraftpb::Message::default();
        message.set_msg_type(*of);
        message.from = from;
        message.to = to;
        message.term = self.term;
        message.log_term = self.log_term;
        message.index = self.index;
        message.commit = self.commit;
        message.commit_term = self.commit_term;
        message.reject = self.reject;
        message.reject_hint = self.reject_hint;
        match kind {
            RaftKind::ReadIndex | RaftKind::ReadIndexResponse => {
                let entry = eraftpb::Entry { data: self.context, ..eraftpb::Entry::default() };
                message.set_entries(vec![entry].into());
            }
            _ => {
                let names = matches!(kind, RaftKind::Append | RaftKind::AppendResponse);
                message.context = if names { self.hash } else { self.context };
                let entries: Option<Vec<_>> = self.entries.into_iter().map(WireEntry::into_raft).collect();
                message.set_entries(entries?.into());
            }
        }
        Some(message)
    }
}

impl WireEntry {
    fn from_raft(entry: eraftpb::Entry) -> Self {
        let kind = kind_from_raft(entry.get_entry_type()).code();
        Self { index: entry.index, term: entry.term, kind: kind.into(), data: entry.data }
    }

    fn into_raft(self) -> Option<eraftpb::Entry> {
        let kind = u8::try_from(self.kind).ok().and_then(EntryKind::from_code)?;
        Some(entry_into_raft(Entry { index: self.index, term: self.term, kind, data: self.data }))
    }
}

/// An entry of the block store as the `raft` crate wants it.
pub(crate) fn entry_into_raft(entry: Entry) -> eraftpb::Entry {
    let mut into = eraftpb::Entry::default();
    into.set_entry_type(kind_into_raft(entry.kind));
    into.index = entry.index;
    into.term = entry.term;
    into.data = entry.data;
    into
}

/// An entry of the `raft` crate as the block store wants it.
pub(crate) fn entry_from_raft(entry: eraftpb::Entry) -> Entry {
    Entry { index: entry.index, term: entry.term, kind: kind_from_raft(entry.get_entry_type()), data: entry.data }
}

fn kind_from_raft(kind: eraftpb::EntryType) -> EntryKind {
    match kind {
        eraftpb::EntryType::EntryNormal => EntryKind::Normal,
        eraftpb::EntryType::EntryConfChange => EntryKind::ConfChange,
        eraftpb::EntryType::EntryConfChangeV2 => EntryKind::ConfChangeV2,
    }
}

fn kind_into_raft(kind: EntryKind) -> eraftpb::EntryType {
    match kind {
        EntryKind::Normal => eraftpb::EntryType::EntryNormal,
        EntryKind::ConfChange => eraftpb::EntryType::EntryConfChange,
        EntryKind::ConfChangeV2 => eraftpb::EntryType::EntryConfChangeV2,
    }
}

/// A change of members as the `raft` crate wants it.
pub(crate) fn change_into_raft(change: &MembershipChange) -> eraftpb::ConfChangeV2 {
    let mut into = eraftpb::ConfChangeV2::default();
    into.set_transition(match change.transition {
        0 => eraftpb::ConfChangeTransition::Auto,
        1 => eraftpb::ConfChangeTransition::Implicit,
        _ => eraftpb::ConfChangeTransition::Explicit,
    });
    let singles = change.changes.iter().map(|single| {
        let mut into = eraftpb::ConfChangeSingle::default();
        into.set_change_type(match single.kind {
            0 => eraftpb::ConfChangeType::AddNode,
            1 => eraftpb::ConfChangeType::RemoveNode,
            _ => eraftpb::ConfChangeType::AddLearnerNode,
        });
        into.node_id = single.node;
        into
    });
    into.set_changes(singles.collect::<Vec<_>>().into());
    into
}

/// A proposal of this node itself: the only kind of proposal that the engine ever steps.
pub(crate) fn proposal(id: u64, kind: EntryKind, data: Bytes) -> eraftpb::Message {
    let mut entry = eraftpb::Entry::default();
    entry.set_entry_type(kind_into_raft(kind));
    entry.data = data;
    let mut message = eraftpb::Message::default();
    message.set_msg_type(MessageType::MsgPropose);
    message.from = id;
    message.set_entries(vec![entry].into());
    message
}
