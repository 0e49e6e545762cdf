//! Conditions for a peer's message before the `raft` crate sees it.
//!
//! Peers are authenticated, but a broken or hostile one must not bring others down. The crate trusts messages and
//! panics (or counts wrongly) on some that no correct peer sends; each check here names the place. It also holds the
//! fix of raft-rs #557, which 0.7.0 lacks, and one for reads, see [`Engine::admit`].

use super::request::{READ_NAME_BYTES, READS_PENDING_MAX};
use super::{Engine, UNPERSISTED_BYTES_MAX};
use crate::message::RaftMessage;
use raft::eraftpb::{Message, MessageType};
use raft::{ProgressState, StateRole};

impl Engine {
    /// The message for the crate, or why it is ignored.
    ///
    /// A read of another node gets a name that the crate sees once. It would count acknowledgements by name alone
    /// (`ReadOnly::recv_ack`). When the network repeats the question of an answered read, late acknowledgements of the
    /// first one would confirm a leader that is deposed since. Every read that waits would be confirmed with it (etcd
    /// #20418).
    pub(super) fn admit(&mut self, from: u64, message: RaftMessage) -> Result<Message, &'static str> {
        let mut message = message.into_raft(from, self.config.id).ok_or("it is of an unknown kind")?;
        if from == raft::INVALID_ID || from == self.config.id {
            return Err("it claims to come from this node");
        }
        let raft = &self.raw.raft;
        let log = &raft.raft_log;
        let stale = message.term < raft.term;
        match message.get_msg_type() {
            MessageType::MsgHeartbeat if !stale && message.commit > log.last_index() => {
                // `commit_to` panics. From the leader it means that this node has lost blocks: see `behind.rs`.
                Err("it says that more is committed than this node holds")
            }
            MessageType::MsgAppend if message.index > 0 && message.log_term == 0 => {
                // An index beyond the log has term 0 in the crate, so this would match and leave a gap.
                Err("its entries follow an entry without a term")
            }
            MessageType::MsgAppend if !message.entries.is_empty() && self.unpersisted_bytes > UNPERSISTED_BYTES_MAX => {
                Err("the own disk is too far behind to take more entries")
            }
            MessageType::MsgAppendResponse if !stale => {
                let last = log.last_index();
                if message.index > last || message.reject_hint > last {
                    // Would be counted as held by that peer, and sent on from there.
                    return Err("it acknowledges entries that do not exist");
                }
                self.guard_probe(&mut message)?;
                Ok(message)
            }
            MessageType::MsgReadIndex if raft.state != StateRole::Leader => {
                // The crate would pass it on in the name of this node, and a name that was made here is none to the leader.
                Err("this node does not lead, so it confirms no read")
            }
            MessageType::MsgReadIndex if raft.pending_read_count() >= READS_PENDING_MAX => {
                Err("too many reads wait for confirmation")
            }
            MessageType::MsgReadIndex
                if message.entries.first().is_none_or(|entry| entry.data.len() != READ_NAME_BYTES) =>
            {
                Err("its read has no name as reads have")
            }
            MessageType::MsgTimeoutNow if !self.may_campaign() => {
                Err("this node is too far behind to take over the leadership")
            }
            MessageType::MsgReadIndex => {
                self.reads += 1;
                if let Some(entry) = message.mut_entries().first_mut() {
                    entry.data = [&entry.data, &self.reads.to_be_bytes()[..]].concat().into();
                }
                Ok(message)
            }
            _ => Ok(message),
        }
    }

    /// raft-rs #557 (etcd raft #149): a late refusal must not make a probe start below what the peer is known to
    /// hold. A refusal at or below `matched` is such a one; a hint below it is raised to it.
    fn guard_probe(&self, message: &mut Message) -> Result<(), &'static str> {
        let raft = &self.raw.raft;
        let Some(progress) = raft.prs().get(message.from) else { return Ok(()) };
        if !message.reject || progress.state != ProgressState::Probe {
            return Ok(());
        }
        if message.index <= progress.matched {
            return Err("it refuses what it has acknowledged before: it is late, or that node has lost its disk");
        }
        let hint = if message.log_term > 0 {
            raft.raft_log.find_conflict_by_term(message.reject_hint, message.log_term).0
        } else {
            message.reject_hint
        };
        if hint < progress.matched {
            message.reject_hint = progress.matched;
            message.log_term = 0;
        }
        Ok(())
    }
}
