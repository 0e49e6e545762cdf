//! The hash of the chain up to each entry of the log, and what is taken from a node whose chain is another.
//!
//! Raft compares index and term. That suffices as long as no leader lies. A lying one gives two followers different entries of one
//! index and term, and each would append later entries to its own. So entries are compared by the hash of the chain up to them:
//!
//! ```text
//! append        names the hash up to the entry before its first
//! follower      appends only if its own log has that hash there; otherwise it reports a contradiction
//! response      names the hash up to the last entry that it acknowledges
//! leader        counts an acknowledgement of the hash of its own log only
//! ```
//! The hash is that of the block ([`Header::following`]), which needs no execution. So it can be compared with statements of
//! voters, with quorum certificates, and with the chain of every other node.
//!
//! **Costs.** The content of each entry is hashed once more than execution does. The hashes of the end of the log stay in memory.
//! Those before are in the results of executed blocks ([`ExecutedBlocks`]).

use super::mandate::Rests;
use super::{Engine, EngineError, READ_BYTES};
use crate::interface::{Contradiction, Output};
use crate::message::{RaftKind, RaftMessage, WireEntry};
use ledger::block::Header;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_light::BranchLink;
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::{Entry, EntryKind};
use raft::eraftpb::{Message, MessageType};
use std::collections::VecDeque;
use std::sync::Arc;

/// Links of executed blocks that stay in memory: followers that lag a little need no disk.
const LINKS_KEPT: usize = 4096;

/// The contradiction of a node is reported once in this number of election timeouts: a second by default.
const REPORT_TIMEOUTS: usize = 5;

/// The end of a chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    /// Hash of the block.
    pub hash: Hash,
    /// Block time, microseconds since the UNIX epoch. The hash of the next block depends on it.
    pub time: u64,
}

impl Link {
    /// The link that an entry adds.
    fn followed_by(self, entry: &Entry) -> Self {
        self.header(entry).0
    }

    fn header(self, entry: &Entry) -> (Self, BranchLink) {
        let header = Header::following(self.hash, self.time, entry);
        let Header { term, time, root, .. } = header;
        (Self { hash: header.hash(), time }, BranchLink { term, time, root })
    }
}

/// The blocks that this node has executed.
pub trait ExecutedBlocks: Send + Sync {
    /// The link of the block at a height; the genesis block has height 0. `None` if it was not executed, or was dropped. The
    /// newest executed block, and the one before the first of the log, are always known.
    fn link(&self, height: u64) -> Option<Link>;
}

/// The links of the log.
pub(super) struct Chain {
    executed: Arc<dyn ExecutedBlocks>,
    /// Height of the first one in `links`.
    first: u64,
    /// Up to the end of the log; never empty.
    links: VecDeque<Link>,
    /// Links of the message that is being taken, so that no entry is hashed twice: height, term, link.
    arriving: Vec<(u64, u64, Link)>,
    /// Nodes whose contradiction was reported lately.
    reported: Rests,
}

impl Chain {
    /// The chain of a log whose blocks up to `applied` are executed.
    pub(super) fn start(
        executed: Arc<dyn ExecutedBlocks>,
        store: &BlockStore,
        applied: u64,
    ) -> Result<Self, EngineError> {
        let base = executed.link(applied).ok_or(EngineError::NoHash { height: applied })?;
        let mut chain = Self {
            executed,
            first: applied,
            links: VecDeque::from([base]),
            arriving: Vec::new(),
            reported: Rests::default(),
        };
        let (mut next, last) = (applied + 1, store.last_index());
        while next <= last {
            let unreadable = |error: String| EngineError::Log { height: next, error };
            let entries = store.entries(next..last + 1, READ_BYTES).map_err(|error| unreadable(error.to_string()))?;
            if entries.first().is_none_or(|entry| entry.index != next) {
                return Err(unreadable("the entry is missing".to_owned()));
            }
            entries.iter().for_each(|entry| chain.append(entry));
            next += entries.len() as u64;
        }
        Ok(chain)
    }

