//! Mandates: a leader shows that a majority of the voters has elected it, before anybody follows it in a new term.
//!
//! ```text
//! vote             the voter signs term, candidate and itself, once its vote is on its disk
//! vote_response    the candidate checks the signature, and only then counts the vote
//! mandate          the winner shows the signed votes to every member before its first append of the term
//! append           taken from a leader whose mandate for this very term was checked
//! wanted           a member that lacks the mandate asks for it: messages are lost, and nobody keeps it over a start
//! ```
//! **Which voters count.** Those that Raft counts: a majority of the voters, and of the outgoing ones while they change. A
//! node knows the voters as of the last block that it handed out, and each set that a change in its log leads to. A
//! leader that was elected by other voters is not believed. Either the node lags, and asks its peers for blocks. Or the
//! voters have changed since the election. Then the leader notices with the next question for its mandate that it does not
//! suffice any more, and stands for election again.
//!
//! **Costs.** Signatures are made and checked in elections only. In a settled term a message costs a comparison.
//! A node that shows something wrong is not heard again about that until the next heartbeat is due.

use super::Engine;
use crate::interface::{Output, VotedTwice};
use crate::message::{Mandate, MandateWanted, PeerMessage, RaftKind, RaftMessage, SignedVote};
use bytes::Bytes;
use ledger::members::Membership;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use raft::StateRole;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A vote in an election.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ballot {
    /// The term.
    pub term: u64,
    /// The node that is to lead in it.
    pub candidate: u64,
    /// The node that says so.
    pub voter: u64,
}

/// A leader hands its leadership over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Handover {
    /// The term of the leader.
    pub term: u64,
    /// The leader, which says so.
    pub leader: u64,
    /// The voter that is to lead next.
    pub to: u64,
}

/// The log of a leader up to a height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogHead {
    /// The term of the leader.
    pub term: u64,
    /// The leader, which says so.
    pub leader: u64,
    /// Height of the last entry.
    pub height: u64,
    /// Hash of the chain up to it.
    pub hash: Hash,
}

/// A voter complains about its leader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grievance {
    /// The term of the leader.
    pub term: u64,
    /// The leader.
    pub leader: u64,
    /// The voter, which says so.
    pub voter: u64,
}

/// The key of this node for votes, transfers, heads and complaints, and how those of others are checked.
pub trait Ballots: Send + Sync {
    /// Signs a vote of this node.
    ///
    /// # Errors
    /// If the system's randomness fails.
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection>;

    /// Has the voter signed this vote? `now` is the time at which its certificate must be valid, microseconds since the UNIX
    /// epoch.
    ///
    /// # Errors
    /// The reason why this is not its vote.
    fn check(&self, ballot: Ballot, signed: &[u8], now: u64) -> Result<(), Rejection>;

    /// Signs that this leader hands over.
    ///
    /// # Errors
    /// As [`Ballots::sign`].
    fn sign_handover(&self, handover: Handover) -> Result<Bytes, Rejection>;

    /// Has the leader signed that it hands over? `now` as for [`Ballots::check`].
    ///
    /// # Errors
    /// The reason why it has not.
    fn check_handover(&self, handover: Handover, signed: &[u8], now: u64) -> Result<(), Rejection>;

    /// Signs the head of this leader's log: the certificate, which votes that are signed now have, too, and the signature.
    ///
    /// # Errors
    /// As [`Ballots::sign`].
    fn sign_head(&self, head: LogHead) -> Result<(Bytes, Bytes), Rejection>;

    /// Has the leader signed this head? `vote` is its vote for itself, signed by [`Ballots::sign`] with the same certificate; `now` as
    /// for [`Ballots::check`]. It is called for every append, so it must be quick for a vote that was seen before.
    ///
    /// # Errors
    /// The reason why it has not.
    fn check_head(&self, head: LogHead, vote: &[u8], signature: &[u8], now: u64) -> Result<(), Rejection>;

