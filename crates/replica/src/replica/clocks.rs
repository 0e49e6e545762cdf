//! Block time and the clocks of the voters.
//!
//! Answers to a leader or a candidate carry the latest block time that their sender acknowledges now
//! ([`crate::Clock::accepts_until`]). A leader gives a block no later time than a majority of the voters takes, so a wrong clock of
//! its own does no harm. A voter acknowledges no block beyond its own limit, unless others have committed it, and takes
//! nothing from that leader for as long as an election takes. So a leader that lies about the time commits nothing, and
//! voters that hear nothing of a leader elect another one. A voter whose own clock is the wrong one follows the others with
//! such pauses.

use super::Now;
use crate::clock::going_on;
use bytes::Bytes;
use ledger::block::Payload;
use ledger::members::Membership;
use ledger_raft::{PeerMessage, RaftKind, RaftMessage};
use ledger_storage::entry::EntryKind;
use std::collections::{BTreeMap, BTreeSet};

/// The knowledge of a node about the clocks of the others.
#[derive(Clone, Debug, Default)]
pub(super) struct Clocks {
    /// The latest block time that a node acknowledges, and when it said so by this node's steady clock.
    heard: BTreeMap<u64, (u64, u64)>,
    /// A block of a leader that was refused.
    refused: Option<Refused>,
    /// How long nothing is taken from such a leader, microseconds.
    pause: u64,
}

#[derive(Clone, Copy, Debug)]
struct Refused {
    term: u64,
    height: u64,
    /// By the steady clock.
    until: u64,
}

impl Clocks {
    /// `election_time`: a voter that hears nothing of a leader for so long stands for election, microseconds.
    pub(super) fn new(election_time: u64) -> Self {
        Self { pause: election_time.saturating_mul(2), ..Self::default() }
    }

    /// Puts this node's limit into an answer.
    pub(super) fn attach(now: Now, message: &mut PeerMessage) {
        if let PeerMessage::Raft(message) = message
            && is_answer(message)
        {
            message.accepts_until = now.accepts_until;
        }
    }

    /// Takes note of the limit of another node.
    pub(super) fn hear(&mut self, now: Now, from: u64, message: &RaftMessage) {
        if is_answer(message) && message.accepts_until > 0 {
            self.heard.insert(from, (message.accepts_until, now.elapsed));
        }
    }

    /// Forgets nodes that are no members any more.
    pub(super) fn keep(&mut self, members: &Membership) {
        self.heard.retain(|node, _| members.contains(*node));
    }

    /// The latest block time that a majority acknowledges now, as far as this node knows.
    pub(super) fn latest(&self, me: u64, members: &Membership, now: Now) -> u64 {
        let of = |voters: &BTreeSet<u64>| {
            let known = voters.iter().map(|voter| match self.heard.get(voter) {
                _ if *voter == me => now.accepts_until,
                Some((until, heard)) => until.saturating_add(going_on(now.elapsed.saturating_sub(*heard))),
                None => now.clock,
            });
            let mut limits: Vec<u64> = known.collect();
            limits.sort_unstable_by_key(|limit| std::cmp::Reverse(*limit));
            limits.get(limits.len() / 2).copied().unwrap_or(u64::MAX)
        };
        of(&members.voters).min(of(&members.outgoing))
    }

    /// Does a voter refuse this message of a leader?
    pub(super) fn refuse(&mut self, now: Now, message: &RaftMessage) -> bool {
        let (term, commit) = (message.term, message.commit);
        if !matches!(message.kind(), RaftKind::Append | RaftKind::Heartbeat) {
            return false;
        }
        self.refused = self.refused.filter(|refused| {
            now.elapsed < refused.until && (term < refused.term || (term == refused.term && commit < refused.height))
        });
        let blocks = message.entries.iter().filter(|entry| entry.index > commit);
        let mut blocks = blocks.filter(|entry| entry.kind == u32::from(EntryKind::Normal.code()));
        let time = |data: &Bytes| Payload::from_bytes(data.clone()).map_or(0, |payload| payload.time);
        if let Some(ahead) = blocks.find(|entry| time(&entry.data) > now.accepts_until) {
            let until = self.refused.map_or(now.elapsed + self.pause, |refused| refused.until);
            self.refused = Some(Refused { term, height: ahead.index, until });
        }
        self.refused.is_some_and(|refused| refused.term == term)
    }
}

