//! Acknowledgements that tell the leader nothing are not sent.
//!
//! A leader tells of a commit with an append without entries, and the crate answers each of them with what it has acknowledged
//! already. With three voters that would be two more messages and two more wake-ups of the leader for every block. The answer is lost on it:
//! it counts an acknowledgement of the same block once.
//!
//! The first one may be lost. The leader sees that at the answer to its next heartbeat, and asks again with an append without entries. So one
//! that is repeated is kept back for less than the time between two heartbeats.

use raft::eraftpb::{Message, MessageType};

/// The newest acknowledgement that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Acknowledged {
    leader: u64,
    term: u64,
    index: u64,
    /// When, in ticks.
    at: u64,
}

impl Acknowledged {
    /// Nothing was acknowledged yet.
    pub(super) const NONE: Self = Self { leader: 0, term: 0, index: 0, at: 0 };

    /// Was the same said less than `pause` ticks before? If not, it is noted as said now. Messages of other kinds are never kept back.
    pub(super) fn repeats(&mut self, message: &Message, now: u64, pause: usize) -> bool {
        if message.get_msg_type() != MessageType::MsgAppendResponse || message.reject {
            return false;
        }
        let said = Self { leader: message.to, term: message.term, index: message.index, at: now };
        if (Self { at: now, ..*self }) == said && now - self.at < pause as u64 {
            return true;
        }
        *self = said;
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAUSE: usize = 5;

    fn acknowledgement(to: u64, term: u64, index: u64) -> Message {
        let mut message = Message::default();
        message.set_msg_type(MessageType::MsgAppendResponse);
        (message.to, message.term, message.index) = (to, term, index);
        message
    }

    #[test]
    fn what_was_acknowledged_is_said_once_between_two_heartbeats() {
        let mut acknowledged = Acknowledged::NONE;
        let mut sent = |message: &Message, now| !acknowledged.repeats(message, now, PAUSE);
        let block = acknowledgement(1, 3, 7);
        let said: Vec<u64> = (10..24).filter(|now| sent(&block, *now)).collect();
        assert_eq!(said, [10, 15, 20], "and again, as it may have been lost");
    }

    #[test]
    fn a_newer_block_another_term_and_another_leader_are_told_at_once() {
        let mut acknowledged = Acknowledged::NONE;
        for message in [(1, 3, 7), (1, 3, 8), (1, 4, 8), (2, 4, 8), (2, 4, 7)] {
            let (to, term, index) = message;
            assert!(!acknowledged.repeats(&acknowledgement(to, term, index), 10, PAUSE), "{message:?}");
        }
    }

    #[test]
    fn refusals_and_other_messages_are_never_kept_back() {
        let mut acknowledged = Acknowledged::NONE;
        let mut refusal = acknowledgement(1, 3, 7);
        refusal.reject = true;
        let mut answer = acknowledgement(1, 3, 7);
        answer.set_msg_type(MessageType::MsgHeartbeatResponse);
        for message in [&refusal, &refusal, &answer, &answer] {
            assert!(!acknowledged.repeats(message, 10, PAUSE));
        }
    }
}