    /// Signs a complaint of this voter.
    ///
    /// # Errors
    /// As [`Ballots::sign`].
    fn sign_complaint(&self, grievance: Grievance) -> Result<Bytes, Rejection>;

    /// Has the voter signed this complaint? `now` as for [`Ballots::check`].
    ///
    /// # Errors
    /// The reason why it has not.
    fn check_complaint(&self, grievance: Grievance, signed: &[u8], now: u64) -> Result<(), Rejection>;

    /// Are these more voters than one hand has? Then their complaints depose a leader.
    fn complaints_suffice(&self, by: &BTreeSet<u64>) -> bool;
}

/// A leader that has shown its mandate.
struct Elected {
    term: u64,
    leader: u64,
    /// The nodes whose votes it showed, and the votes.
    by: BTreeMap<u64, Bytes>,
}

/// When something was last done for a node, in ticks.
#[derive(Default)]
pub(super) struct Rests(BTreeMap<u64, u64>);

impl Rests {
    /// Less than `pause` has gone by since. Older moments are forgotten.
    pub(super) fn rests(&mut self, node: u64, now: u64, pause: usize) -> bool {
        self.0.retain(|_, at| now - *at < pause as u64);
        self.0.contains_key(&node)
    }

    pub(super) fn begin(&mut self, node: u64, now: u64) {
        self.0.insert(node, now);
    }

    pub(super) fn end(&mut self, node: u64) {
        self.0.remove(&node);
    }
}

/// Votes that this node was given, and the mandates of others.
pub(super) struct Mandates {
    ballots: Arc<dyn Ballots>,
    /// The term in which this node stood for election last.
    term: u64,
    /// The signed votes for this node in that term.
    votes: BTreeMap<u64, Bytes>,
    /// The leader of the newest term of which a mandate was checked.
    elected: Option<Elected>,
    /// Nodes that have shown something that was not believed.
    doubted: Rests,
    /// Nodes that were asked for their mandate.
    asked: Rests,
    /// Nodes that were shown this node's mandate because they asked.
    shown: Rests,
    /// Nodes that have lied, by proof.
    excluded: BTreeSet<u64>,
}

impl Mandates {
    pub(super) fn new(ballots: Arc<dyn Ballots>) -> Self {
        let (doubted, asked, shown) = (Rests::default(), Rests::default(), Rests::default());
        let excluded = BTreeSet::new();
        Self { ballots, term: 0, votes: BTreeMap::new(), elected: None, doubted, asked, shown, excluded }
    }

    /// Takes nothing more from these nodes that a leader or a candidate sends.
    pub(super) fn exclude(&mut self, nodes: BTreeSet<u64>) {
        self.elected.take_if(|elected| nodes.contains(&elected.leader));
        self.excluded = nodes;
    }

    /// The nodes of which nothing is followed any more.
    pub(super) fn excluded(&self) -> &BTreeSet<u64> {
        &self.excluded
    }

    /// Is this a message of a leader or a candidate that has lied? Its acknowledgements and its votes for others still count:
    /// they are about what others have signed.
    pub(super) fn excludes(&self, from: u64, message: &PeerMessage) -> bool {
        if !self.excluded.contains(&from) {
            return false;
        }
        match message {
            PeerMessage::Raft(message) => RaftKind::try_from(message.kind).is_ok_and(|kind| {
                use RaftKind::{Append, Heartbeat, PreVote, ReadIndexResponse, TimeoutNow, Vote};
                matches!(kind, Append | Heartbeat | Vote | PreVote | TimeoutNow | ReadIndexResponse)
            }),
            PeerMessage::Mandate(_) | PeerMessage::Behind(_) | PeerMessage::Returned(_) => true,
            _ => false,
        }
    }

    /// Has the node shown a mandate for this very term?
    pub(super) fn is_elected(&self, node: u64, term: u64) -> bool {
        self.elected.as_ref().is_some_and(|elected| (elected.leader, elected.term) == (node, term))
    }

