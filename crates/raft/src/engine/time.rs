//! Block time and the clocks of the voters.
//!
//! A voter acknowledges no block whose time is too far ahead of its own clock, see [`Engine::accept_time_until`]. With each
//! answer it says how far it goes. A leader gives its blocks no later time than a majority goes, so a wrong clock of its own
//! does no harm and leaves nothing in any log.
//!
//! A leader that does otherwise commits nothing. The voters that refuse a block of it take nothing from it for as long as two
//! elections need: so it hears of no majority, and another one is elected. They do not vote for it either while its log ends
//! with what they refuse. A block that is committed is taken in any case: then the clock of this node is the wrong one.

use super::Engine;
use crate::message::{RaftKind, RaftMessage, WireEntry};
use ledger::block::Payload;
use ledger::members::Membership;
use ledger_base::mutation::{Mutation, active};
use ledger_storage::entry::EntryKind;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// How far block time may be ahead of the clock of a voter that acknowledges it, microseconds. The same in every network.
pub const TIME_AHEAD_MAX: u64 = 2_000_000;
/// So much below what a majority acknowledges a leader stays, microseconds: a clock may be set back a little meanwhile.
pub(super) const RESERVE: u64 = TIME_AHEAD_MAX / 2;
/// Nothing is taken from a leader whose block was refused for so many election timeouts. Others stand for election in
/// the second.
const PAUSE_TIMEOUTS: u64 = 2;

/// The knowledge of an engine about clocks.
#[derive(Debug)]
pub(super) struct Times {
    /// The latest block time that this node acknowledges now.
    accepts_until: u64,
    /// The same of the others, as they told this leader.
    told: BTreeMap<u64, u64>,
    /// The last block that was refused, by its leader.
    refused: BTreeMap<u64, Refused>,
}

/// A block that came too far ahead of its time.
#[derive(Clone, Copy, Debug)]
struct Refused {
    height: u64,
    term: u64,
    /// The term of the leader that sent it.
    led: u64,
    time: u64,
    /// Until then nothing is taken from that leader, in ticks.
    until: u64,
}

impl Refused {
    /// Does a log that ends so hold the block?
    fn is_in_log(&self, last_term: u64, last: u64) -> bool {
        last >= self.height && (self.term..=self.led).contains(&last_term)
    }
}

impl Times {
    pub(super) fn new() -> Self {
        Self { accepts_until: u64::MAX, told: BTreeMap::new(), refused: BTreeMap::new() }
    }

    /// This node leads from now on: what others said to an earlier leader is old.
    pub(super) fn begin_term(&mut self) {
        self.told.clear();
    }

    /// Forgets nodes that are no members any more.
    pub(super) fn keep(&mut self, members: &Membership) {
        self.told.retain(|node, _| members.contains(*node));
        self.refused.retain(|node, _| members.contains(*node));
    }

    /// Says with an answer how far this node goes.
    pub(super) fn attach(&self, message: &mut RaftMessage) {
        if is_answer(message) {
            message.accepts_until = self.accepts_until;
        }
    }

    /// The latest block time that a majority acknowledges. A voter that has said nothing, or is silent now, acknowledges
    /// nothing: a block that needs its word would not be committed without it.
    fn of_majority(&self, me: u64, voters: &BTreeSet<u64>, is_active: impl Fn(u64) -> bool) -> u64 {
        let of = |voter: &u64| match *voter == me {
            true => self.accepts_until,
            false => self.told.get(voter).copied().filter(|_| is_active(*voter)).unwrap_or(0),
        };
        let mut limits: Vec<u64> = voters.iter().map(of).collect();
        limits.sort_unstable_by_key(|limit| Reverse(*limit));
        limits.get(limits.len() / 2).copied().unwrap_or(u64::MAX)
    }
}

impl Engine {
    /// From now on a voter acknowledges no block of a later time, microseconds since the UNIX epoch. The driver gives
    /// [`TIME_AHEAD_MAX`] ahead of its clock, or block time as it goes on where that is further ahead.
    pub fn accept_time_until(&mut self, latest: u64) {
        self.times.accepts_until = if active(Mutation::AcknowledgeAnyTime) { u64::MAX } else { latest };
    }

