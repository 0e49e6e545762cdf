//! Which messages are taken from whom.
//!
//! The `raft` crate believes every member everything. A learner on somebody's robot could depose a leader by naming a
//! later term, speak as a leader itself, or say that a transaction was not ordered. So each kind of message is taken from
//! those only who may send it:
//!
//! | message | taken from | with a later term |
//! |---|---|---|
//! | append, heartbeat | voters that show their mandate | yes |
//! | hand-over, answer to a read, *behind* | the leader of this term; a hand-over with its signature | no |
//! | head of a leader | members; checked only if it contradicts this log | |
//! | vote, pre-vote | voters | at most [`TERM_AHEAD_MAX`] ahead |
//! | answers to them | voters, by a candidate | at most [`TERM_AHEAD_MAX`] ahead |
//! | answers to append and heartbeat | members | by a leader, see below |
//! | *returned* transactions | the leader now, and the one before it | |
//! | reads, *forwarded* transactions | members | no term |
//!
//! A leader shows in addition that it was elected, see `engine/mandate.rs`: what it says in a term counts from then on.
//!
//! **The voters.** A node knows the voters as of the last block that it handed out. A change that waits in its log
//! counts as well, because a leader was allowed to append it. A node that lags further does not know a new voter yet. It
//! asks its peers for the blocks that it lacks ([`Engine::look_for_leader`]). It does the same if a leader shows a mandate that
//! its voters have not given. A learner does so sooner: it costs nobody an election.
//!
//! **Ends of terms.** A member that is stuck in a later term cannot follow the leader (Raft §5.1); one that was a voter
//! before may be such a one. The leader then stands for election again at once, in a term after that, and is elected by
//! those that follow it: a pause of one write. It is needed, and could be done without end. So each voter, and all learners
//! together, may do so once in [`REST_TIMEOUTS`] election timeouts. A transfer of leadership makes a voter stand for election in
//! spite of the leader's lease (thesis §3.10), with the leader's signed word only: see `engine/handover.rs`.

use super::Engine;
use crate::interface::Output;
use crate::message::{RaftKind, RaftMessage};
use ledger_base::mutation::{Mutation, active};
use ledger_storage::entry::Entry;
use raft::eraftpb::{Message, MessageType};
use raft::{INVALID_ID, StateRole};

/// How far the term of a vote may be ahead. Terms grow by one with an election that a majority did not refuse
/// beforehand, so no honest node is further ahead. A hostile voter needs centuries to use up all terms this way.
const TERM_AHEAD_MAX: u64 = 1 << 24;
/// A member may end a leader's term before its time once in so many election timeouts: ten seconds by default.
pub(super) const REST_TIMEOUTS: u64 = 50;
/// Stands for all learners together: no node has this number.
const LEARNERS: u64 = INVALID_ID;
/// A voter that hears unknown leaders, and no other, asks its peers for blocks after so many election timeouts.
pub(super) const LOOK_TIMEOUTS: usize = 10;
/// So does a learner after so many.
pub(super) const LEARNER_LOOK_TIMEOUTS: usize = 2;
/// Entries that are searched for changes of members.
const CHANGES_SCAN_MAX: u64 = 256;

/// Why a message is not taken.
#[derive(Debug)]
pub(super) enum Doubt {
    /// A voter speaks as the leader of a term and has not shown that it was elected.
    Unproven {
        /// That term.
        term: u64,
    },
    /// No honest peer sends it, or this node cannot take it now.
    Because(&'static str),
}

impl From<&'static str> for Doubt {
    fn from(reason: &'static str) -> Self {
        Self::Because(reason)
    }
}

fn doubt(reason: &'static str) -> Result<(), Doubt> {
    Err(reason.into())
}

impl Engine {
    /// Why this message is not taken from this peer. A claim in it that the sender may not make is taken out.
    pub(super) fn check_standing(
        &mut self,
        from: u64,
        message: &mut RaftMessage,
        out: &mut Vec<Output>,
    ) -> Result<(), Doubt> {
        let Ok(kind) = RaftKind::try_from(message.kind) else { return doubt("it is of an unknown kind") };
        if active(Mutation::BelieveAnybody) {
            return Ok(());
        }
        let (term, role) = (self.raw.raft.term, self.raw.raft.state);
        let is_later = message.term > term;
        match kind {
            // In a settled term this is all.
            RaftKind::Append | RaftKind::Heartbeat if self.mandates.is_elected(from, message.term) => Ok(()),
            RaftKind::Append | RaftKind::Heartbeat => self.may_lead(from, message.term),
            RaftKind::TimeoutNow | RaftKind::ReadIndexResponse => match self.is_leader_of(from, message.term) {
                true if kind == RaftKind::TimeoutNow => Ok(self.take_handover(from, message)?),
                true => Ok(()),
                false => doubt("only the leader of this term says that"),
            },
            RaftKind::Vote | RaftKind::PreVote => {
                self.may_vote(from)?;
                if message.term > term.saturating_add(TERM_AHEAD_MAX) {
                    return doubt("its term is further ahead than elections make it");
                }
                self.check_transfer(from, message);
                Ok(())
            }
            RaftKind::VoteResponse | RaftKind::PreVoteResponse => {
                self.may_vote(from)?;
                let asked = matches!(role, StateRole::Candidate | StateRole::PreCandidate);
                if is_later && (!asked || message.term > term.saturating_add(TERM_AHEAD_MAX)) {
                    return doubt("it answers with a later term to nobody who asked");
                }
                if kind == RaftKind::VoteResponse {
                    self.take_vote(from, message, out)?;
                }
                Ok(())
            }
            RaftKind::AppendResponse | RaftKind::HeartbeatResponse => {
                if !is_later {
                    return Ok(());
                }
                let stuck = role == StateRole::Leader
                    && self.membership.contains(from)
                    && message.term <= term.saturating_add(TERM_AHEAD_MAX);
                if stuck && self.may_end_term(from) {
                    self.lead_again_after(message.term);
                }
                doubt("it is in a later term, to which no vote has led")
            }
            RaftKind::ReadIndex => Ok(()),
            RaftKind::Unspecified => doubt("it is of an unknown kind"),
        }
    }