    /// Signs and checks.
    pub(super) fn ballots(&self) -> &dyn Ballots {
        &*self.ballots
    }

    /// The vote of a leader for itself, if its mandate for this term has it.
    pub(super) fn vote_of_leader(&self, leader: u64, term: u64) -> Option<Bytes> {
        let elected = self.elected.as_ref().filter(|elected| (elected.leader, elected.term) == (leader, term));
        elected?.by.get(&leader).cloned()
    }

    /// A node has shown something that is not believed.
    pub(super) fn doubt(&mut self, node: u64, now: u64) {
        self.doubted.begin(node, now);
    }

    /// Signs the vote in an answer to a candidate. It is on the disk: answers wait for that.
    pub(super) fn attach(&self, voter: u64, candidate: u64, message: &mut RaftMessage) {
        if message.kind != i32::from(RaftKind::VoteResponse) || message.reject {
            return;
        }
        match self.ballots.sign(Ballot { term: message.term, candidate, voter }) {
            Ok(signed) => message.vote = signed,
            Err(reason) => {
                tracing::warn!(code = reason.code.name(), %reason, candidate, "vote not signed; ignoring it")
            }
        }
    }

    fn keep_vote(&mut self, term: u64, voter: u64, signed: Bytes) {
        if self.term != term {
            (self.term, self.votes) = (term, BTreeMap::new());
        }
        self.votes.insert(voter, signed);
    }

    fn mandate(&self) -> Mandate {
        let votes = self.votes.iter().map(|(node, signed)| SignedVote { node: *node, signed: signed.clone() });
        Mandate { term: self.term, votes: votes.collect() }
    }

    /// The vote of this voter in this term for another candidate, if this node has seen one: it stood for election itself as
    /// `me`, or another was elected.
    fn other_vote(&self, me: u64, ballot: Ballot) -> Option<(Ballot, &Bytes)> {
        let own = Some((self.term, me, &self.votes));
        let elected = self.elected.as_ref().map(|elected| (elected.term, elected.leader, &elected.by));
        own.into_iter().chain(elected).find_map(|(term, candidate, votes)| {
            let is_other = term == ballot.term && candidate != ballot.candidate;
            votes.get(&ballot.voter).filter(|_| is_other).map(|vote| (Ballot { candidate, ..ballot }, vote))
        })
    }
}

/// Do these nodes elect, as Raft counts?
fn elect(voters: &BTreeSet<u64>, members: &Membership) -> bool {
    let most = |of: &BTreeSet<u64>| of.intersection(voters).count() * 2 > of.len();
    most(&members.voters) && (members.outgoing.is_empty() || most(&members.outgoing))
}