    /// The link of an entry of the log, or of an executed block; `None` if it is neither, or not known any more.
    pub(super) fn link(&self, height: u64) -> Option<Link> {
        match height.checked_sub(self.first) {
            Some(place) => self.links.get(usize::try_from(place).ok()?).copied(),
            None => self.executed.link(height),
        }
    }

    /// The hash of the chain up to an entry.
    pub(super) fn hash(&self, height: u64) -> Option<Hash> {
        self.link(height).map(|link| link.hash)
    }

    /// An entry was appended to the log. It supersedes what was there from its index on.
    pub(super) fn append(&mut self, entry: &Entry) {
        let Some(kept) = entry.index.checked_sub(self.first).and_then(|kept| usize::try_from(kept).ok()) else {
            return;
        };
        let Some(before) = kept.checked_sub(1).and_then(|place| self.links.get(place)).copied() else { return };
        let place = self.arriving.first().and_then(|(first, ..)| entry.index.checked_sub(*first));
        let arrived = place.and_then(|place| self.arriving.get(usize::try_from(place).ok()?));
        let arrived = arrived.filter(|(height, term, _)| (*height, *term) == (entry.index, entry.term));
        let link = arrived.map_or_else(|| before.followed_by(entry), |(_, _, link)| *link);
        self.links.truncate(kept);
        self.links.push_back(link);
    }

    /// Height of the newest link.
    pub(super) fn last(&self) -> u64 {
        self.first + (self.links.len() as u64).saturating_sub(1)
    }

    /// Blocks up to this height are executed.
    pub(super) fn executed(&mut self, height: u64) {
        let wanted = height.saturating_sub(self.first);
        let surplus = usize::try_from(wanted).unwrap_or(0).saturating_sub(LINKS_KEPT).min(self.links.len() - 1);
        self.links.drain(..surplus);
        self.first += surplus as u64;
    }

    /// The step is over.
    pub(super) fn end_step(&mut self) {
        self.arriving.clear();
    }

    /// Names the hash in a message that the `raft` crate has made: of the entry before an append, or of the last one that is
    /// acknowledged. The crate leaves the context of both empty.
    pub(super) fn name(&self, messages: &mut [Message]) {
        for message in messages {
            let names = match message.get_msg_type() {
                MessageType::MsgAppend => true,
                MessageType::MsgAppendResponse => !message.reject,
                _ => false,
            };
            if names && let Some(hash) = self.hash(message.index) {
                message.context = hash.0.to_vec().into();
            }
        }
    }
}