    /// The time that a leader gives a block now, where its own clock shows `now`.
    pub fn block_time(&self, now: u64) -> u64 {
        if active(Mutation::OrderByOneClock) {
            return now.max(self.last_time);
        }
        let of = |voters| self.times.of_majority(self.config.id, voters, |voter| self.is_active(voter));
        let latest = of(&self.membership.voters).min(of(&self.membership.outgoing));
        now.min(latest.saturating_sub(RESERVE)).max(self.last_time)
    }

    /// Why a message is not taken for the sake of block time. Entries that are too far ahead are cut off.
    pub(super) fn check_time(&mut self, from: u64, message: &mut RaftMessage) -> Result<(), &'static str> {
        match RaftKind::try_from(message.kind) {
            Ok(RaftKind::Append | RaftKind::Heartbeat) if self.is_voter() => self.check_times_of_leader(from, message),
            Ok(RaftKind::Vote | RaftKind::PreVote) => self.check_times_of_candidate(from, message),
            _ => {
                if is_answer(message) && message.term == self.raw.raft.term && self.membership.contains(from) {
                    self.times.told.insert(from, message.accepts_until);
                }
                Ok(())
            }
        }
    }

    fn check_times_of_leader(&mut self, from: u64, message: &mut RaftMessage) -> Result<(), &'static str> {
        let rests = self.times.refused.get(&from).is_some_and(|refused| {
            refused.led == message.term && message.commit < refused.height && self.ticks < refused.until
        });
        if rests {
            return Err("it leads with block time that is too far ahead of this node's clock");
        }
        let Some((place, entry, time)) = self.first_ahead(message) else { return Ok(()) };
        let pause = PAUSE_TIMEOUTS * self.config.election_tick as u64;
        let refused =
            Refused { height: entry.index, term: entry.term, led: message.term, time, until: self.ticks + pause };
        tracing::warn!(
            leader = from,
            height = refused.height,
            ahead_us = time - self.times.accepts_until,
            "a block comes before its time by more than the network allows: this clock is wrong, or the leader's"
        );
        self.times.refused.insert(from, refused);
        message.entries.truncate(place);
        match place {
            0 => Err("its block time is too far ahead of this node's clock"),
            _ => Ok(()),
        }
    }

    /// The first entry of a leader that a voter must refuse: nobody has committed it, and it is not in the log.
    fn first_ahead<'a>(&self, message: &'a RaftMessage) -> Option<(usize, &'a WireEntry, u64)> {
        let log = &self.raw.raft.raft_log;
        if message.term < self.raw.raft.term {
            return None;
        }
        let timed = message.entries.iter().enumerate().map(|(place, entry)| (place, entry, time_of(entry)));
        let mut ahead =
            timed.filter(|(_, entry, time)| entry.index > message.commit && *time > self.times.accepts_until);
        ahead.find(|(_, entry, _)| !log.match_term(entry.index, entry.term))
    }

    fn check_times_of_candidate(&self, from: u64, message: &RaftMessage) -> Result<(), &'static str> {
        let held = self.times.refused.get(&from).filter(|refused| refused.is_in_log(message.log_term, message.index));
        match held.is_some_and(|refused| refused.time > self.times.accepts_until) {
            true => Err("its log ends with block time that is too far ahead of this node's clock"),
            false => Ok(()),
        }
    }
}

/// Does the message answer a leader?
fn is_answer(message: &RaftMessage) -> bool {
    [RaftKind::AppendResponse, RaftKind::HeartbeatResponse].map(i32::from).contains(&message.kind)
}

/// The time of a block; 0 where it has none.
pub(super) fn time_of(entry: &WireEntry) -> u64 {
    if entry.kind != u32::from(EntryKind::Normal.code()) {
        return 0;
    }
    Payload::from_bytes(entry.data.clone()).map_or(0, |payload| payload.time)
}
