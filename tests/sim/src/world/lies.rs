//! Lies of a member that has no vote, about the ordering protocol.

use super::{Event, World};
use crate::coverage::Fault;
use bytes::Bytes;
use ledger::block::Payload;
use ledger_raft::{PeerMessage, RaftKind, RaftMessage, Status, Transactions, WireEntry};
use ledger_rejection::Code;

/// The name of a transfer of leadership in a request for a vote.
const TRANSFER: &[u8] = b"CampaignTransfer";

impl World {
    /// A learner says to a voter what only a leader or a voter may say.
    pub(super) fn lie(&mut self) {
        let members = self.newest_members();
        let running = |id: &&u64| self.nodes.get(id).is_some_and(|node| node.up.is_some() && !node.lost);
        let learners: Vec<u64> = members.learners.iter().filter(running).copied().collect();
        let voters: Vec<u64> = members.voters.iter().filter(running).copied().collect();
        let (liar, victim) = (self.random.faults.pick(&learners).copied(), self.random.faults.pick(&voters).copied());
        let (Some(liar), Some(victim)) = (liar, victim) else { return };
        let status = self.running(victim).and_then(|running| Some(running.replica.as_ref()?.status()));
        // A voter that does not know yet that this one has no vote any more may believe it.
        let Some(status) = status.filter(|status| status.membership.learners.contains(&liar)) else { return };
        self.coverage.fault(Fault::Lie);
        let message = self.made_up(&status);
        self.note(format_args!("n{liar} lies to n{victim}: {message:?}"));
        let link = (liar, victim);
        for at in self.links.send(self.now, link, &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Event::Deliver { from: liar, to: victim, bytes: message.to_bytes() });
        }
    }

    fn made_up(&mut self, status: &Status) -> PeerMessage {
        let random = &mut self.random.faults;
        let term = status.role.term.max(1) + random.below(3) * random.between(1, 1000);
        let raft = |kind: RaftKind| RaftMessage { kind: kind.into(), term, ..RaftMessage::default() };
        let later = term + 1;
        PeerMessage::Raft(match random.below(8) {
            0 => RaftMessage { commit: status.last + random.between(1, 1000), ..raft(RaftKind::Heartbeat) },
            1 => RaftMessage { commit: status.commit, term: later, ..raft(RaftKind::Heartbeat) },
            2 => {
                let time = random.below(1000);
                let data = Payload { time, transactions: vec![Bytes::from_static(b"made up")] }.to_bytes();
                let (index, commit) = (status.commit, status.commit + 1);
                let entry = WireEntry { index: commit, term: later, kind: 1, data };
                let log_term = self.term_of(status.id, index);
                RaftMessage { index, commit, log_term, entries: vec![entry], term: later, ..raft(RaftKind::Append) }
            }
            3 => RaftMessage { term: later, index: status.commit, ..raft(RaftKind::AppendResponse) },
            4 => {
                let context = Bytes::from_static(TRANSFER);
                RaftMessage { term: later, index: u64::MAX >> 2, log_term: later, context, ..raft(RaftKind::Vote) }
            }
            5 => raft(RaftKind::TimeoutNow),
            6 => raft(RaftKind::VoteResponse),
            _ => {
                let waiting = self.running(status.id).map(|running| running.waiters.all()).unwrap_or_default();
                let control = waiting.into_iter().map(|(_, transaction)| transaction).take(1).collect();
                let code = u32::from(Code::Revoked.number());
                return PeerMessage::Returned(Transactions { control, data: Vec::new(), code });
            }
        })
    }

    /// The term of a block in the log of a node.
    fn term_of(&mut self, id: u64, index: u64) -> u64 {
        let entry = self.running(id).and_then(|running| running.store.entry(index).ok().flatten());
        entry.map_or(0, |entry| entry.term)
    }
}
