//! Complaints: a leader that orders other things and withholds control calls is deposed.
//!
//! ```text
//! complain      the node finds that the leader withholds a call (`ledger-replica`, `withheld.rs`)
//! complaint     the voter signs term, leader and itself, and sends that to all voters
//! deposed       complaints of more voters than the largest hand has, about the leader that this node follows
//! ```
//! A voter that counts enough of them takes nothing more from that leader for [`DEPOSED_TIMEOUTS`], and forgets it as its leader. So
//! campaigns are honoured although the leader lives, and the voter stands for election itself at its own timeout. The deposed leader
//! gets no vote for [`BAN_TIMEOUTS`], which doubles with each further deposition. An honest leader that counts them steps down.
//!
//! A voter in a later term cannot follow the leader, so it cannot complain. A liar that leads can bring it there, and ignore that its own
//! term is over. A voter that complains itself counts the campaign of such a voter as its complaint.
//!
//! One hand cannot complete the count. So one honest voter at least has found that the leader withholds something. If
//! no other node is elected in the meantime, the voters follow the deposed leader again: a bad leader is better than none.

use super::Engine;
use super::mandate::Grievance;
use super::status::Deposition;
use crate::interface::Output;
use crate::message::{PeerMessage, RaftKind, RaftMessage, SignedComplaint};
use bytes::Bytes;
use ledger_base::mutation::{Mutation, active};
use raft::INVALID_ID;
use std::collections::{BTreeMap, BTreeSet};

/// Nothing more is taken from a deposed leader for this number of the shortest election timeouts: two of the longest.
pub(super) const DEPOSED_TIMEOUTS: u64 = 4;
/// A deposed leader gets no vote for this number of election timeouts: ten seconds by default.
pub(super) const BAN_TIMEOUTS: u64 = 50;
/// Most doublings of that.
const DOUBLINGS_MAX: u32 = 6;
/// A deposition is forgotten after this number of election timeouts without another one: an hour by default.
pub(super) const FORGET_TIMEOUTS: u64 = 18_000;
/// The own complaint is sent once in this number of election timeouts, for as long as the leader withholds.
const REPEAT_TIMEOUTS: u64 = 2;

/// A leader that was deposed.
#[derive(Clone, Copy)]
struct Deposed {
    times: u32,
    /// In ticks.
    at: u64,
    /// By the clock that goes with inputs, microseconds.
    time: u64,
}

/// The complaints about the leader of this term, and the leaders that were deposed.
#[derive(Default)]
pub(super) struct Complaints {
    /// The term and the leader that the complaints are about.
    about: (u64, u64),
    by: BTreeSet<u64>,
    /// The own complaint, and when it was sent last, in ticks.
    own: Option<(Bytes, u64)>,
    deposed: BTreeMap<u64, Deposed>,
    /// All depositions since the start.
    total: u64,
}

impl Complaints {
    fn begin(&mut self, about: (u64, u64)) {
        if self.about != about {
            (self.about, self.by, self.own) = (about, BTreeSet::new(), None);
        }
    }

    fn depose(&mut self, leader: u64, (ticks, time): (u64, u64), timeout: u64) {
        self.by.clear();
        self.deposed.retain(|_, deposed| ticks - deposed.at < FORGET_TIMEOUTS * timeout);
        let times = self.deposed.get(&leader).map_or(0, |deposed| deposed.times) + 1;
        self.deposed.insert(leader, Deposed { times, at: ticks, time });
        self.total += 1;
    }

    /// Is nothing taken from this node that a leader sends?
    fn is_ignored(&self, node: u64, ticks: u64, timeout: u64) -> bool {
        self.deposed.get(&node).is_some_and(|deposed| ticks - deposed.at < DEPOSED_TIMEOUTS * timeout)
    }

    /// Does this node get no vote?
    fn is_banned(&self, node: u64, ticks: u64, timeout: u64) -> bool {
        let ban = |times: u32| (BAN_TIMEOUTS * timeout) << times.saturating_sub(1).min(DOUBLINGS_MAX);
        self.deposed.get(&node).is_some_and(|deposed| ticks - deposed.at < ban(deposed.times))
    }
}

impl Engine {
    /// This voter complains about its leader.
    pub(super) fn complain(&mut self, term: u64, leader: u64, out: &mut Vec<Output>) {
        let me = self.config.id;
        if !self.is_voter() || leader == me || !self.follows(term, leader) {
            return;
        }
        self.complaints.begin((term, leader));
        let pause = REPEAT_TIMEOUTS * self.timeout();
        if self.complaints.own.as_ref().is_some_and(|(_, sent)| self.ticks - sent < pause) {
            return;
        }
        let known = self.complaints.own.take().map(|(signed, _)| signed);
        let grievance = Grievance { term, leader, voter: me };
        let signed = match known.map_or_else(|| self.mandates.ballots().sign_complaint(grievance), Ok) {
            Ok(signed) => signed,
            Err(reason) => {
                return tracing::warn!(code = reason.code.name(), %reason, "cannot sign a complaint");
            }
        };
        tracing::warn!(
            term,
            leader,
            "the leader withholds a control call although it orders other things: this voter complains"
        );
        let message = PeerMessage::Complaint(SignedComplaint { term, leader, signed: signed.clone() });
        let voters = self.membership.nodes().into_iter().filter(|node| *node != me && self.membership.is_voter(*node));
        out.extend(voters.map(|to| Output::Send { to, message: message.clone() }));
        self.complaints.own = Some((signed, self.ticks));
        self.count_complaint(me, term, leader);
    }