impl Engine {
    /// Why an append, or an acknowledgement, is not taken for the sake of the chain.
    pub(super) fn check_chain(
        &mut self,
        from: u64,
        message: &RaftMessage,
        out: &mut Vec<Output>,
    ) -> Result<(), &'static str> {
        match RaftKind::try_from(message.kind) {
            Ok(RaftKind::Append) if message.term >= self.raw.raft.term => {
                let checked = self.check_append(from, message, out);
                if active(Mutation::AppendToAnyLog) { Ok(()) } else { checked }
            }
            Ok(RaftKind::AppendResponse) if !message.reject => {
                let checked = self.check_acknowledgement(from, message, out);
                if active(Mutation::CountAnyLog) { Ok(()) } else { checked }
            }
            _ => Ok(()),
        }
    }

    /// A leader appends: does its log agree with this one as far as both say that it does?
    fn check_append(&mut self, from: u64, message: &RaftMessage, out: &mut Vec<Output>) -> Result<(), &'static str> {
        let named = Hash::from_slice(&message.hash).ok_or("it does not name the block before its entries")?;
        // What is not in this log is refused by the crate, or was dropped here as it is committed.
        let Some(own) = self.chain.link(message.index) else { return Ok(()) };
        if own.hash != named {
            // Otherwise entries that are not committed, as after every election.
            if !self.must_be_equal(message.index, message.log_term) {
                return Ok(());
            }
            if let Ok((_, headers)) = links(Link { hash: named, time: 0 }, &message.entries) {
                self.prove_append(message, from, (message.index, named), headers, out);
            }
            return self.contradicted(from, message, (message.index, own.hash, named), out);
        }
        let (arriving, headers) = links(own, &message.entries)?;
        for (place, (height, term, link)) in arriving.iter().enumerate() {
            let here = self.chain.hash(*height).filter(|_| self.must_be_equal(*height, *term));
            if let Some(hash) = here.filter(|hash| *hash != link.hash) {
                let after = headers.into_iter().skip(place + 1).collect();
                self.prove_append(message, from, (*height, link.hash), after, out);
                return self.contradicted(from, message, (*height, hash, link.hash), out);
            }
        }
        let head = arriving.last().map_or(own.hash, |(_, _, link)| link.hash);
        self.check_head(from, message, head, out)?;
        self.chain.arriving = arriving;
        Ok(())
    }

    /// Would Raft take an entry of another log with this index and term for the one in this log? A committed one stays, whatever
    /// the term of the other.
    fn must_be_equal(&self, index: u64, term: u64) -> bool {
        let log = &self.raw.raft.raft_log;
        index <= log.committed || (index <= log.last_index() && self.store.term(index) == Some(term))
    }

    /// A follower acknowledges: the chain of this leader, or another?
    fn check_acknowledgement(
        &mut self,
        from: u64,
        message: &RaftMessage,
        out: &mut Vec<Output>,
    ) -> Result<(), &'static str> {
        let last = self.raw.raft.raft_log.last_index();
        let counts = self.is_leader() && message.term == self.raw.raft.term && self.membership.contains(from);
        if !counts || message.index > last {
            return Ok(());
        }
        // So old that it counts for nothing: this node has dropped it.
        if message.index + 1 < self.store.first_index() {
            return Ok(());
        }
        let named = Hash::from_slice(&message.hash).ok_or("it does not name the block that it acknowledges")?;
        match self.chain.hash(message.index) {
            Some(own) if own == named => Ok(()),
            Some(own) => self.contradicted(from, message, (message.index, own, named), out),
            None => Err("it acknowledges a block of which this node does not know the hash any more"),
        }
    }

    /// Reports that another node has another chain, once in a while.
    fn contradicted(
        &mut self,
        from: u64,
        message: &RaftMessage,
        (height, own, other): (u64, Hash, Hash),
        out: &mut Vec<Output>,
    ) -> Result<(), &'static str> {
        let leads = message.kind == i32::from(RaftKind::Append);
        let pause = REPORT_TIMEOUTS * self.config.election_tick;
        if !self.chain.reported.rests(from, self.ticks, pause) {
            self.chain.reported.begin(from, self.ticks);
            out.push(Output::Contradicted(Contradiction { node: from, leads, term: message.term, height, own, other }));
        }
        Err("its chain contradicts the one of this node")
    }
}

/// The links that the entries of a message add to a chain, each with height and term, and what their hashes cover.
type Links = (Vec<(u64, u64, Link)>, Vec<BranchLink>);

fn links(mut link: Link, entries: &[WireEntry]) -> Result<Links, &'static str> {
    let (mut links, mut headers) = (Vec::with_capacity(entries.len()), Vec::with_capacity(entries.len()));
    for entry in entries {
        let (next, header) = link.header(&entry_of(entry)?);
        link = next;
        links.push((entry.index, entry.term, link));
        headers.push(header);
    }
    Ok((links, headers))
}

fn entry_of(entry: &WireEntry) -> Result<Entry, &'static str> {
    let kind = u8::try_from(entry.kind).ok().and_then(EntryKind::from_code).ok_or("an entry is of an unknown kind")?;
    Ok(Entry { index: entry.index, term: entry.term, kind, data: entry.data.clone() })
}