impl Engine {
    /// Takes the signature from a vote for this node. One without it is not counted: the leader that it elects would have
    /// nothing to show.
    pub(super) fn take_vote(
        &mut self,
        voter: u64,
        message: &RaftMessage,
        out: &mut Vec<Output>,
    ) -> Result<(), &'static str> {
        let (me, term) = (self.config.id, self.raw.raft.term);
        let counts = matches!(self.raw.raft.state, StateRole::Candidate | StateRole::Leader) && message.term == term;
        if message.reject || !counts || (self.mandates.term == term && self.mandates.votes.contains_key(&voter)) {
            return Ok(());
        }
        self.hear_proof(voter)?;
        let ballot = Ballot { term, candidate: me, voter };
        match self.mandates.ballots.check(ballot, &message.vote, self.now) {
            Ok(()) => {
                self.mandates.keep_vote(term, voter, message.vote.clone());
                self.report_double_vote(ballot, &message.vote, out);
                Ok(())
            }
            Err(reason) => {
                tracing::warn!(voter, term, code = reason.code.name(), %reason, "vote for this node rejected");
                self.mandates.doubted.begin(voter, self.ticks);
                Err("it votes for this node without its signature")
            }
        }
    }

    /// A node that has shown something that was not believed rests for a while: checking costs time.
    pub(super) fn hear_proof(&mut self, from: u64) -> Result<(), &'static str> {
        match self.mandates.doubted.rests(from, self.ticks, self.config.heartbeat_tick) {
            true => Err("it has shown before what nobody believes"),
            false => Ok(()),
        }
    }

    /// This node is elected: it shows everybody its mandate, before the first append of the term.
    pub(super) fn show_mandate_to_all(&mut self, term: u64, out: &mut Vec<Output>) {
        let me = self.config.id;
        self.sign_own_vote(term);
        let mandate = self.mandates.mandate();
        for to in self.membership.nodes().into_iter().filter(|node| *node != me) {
            out.push(Output::Send { to, message: PeerMessage::Mandate(mandate.clone()) });
        }
    }

    /// Signs the vote of this leader for itself, with the certificate that it has now.
    fn sign_own_vote(&mut self, term: u64) {
        let me = self.config.id;
        match self.mandates.ballots.sign(Ballot { term, candidate: me, voter: me }) {
            Ok(signed) => self.mandates.keep_vote(term, me, signed),
            Err(reason) => tracing::warn!(code = reason.code.name(), %reason, "cannot sign the own vote"),
        }
    }

    /// A voter speaks as the leader of a term and has not shown its mandate: it is asked for it.
    pub(super) fn want_mandate(&mut self, of: u64, term: u64, out: &mut Vec<Output>) {
        if !self.mandates.asked.rests(of, self.ticks, self.config.heartbeat_tick) {
            self.mandates.asked.begin(of, self.ticks);
            out.push(Output::Send { to: of, message: PeerMessage::MandateWanted(MandateWanted { term }) });
        }
    }

    /// A member asks the leader for its mandate. One that does not suffice for the voters of today is of no use to it.
    pub(super) fn mandate_wanted(&mut self, by: u64, term: u64, out: &mut Vec<Output>) {
        if !self.is_leader() || self.raw.raft.term != term || !self.membership.contains(by) {
            return;
        }
        if self.mandates.shown.rests(by, self.ticks, self.config.heartbeat_tick) {
            return;
        }
        self.mandates.shown.begin(by, self.ticks);
        let voters = self.mandates.votes.keys().copied().collect();
        if !elect(&voters, &self.membership) {
            tracing::info!(term, "voters changed since the election of this node; starting another election");
            return self.lead_again_after(term);
        }
        // Its certificate may be a new one.
        self.sign_own_vote(term);
        out.push(Output::Send { to: by, message: PeerMessage::Mandate(self.mandates.mandate()) });
    }

    /// A node shows its mandate.
    pub(super) fn mandate_shown(&mut self, by: u64, mandate: &Mandate, out: &mut Vec<Output>) {
        if mandate.term < self.raw.raft.term {
            return;
        }
        if self.mandates.is_elected(by, mandate.term) {
            return self.leader_renewed(by, mandate);
        }
        let checked = self.hear_proof(by).and_then(|()| self.check_mandate(by, mandate));
        if let Ok(Elected { term, leader, by }) = &checked {
            for (voter, vote) in by {
                self.report_double_vote(Ballot { term: *term, candidate: *leader, voter: *voter }, vote, out);
            }
        }
        match checked.and_then(|elected| self.only_leader_of_term(elected)) {
            Ok(elected) => self.mandates.elected = Some(elected),
            Err(reason) => out.push(Output::Ignored { from: by, reason }),
        }
    }

    /// The leader shows its mandate again: its vote for itself has the certificate that it signs with now.
    fn leader_renewed(&mut self, leader: u64, mandate: &Mandate) {
        let Some(vote) = mandate.votes.iter().find(|vote| vote.node == leader) else { return };
        let ballot = Ballot { term: mandate.term, candidate: leader, voter: leader };
        let is_known = self.mandates.vote_of_leader(leader, mandate.term).is_some_and(|known| known == vote.signed);
        if is_known || self.hear_proof(leader).is_err() {
            return;
        }
        match self.mandates.ballots.check(ballot, &vote.signed, self.now) {
            Ok(()) => {
                if let Some(elected) = &mut self.mandates.elected {
                    elected.by.insert(leader, vote.signed.clone());
                }
                self.heads.trust_again(leader);
            }
            Err(reason) => {
                tracing::warn!(leader, code = reason.code.name(), %reason, "certificate of the leader rejected");
                self.mandates.doubt(leader, self.ticks);
            }
        }
    }

    fn check_mandate(&mut self, leader: u64, mandate: &Mandate) -> Result<Elected, &'static str> {
        let term = mandate.term;
        let electorates = self.electorates();
        let votes = |node: u64| electorates.iter().any(|members| members.is_voter(node));
        let is_good = |vote: &&SignedVote| {
            if self.knows_vote(vote.node, leader, term) {
                return true;
            }
            let ballot = Ballot { term, candidate: leader, voter: vote.node };
            let checked = self.mandates.ballots.check(ballot, &vote.signed, self.now);
            checked
                .inspect_err(
                    |reason| tracing::debug!(leader, code = reason.code.name(), %reason, "vote in a mandate rejected"),
                )
                .is_ok()
        };
        let enough = |voters: &BTreeSet<u64>| electorates.iter().any(|members| elect(voters, members));
        // Counting is cheap, so it comes first.
        let claimed = mandate.votes.iter().map(|vote| vote.node).collect();
        let by: BTreeMap<_, _> = match votes(leader) && enough(&claimed) {
            true => {
                let good = mandate.votes.iter().filter(|vote| votes(vote.node)).filter(is_good);
                good.map(|vote| (vote.node, vote.signed.clone())).collect()
            }
            false => BTreeMap::new(),
        };
        if enough(&by.keys().copied().collect()) {
            return Ok(Elected { term, leader, by });
        }
        self.mandates.doubted.begin(leader, self.ticks);
        self.stranger_leads = true;
        Err("the voters that this node knows have not elected it")
    }

    /// Does this node know of the vote without its signature? Its own one, and the leader's for itself: its connection says
    /// so. After a restart it may not know yet whose certificates to believe, and among three voters these two elect.
    fn knows_vote(&self, voter: u64, leader: u64, term: u64) -> bool {
        let raft = &self.raw.raft;
        voter == leader || (voter == self.config.id && (raft.term, raft.vote) == (term, leader))
    }

    /// A voter that has signed two votes in one term has lied. Some votes are believed without their signature; those prove
    /// nothing.
    fn report_double_vote(&self, ballot: Ballot, signed: &Bytes, out: &mut Vec<Output>) {
        let Some((other, before)) = self.mandates.other_vote(self.config.id, ballot) else { return };
        let is_signed = |(ballot, signed)| self.mandates.ballots.check(ballot, signed, self.now).is_ok();
        let Ballot { term, voter, candidate } = ballot;
        if is_signed((ballot, signed)) && is_signed((other, before)) {
            let votes = [(other.candidate, before.clone()), (candidate, signed.clone())];
            out.push(Output::VotedTwice(Box::new(VotedTwice { term, voter, votes })));
        }
    }

    /// The first leader of a term stays the only one: a second one was elected by voters that voted twice.
    fn only_leader_of_term(&mut self, found: Elected) -> Result<Elected, &'static str> {
        match &self.mandates.elected {
            Some(first) if first.term == found.term => {
                self.mandates.doubted.begin(found.leader, self.ticks);
                self.second_leads = true;
                Err("another node was elected in this term")
            }
            _ => Ok(found),
        }
    }

    /// The members that this node knows, then those that each change in its log leads to.
    pub(super) fn electorates(&self) -> Vec<Membership> {
        let mut electorates = vec![self.membership.clone()];
        for entry in self.waiting_changes() {
            electorates.extend(electorates.last().and_then(|members| members.after(&entry)));
        }
        electorates
    }
}