    /// A voter complains about the leader.
    pub(super) fn complaint_shown(&mut self, from: u64, shown: &SignedComplaint, out: &mut Vec<Output>) {
        let SignedComplaint { term, leader, signed } = shown;
        if !self.is_voter() || !self.follows(*term, *leader) {
            return;
        }
        if !self.membership.is_voter(from) || from == *leader {
            return out.push(Output::Ignored { from, reason: "it complains and has no vote" });
        }
        self.complaints.begin((*term, *leader));
        if self.complaints.by.contains(&from) {
            return;
        }
        let grievance = Grievance { term: *term, leader: *leader, voter: from };
        let checked = self.hear_proof(from).and_then(|()| {
            self.mandates.ballots().check_complaint(grievance, signed, self.now).map_err(|reason| {
                tracing::warn!(from, code = reason.code.name(), %reason, "complaint rejected");
                self.mandates.doubt(from, self.ticks);
                "it complains without its signature"
            })
        });
        match checked {
            Ok(()) => self.count_complaint(from, *term, *leader),
            Err(reason) => out.push(Output::Ignored { from, reason }),
        }
    }

    /// A voter campaigns, in a term that is later than the next one: it does not follow the leader of this term any more. To a
    /// voter that complains itself, that is another complaint.
    pub(super) fn count_campaign(&mut self, from: u64, message: &RaftMessage) {
        let campaigns = [RaftKind::PreVote, RaftKind::Vote].into_iter().any(|kind| message.kind == i32::from(kind));
        let (term, leader) = (self.raw.raft.term, self.raw.raft.leader_id);
        let complains = self.complaints.own.is_some() && self.complaints.about == (term, leader);
        if campaigns && complains && message.term > term + 1 && from != leader && self.membership.is_voter(from) {
            self.count_complaint(from, term, leader);
        }
    }

    /// Is this the leader of the term that this node is in?
    fn follows(&self, term: u64, leader: u64) -> bool {
        self.raw.raft.term == term && self.raw.raft.leader_id == leader && leader != INVALID_ID
    }

    fn count_complaint(&mut self, by: u64, term: u64, leader: u64) {
        self.complaints.by.insert(by);
        let suffice = self.mandates.ballots().complaints_suffice(&self.complaints.by);
        if !suffice && !active(Mutation::BelieveOneComplaint) {
            return;
        }
        let by = self.complaints.by.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
        tracing::warn!(term, leader, by, "voters have deposed the leader: it withholds control calls");
        let (ticks, timeout) = (self.ticks, self.timeout());
        self.complaints.depose(leader, (ticks, self.now), timeout);
        self.raw.raft.become_follower(term, INVALID_ID);
    }

    /// Is this a message of a leader that was deposed, which is not taken now?
    pub(super) fn is_from_deposed(&self, from: u64, message: &PeerMessage) -> bool {
        let (ticks, timeout) = (self.ticks, self.timeout());
        let leads = |kind: RaftKind| {
            matches!(kind, RaftKind::Append | RaftKind::Heartbeat | RaftKind::TimeoutNow | RaftKind::ReadIndexResponse)
        };
        match message {
            PeerMessage::Raft(message) => RaftKind::try_from(message.kind).is_ok_and(|kind| match kind {
                RaftKind::Vote | RaftKind::PreVote => self.complaints.is_banned(from, ticks, timeout),
                kind => leads(kind) && self.complaints.is_ignored(from, ticks, timeout),
            }),
            PeerMessage::Mandate(mandate) => {
                mandate.term <= self.complaints.about.0 && self.complaints.is_ignored(from, ticks, timeout)
            }
            _ => false,
        }
    }

    /// All depositions since the start, and those that are not forgotten, in order of leader.
    pub(super) fn depositions(&self) -> (u64, Vec<Deposition>) {
        let (ticks, forget) = (self.ticks, FORGET_TIMEOUTS * self.timeout());
        let known = self.complaints.deposed.iter().filter(|(_, deposed)| ticks - deposed.at < forget);
        let recent = known.map(|(leader, Deposed { times, time, .. })| Deposition {
            leader: *leader,
            times: *times,
            time: *time,
        });
        (self.complaints.total, recent.collect())
    }

    /// This node was deposed, and no voter would elect it.
    pub(super) fn is_banned(&self) -> bool {
        self.complaints.is_banned(self.config.id, self.ticks, self.timeout())
    }

    fn timeout(&self) -> u64 {
        self.config.election_tick as u64
    }
}