    /// Is this node the leader that is known in this very term?
    fn is_leader_of(&self, from: u64, term: u64) -> bool {
        self.raw.raft.term == term && self.leader() == Some(from)
    }

    /// May it say which transactions were not ordered?
    pub(super) fn took_transactions(&self, from: u64) -> bool {
        self.leader() == Some(from) || self.told.leader == Some(from) || self.leader_before == Some(from)
    }

    /// A leader is a voter that was elected. A node that cannot know whether this is one takes note.
    fn may_lead(&mut self, from: u64, term: u64) -> Result<(), Doubt> {
        let is_past = term < self.raw.raft.term;
        if self.may_vote(from).is_ok() {
            let proven = is_past || active(Mutation::FollowWithoutMandate);
            return if proven { Ok(()) } else { Err(Doubt::Unproven { term }) };
        }
        if is_past {
            return doubt("a node without a vote speaks as a leader of an earlier term");
        }
        self.stranger_leads = true;
        doubt("a node without a vote speaks as a leader")
    }

    fn may_vote(&self, from: u64) -> Result<(), &'static str> {
        let votes = self.membership.is_voter(from) || self.will_vote(from);
        if votes { Ok(()) } else { Err("it speaks as a voter, and has no vote") }
    }

    /// Does a change that waits in the log make this node a voter?
    fn will_vote(&self, node: u64) -> bool {
        self.electorates().iter().any(|members| members.is_voter(node))
    }

    /// Entries that wait in the log, and may change the members.
    pub(super) fn waiting_changes(&self) -> impl Iterator<Item = Entry> {
        let last = self.store.last_index();
        let first = (self.emitted + 1).max(last.saturating_sub(CHANGES_SCAN_MAX));
        (first..=last).filter_map(|index| self.store.entry(index).ok().flatten())
    }

    /// Campaigns for a term after this one: as the leader of a member that is stuck there, or so that the leader finds this node there.
    pub(super) fn lead_again_after(&mut self, term: u64) {
        self.raw.raft.become_follower(term, INVALID_ID);
        let mut stand = Message::default();
        stand.set_msg_type(MessageType::MsgTimeoutNow);
        (stand.from, stand.to, stand.term) = (self.config.id, self.config.id, term);
        if let Err(error) = self.raw.step(stand) {
            tracing::debug!(%error, "cannot start an election again");
        }
    }

    /// A member ends a leader's term before its time: not again for a while. The leader's own hand-over is free.
    fn may_end_term(&mut self, from: u64) -> bool {
        if self.raw.raft.lead_transferee == Some(from) {
            return true;
        }
        let from = if self.membership.is_voter(from) { from } else { LEARNERS };
        let rest = REST_TIMEOUTS * self.config.election_tick as u64;
        let rests = self.ended_terms.get(&from).is_some_and(|at| self.ticks - at < rest);
        if rests {
            return false;
        }
        let membership = &self.membership;
        self.ended_terms.retain(|node, _| *node == LEARNERS || membership.contains(*node));
        self.ended_terms.insert(from, self.ticks);
        true
    }

    /// With every tick: only nodes speak as leaders of which this node does not know that they vote, or whose heads it cannot
    /// check. Blocks that it lacks may say so, and its peers may have them.
    ///
    /// Where voters have elected two leaders of this term and the first one is gone, this node campaigns for the next term. The second
    /// leader finds it there and campaigns again.
    pub(super) fn look_for_leader(&mut self, out: &mut Vec<Output>) {
        let timeouts = if self.may_vote(self.config.id).is_ok() { LOOK_TIMEOUTS } else { LEARNER_LOOK_TIMEOUTS };
        let unchecked = self.heads.take_unchecked(self.ticks, timeouts * self.config.election_tick);
        if !unchecked && self.leaderless_ticks < timeouts * self.config.election_tick {
            return;
        }
        // Asked again after the same time.
        self.leaderless_ticks = 0;
        if std::mem::take(&mut self.second_leads) {
            self.lead_again_after(self.raw.raft.term);
        }
        if std::mem::take(&mut self.stranger_leads) || unchecked {
            let committed = self.raw.raft.raft_log.committed;
            out.push(Output::Behind { from: self.config.id, first_index: committed + 2 });
        }
    }
}