/// Is it an answer to a leader or a candidate?
fn is_answer(message: &RaftMessage) -> bool {
    use RaftKind::{AppendResponse, HeartbeatResponse, PreVoteResponse, VoteResponse};
    matches!(message.kind(), AppendResponse | HeartbeatResponse | PreVoteResponse | VoteResponse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_raft::WireEntry;

    const SECOND: u64 = 1_000_000;

    fn now(wall: u64) -> Now {
        Now { clock: wall, elapsed: 0, accepts_until: wall + crate::clock::AHEAD_MAX }
    }

    fn answer(until: u64) -> RaftMessage {
        RaftMessage { kind: RaftKind::AppendResponse.into(), term: 1, accepts_until: until, ..RaftMessage::default() }
    }

    fn append(term: u64, commit: u64, blocks: &[(u64, u64)]) -> RaftMessage {
        let entry = |(index, time): &(u64, u64)| {
            let data = Payload { time: *time, transactions: Vec::new() }.to_bytes();
            WireEntry { index: *index, term, kind: 1, data }
        };
        let entries = blocks.iter().map(entry).collect();
        RaftMessage { kind: RaftKind::Append.into(), term, commit, entries, ..RaftMessage::default() }
    }

    #[test]
    fn a_leader_keeps_to_the_clocks_of_a_majority() {
        let (members, mut clocks) = (Membership::new([1, 2, 3], []), Clocks::default());
        let ahead = now(1_000 * SECOND);
        clocks.hear(ahead, 2, &answer(12 * SECOND));
        clocks.hear(ahead, 3, &answer(14 * SECOND));
        assert_eq!(clocks.latest(1, &members, ahead), 14 * SECOND, "itself and node 3");
        let later = Now { elapsed: 16 * SECOND, ..ahead };
        assert_eq!(clocks.latest(1, &members, later), 29 * SECOND, "their clocks go on");
        let behind = now(SECOND);
        assert_eq!(clocks.latest(1, &members, behind), 12 * SECOND, "nodes 2 and 3");
        assert_eq!(clocks.latest(1, &Membership::new([1], [2]), ahead), ahead.accepts_until, "nobody else votes");
        clocks.keep(&Membership::new([1, 3], []));
        assert_eq!(clocks.heard.len(), 1);
    }

    #[test]
    fn in_a_joint_configuration_both_majorities_count() {
        let (mut members, mut clocks) = (Membership::new([1, 2], []), Clocks::default());
        members.outgoing = [3, 4].into();
        for (node, until) in [(2, 20), (3, 10), (4, 30)] {
            clocks.hear(now(0), node, &answer(until * SECOND));
        }
        assert_eq!(clocks.latest(1, &members, now(100 * SECOND)), 10 * SECOND);
    }

    #[test]
    fn a_voter_refuses_a_block_that_is_too_far_ahead_and_that_leader_while_another_may_be_elected() {
        let (mut clocks, now) = (Clocks::new(SECOND), now(100 * SECOND));
        assert!(!clocks.refuse(now, &append(1, 4, &[(5, 102 * SECOND)])), "at the bound");
        assert!(clocks.refuse(now, &append(1, 4, &[(5, 102 * SECOND + 1)])));
        let heartbeat = |term| RaftMessage { kind: RaftKind::Heartbeat.into(), ..append(term, 4, &[]) };
        assert!(clocks.refuse(now, &heartbeat(1)), "it leads nobody any more");
        assert!(!clocks.refuse(now, &answer(5)), "other messages pass");
        assert!(!clocks.clone().refuse(now, &heartbeat(2)), "another term");
        let later = |elapsed| Now { elapsed, ..now };
        assert!(clocks.refuse(later(2 * SECOND - 1), &heartbeat(1)));
        assert!(
            !clocks.refuse(later(2 * SECOND), &heartbeat(1)),
            "nobody else was elected: the own clock may be wrong"
        );
        assert!(clocks.refuse(later(2 * SECOND), &append(1, 4, &[(5, 103 * SECOND)])), "the block is refused again");
    }

    #[test]
    fn a_block_that_others_have_committed_is_taken_whatever_the_own_clock_shows() {
        let (mut clocks, now) = (Clocks::new(SECOND), now(100 * SECOND));
        assert!(clocks.refuse(now, &append(1, 4, &[(5, 200 * SECOND)])));
        assert!(!clocks.refuse(now, &append(1, 5, &[(5, 200 * SECOND)])), "the own clock is the wrong one");
        assert!(clocks.refuse(now, &append(1, 5, &[(6, 201 * SECOND)])), "the next is refused again");
    }
}
