//! Lies about the ordering protocol: of a member that has no vote, and of a voter that nobody has elected.

use super::{Event, World};
use crate::coverage::Fault;
use bytes::Bytes;
use ledger::block::Payload;
use ledger_base::rejection::Code;
use ledger_light::Vote;
use ledger_raft::{Mandate, PeerMessage, RaftKind, RaftMessage, SignedVote, Status, Transactions, WireEntry};

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
        // A voter that does not know yet that this one has no vote any more may believe it. So may one that does not know that
        // it votes itself: until then it is a learner.
        let Some(status) =
            status.filter(|status| status.membership.is_voter(victim) && status.membership.learners.contains(&liar))
        else {
            return;
        };
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

    /// A voter says to all that it leads: in a later term, or in the one of the leader that there is. It tells each member of
    /// another block.
    pub(super) fn pose(&mut self) {
        let members = self.newest_members().clone();
        let voters: Vec<u64> = members.voters.iter().copied().filter(|id| self.is_up(*id)).collect();
        let Some(liar) = self.random.faults.pick(&voters).copied() else { return };
        let others = members.nodes().into_iter().filter(|id| *id != liar);
        let heard: Vec<Status> = others.filter_map(|id| Some(self.running(id)?.replica.as_ref()?.status())).collect();
        // One that does not know that it votes may follow a stranger, as a learner.
        let victims: Vec<Status> = heard.into_iter().filter(|status| status.membership.is_voter(liar)).collect();
        let newest = victims.iter().map(|status| status.role.term).max().unwrap_or(0);
        let taken = self.invariants.election_safety.leader_of(newest).is_some_and(|leader| leader != liar);
        // No election reaches the later term before the lie arrives.
        let later = newest + self.random.faults.between(100, 1000);
        let term = if taken && self.random.faults.percent(30) { newest } else { later };
        for status in victims {
            self.coverage.fault(Fault::Pose);
            let mandate = self.made_up_mandate(liar, term);
            let append = self.made_up_block(&status, term);
            self.note(format_args!("n{liar} poses to n{} as the leader of term {term}", status.id));
            for message in [mandate, append] {
                for at in self.links.send(self.now, (liar, status.id), &mut self.random.network, &mut self.coverage) {
                    self.schedule_at(at, Event::Deliver { from: liar, to: status.id, bytes: message.to_bytes() });
                }
            }
        }
    }

    fn is_up(&self, id: u64) -> bool {
        self.nodes.get(&id).is_some_and(|node| node.up.is_some() && !node.lost)
    }

    /// A mandate that nobody gave: without votes, with the own vote alone or under all names, or with those of an election that was.
    fn made_up_mandate(&mut self, liar: u64, term: u64) -> PeerMessage {
        let node = self.people.node(liar, self.plan.organisations);
        let vote = Vote { network: self.network, recoveries: 0, term, candidate: liar, voter: liar };
        let own = vote.sign(node.certificate.clone(), &node.key).unwrap().to_bytes();
        let under = |nodes: Vec<u64>| nodes.into_iter().map(|node| SignedVote { node, signed: own.clone() }).collect();
        let votes = match self.random.faults.below(4) {
            0 => Vec::new(),
            1 => under(vec![liar]),
            2 => under(self.newest_members().voters.iter().copied().collect()),
            _ => self.old_votes.clone(),
        };
        PeerMessage::Mandate(Mandate { term, votes })
    }

    fn made_up_block(&mut self, status: &Status, term: u64) -> PeerMessage {
        let made_up = Bytes::copy_from_slice(&self.random.faults.number().to_be_bytes());
        let data = Payload { time: 1, transactions: vec![made_up] }.to_bytes();
        let (index, commit) = (status.commit, status.commit + 1);
        let entries = vec![WireEntry { index: commit, term, kind: 1, data }];
        let log_term = self.term_of(status.id, index);
        let kind = RaftKind::Append.into();
        PeerMessage::Raft(RaftMessage { kind, index, commit, log_term, entries, term, ..RaftMessage::default() })
    }

    /// The term of a block in the log of a node.
    fn term_of(&mut self, id: u64, index: u64) -> u64 {
        let entry = self.running(id).and_then(|running| running.store.entry(index).ok().flatten());
        entry.map_or(0, |entry| entry.term)
    }
}
