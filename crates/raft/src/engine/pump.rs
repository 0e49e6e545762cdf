//! The ready loop: from the `raft` crate's state to outputs.
//!
//! Order matters here. A leader's messages go out before its own disk has the entries (the majority may be others).
//! Everybody else's messages promise something (a vote, an acknowledgement), so they wait until what they promise is on
//! the disk: [`PendingReady`]. Learners have no part in that. A leader sends them committed entries, and they hand them
//! out before their own disk has them, as a majority of the voters has.

use super::{Engine, OwnBlock, PendingReady, READ_BYTES};
use crate::interface::{Output, Role, RoleChange};
use crate::log::membership;
use crate::message::convert::{change_into_raft, entry_from_raft, proposal};
use crate::message::{ENTRIES_MAX, PeerMessage, RaftMessage};
use ledger::block::Payload;
use ledger::members::MembershipChange;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_storage::block_store::StoreError;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use raft::eraftpb::{Message, MessageType};
use raft::{INVALID_ID, StateRole};

impl Engine {
    /// Runs until nothing is left to do.
    pub(super) fn pump(&mut self, out: &mut Vec<Output>) -> Result<(), StoreError> {
        loop {
            self.tell_role(out);
            self.propose(out);
            self.commit(out)?;
            if !self.raw.has_ready() {
                break;
            }
            self.handle_ready(out)?;
        }
        self.forward(out);
        Ok(())
    }

    /// Notices a change of leadership and prepares for it.
    fn tell_role(&mut self, out: &mut Vec<Output>) {
        let raft = &self.raw.raft;
        let role = match raft.state {
            StateRole::Leader => Role::Leader,
            StateRole::Candidate | StateRole::PreCandidate => Role::Candidate,
            StateRole::Follower => Role::Follower,
        };
        let change = RoleChange { leader: self.leader(), term: raft.term, role };
        if change == self.told {
            return;
        }
        let was_leader = (self.told.role == Role::Leader).then_some(self.told.term);
        let leads = role == Role::Leader && was_leader != Some(change.term);
        if leads {
            // The empty entry of the new term included: once it is applied, term and vote are on this disk too. So a
            // voter that elected itself alone, and lost the write of its term, can never order two different blocks
            // at the same height and term.
            self.barrier = raft.raft_log.last_index();
            self.last_time = self.newest_time();
            self.heard = self.membership.nodes().into_iter().map(|node| (node, self.ticks)).collect();
            self.receipts.begin_term(change.term);
            self.times.begin_term();
        }
        if leads || role != Role::Leader {
            self.own.clear();
            self.held.clear();
            self.ahead.clear();
            self.wants_empty = false;
        }
        if change.leader != self.told.leader {
            self.leader_before = self.told.leader.or(self.leader_before);
        }
        self.told = change;
        let leading = change.role == Role::Leader;
        tracing::debug!(node = self.config.id, leading, leader = change.leader, term = change.term, "leadership");
        out.push(Output::Role(change));
        if leads {
            self.show_mandate_to_all(change.term, out);
        }
    }

    /// This node leads, has executed everything that was there before, and is not handing over.
    pub(super) fn may_propose(&self) -> bool {
        let raft = &self.raw.raft;
        raft.state == StateRole::Leader
            && self.told.role == Role::Leader
            && self.told.term == raft.term
            && self.applied >= self.barrier
            && raft.lead_transferee.is_none()
            && self.membership.is_voter(self.config.id)
    }

    /// Waiting transactions become one block, as soon as the previous write is under way.
    fn propose(&mut self, out: &mut Vec<Output>) {
        if !self.may_propose() {
            return;
        }
        if self.refuse_in_doubt(out) {
            return;
        }
        self.drop_late(out);
        loop {
            let log = &self.raw.raft.raft_log;
            let (committed, persisted) = (log.committed, log.persisted);
            while self.own.front().is_some_and(|block| block.index <= committed.min(persisted)) {
                self.own.pop_front();
            }
            let unpersisted = self.own.iter().filter(|block| block.index > persisted).count();
            let uncommitted = self.own.iter().filter(|block| block.index > committed).count();
            let bytes: usize = self.own.iter().map(|block| block.bytes).sum();
            let full = unpersisted >= self.config.blocks_unpersisted
                || uncommitted >= self.config.blocks_uncommitted
                || bytes >= self.config.uncommitted_bytes;
            if full || (self.queues.is_empty() && !self.wants_empty) {
                return;
            }
            let cut = self.queues.cut(self.config.block_bytes, self.room_ahead());
            if cut.is_empty() && !self.queues.is_empty() {
                return;
            }
            let time = self.block_time(self.now);
            let data = Payload { time, transactions: self.queues.peek(cut) }.to_bytes();
            let bytes = data.len();
            if let Err(error) = self.raw.step(proposal(self.config.id, EntryKind::Normal, data)) {
                // Nothing is taken out of the queues, so nothing is lost.
                tracing::debug!(%error, "cannot propose now");
                return;
            }
            drop(self.queues.take(cut));
            let index = self.raw.raft.raft_log.last_index();
            let before = self.own.back().map_or(0, |block| block.index);
            invariant!(
                before < index,
                "each block of a leader has a height of its own",
                "block {index} after {before}"
            );
            self.own.push_back(OwnBlock { index, bytes });
            self.ahead.proposed(index, cut.cost);
            self.last_time = time;
            self.wants_empty = false;
        }
    }

    /// The limit for the cost of the data of the next block: nothing while enough is committed that is not executed.
    pub(super) fn room_ahead(&self) -> usize {
        let log = &self.raw.raft.raft_log;
        self.ahead.room(log.committed.min(log.persisted))
    }

    /// Hands out what is committed and, on a voter, on the own disk, as far as the executor keeps up.
    fn commit(&mut self, out: &mut Vec<Output>) -> Result<(), StoreError> {
        loop {
            if active(Mutation::AcknowledgeBeforeMajority) && self.is_leader() {
                let persisted = self.raw.raft.raft_log.persisted;
                self.raw.raft.raft_log.commit_to(persisted);
            }
            let log = &self.raw.raft.raft_log;
            let until = if self.is_voter() { log.committed.min(log.persisted) } else { log.committed };
            if self.emitted >= until || self.unapplied_bytes >= self.config.unapplied_bytes {
                return Ok(());
            }
            let entries = self.store.entries(self.emitted + 1..until + 1, READ_BYTES)?;
            if let Some(first) = entries.first()
                && first.index != self.emitted + 1
            {
                let (wanted, found) = (self.emitted + 1, first.index);
                return Err(StoreError::Violation(format!(
                    "block {wanted} was dropped before it was executed, the log begins at {found}"
                )));
            }
            let Some(last) = entries.last().map(|entry| entry.index) else { return Ok(()) };
            let bytes = entries.iter().map(|entry| entry.data.len() + 64).sum();
            self.emitted = last;
            self.ahead.committed(last, self.now);
            self.unapplied.push_back((last, bytes));
            self.unapplied_bytes += bytes;
            let changes: Vec<Entry> =
                entries.iter().filter(|entry| entry.kind == EntryKind::ConfChangeV2).cloned().collect();
            out.push(Output::Commit(entries));
            for entry in changes {
                self.change_members(&entry, out);
            }
        }
    }

    /// A committed change takes effect on every node at the same height.
    fn change_members(&mut self, entry: &Entry, out: &mut Vec<Output>) {
        let Some(next) = self.membership.after(entry) else { return };
        let Ok(change) = MembershipChange::from_bytes(&entry.data) else { return };
        match self.raw.apply_conf_change(&change_into_raft(&change)) {
            Ok(state) => {
                let found = membership(&state);
                let height = entry.index;
                invariant!(
                    found == next,
                    "engine and ledger know the same members",
                    "{found:?} and {next:?} at {height}"
                );
            }
            Err(error) => {
                tracing::error!(height = entry.index, %error, "change of members rejected by the engine");
                return;
            }
        }
        self.membership = next.clone();
        self.times.keep(&next);
        let nodes = next.nodes();
        self.heard.retain(|node, _| nodes.contains(node));
        for node in nodes {
            self.heard.entry(node).or_insert(self.ticks);
        }
        if !next.is_voter(self.config.id) && self.raw.raft.state != StateRole::Follower {
            // The crate would go on leading (or win the election) without a vote of its own, and once it has no place
            // among the members it fails on its own progress.
            let term = self.raw.raft.term;
            self.raw.raft.become_follower(term, INVALID_ID);
        }
        out.push(Output::Membership { height: entry.index, membership: next });
    }

    /// The driver has executed blocks.
    pub(super) fn set_applied(&mut self, height: u64, at: u64) {
        let height = height.min(self.emitted);
        if height <= self.applied {
            return;
        }
        self.applied = height;
        while let Some((last, bytes)) = self.unapplied.front().copied()
            && last <= height
        {
            self.unapplied.pop_front();
            self.unapplied_bytes -= bytes;
        }
        self.ahead.executed(height, at);
        self.chain.executed(height);
        self.advance_applied();
    }

    /// The crate may know of what is executed as far as it is on the own disk.
    fn advance_applied(&mut self) {
        let log = &self.raw.raft.raft_log;
        let (last, height) = (log.last_index(), self.applied.min(log.persisted));
        if height <= log.applied {
            return;
        }
        self.raw.advance_apply_to(height);
        if self.raw.raft.raft_log.last_index() > last {
            // The crate has appended the end of a joint change; without this it would wait for a heartbeat.
            self.raw.raft.bcast_append();
        }
    }

    fn handle_ready(&mut self, out: &mut Vec<Output>) -> Result<(), StoreError> {
        let mut ready = self.raw.ready();
        for state in ready.take_read_states() {
            if let Some(context) = self.read_context(&state.request_ctx) {
                out.push(Output::ReadReady { context, index: state.index });
            }
        }
        let entries: Vec<Entry> = ready.take_entries().into_iter().map(entry_from_raft).collect();
        let hard_state =
            ready.hs().map(|state| HardState { term: state.term, vote: kept(state.vote), commit: state.commit });
        if !entries.is_empty() || hard_state.is_some() {
            self.store.append(&entries, hard_state.as_ref())?;
            entries.iter().for_each(|entry| self.chain.append(entry));
        }
        self.store.set_committed(self.raw.raft.raft_log.committed);
        let mut messages = ready.take_messages();
        self.chain.name(&mut messages);
        let messages = self.hold_back(messages);
        self.send(messages, out);
        let (number, needs_flush) = (ready.number(), ready.must_sync());
        let mut messages = ready.take_persisted_messages();
        self.chain.name(&mut messages);
        let bytes = entries.iter().map(|entry| entry.data.len()).sum();
        self.unpersisted_bytes += bytes;
        self.pending.push_back(PendingReady { number, needs_flush, bytes, messages });
        self.raw.advance_append_async(ready);
        if needs_flush {
            out.push(Output::Flush { ready: number });
        }
        // What needs no flush and waits for none is done.
        self.persisted(0, out);
        Ok(())
    }

    /// The flush of this ready, and so of all before it, has returned.
    pub(super) fn persisted(&mut self, number: u64, out: &mut Vec<Output>) {
        let mut done = None;
        while let Some(ready) = self.pending.pop_front() {
            if ready.needs_flush && ready.number > number {
                self.pending.push_front(ready);
                break;
            }
            done = Some(ready.number);
            self.unpersisted_bytes -= ready.bytes;
            self.send(ready.messages, out);
        }
        if let Some(number) = done {
            self.raw.on_persist_ready(number);
            let (told, durable) = (self.raw.raft.raft_log.persisted, self.store.durable_index());
            invariant!(told <= durable, "acknowledged blocks are on the disk", "block {told}, the disk has {durable}");
            self.advance_applied();
        }
    }

    /// Does time mean anything to this engine now? It does not to a leader with no other member and with nothing to
    /// order: then [`Input::Tick`](crate::Input::Tick) changes nothing, and the driver may leave it out.
    pub fn needs_ticks(&self) -> bool {
        let idles = self.membership.nodes().len() == 1 && self.queues.is_empty() && !self.waits_for_clock();
        !(self.may_propose() && idles)
    }

    /// Has this node a vote, as far as it has handed out what is committed?
    pub fn is_voter(&self) -> bool {
        self.membership.is_voter(self.config.id)
    }

    /// Of a leader's messages those that may go now: what is appended at learners waits for its commit and goes in one
    /// message with it. Earlier it would only be in the way of those whose acknowledgement counts.
    fn hold_back(&mut self, messages: Vec<Message>) -> Vec<Message> {
        let committed = self.raw.raft.raft_log.committed;
        let end = |message: &Message| message.index + message.entries.len() as u64;
        let mut now = Vec::with_capacity(messages.len());
        for (node, held) in &mut self.held {
            let learns = !self.membership.is_voter(*node);
            while let Some(message) = held.pop_front_if(|message| !learns || end(message) <= committed) {
                now.push(message);
            }
        }
        self.held.retain(|_, held| !held.is_empty());
        for message in messages {
            let appends = message.get_msg_type() == MessageType::MsgAppend && !self.membership.is_voter(message.to);
            match self.held.get_mut(&message.to) {
                // What follows one that waits must not overtake it.
                Some(held) if appends => held.push_back(message),
                None if appends && end(&message) > committed => {
                    self.held.entry(message.to).or_default().push_back(message)
                }
                _ => now.push(message),
            }
        }
        now
    }

    /// Puts messages out. Appends to one peer that follow each other become one message, within the limits. The head of each
    /// is signed then, once for all that end with the same entry.
    fn send(&mut self, messages: Vec<Message>, out: &mut Vec<Output>) {
        let first = out.len();
        for message in messages {
            if self.acknowledged.repeats(&message, self.ticks, self.config.heartbeat_tick) {
                continue;
            }
            let joined = message.get_msg_type() == MessageType::MsgAppend
                && out.iter_mut().skip(first).rev().any(|output| self.join(output, &message));
            if joined {
                continue;
            }
            let to = message.to;
            if let Some(mut message) = RaftMessage::from_raft(message) {
                self.receipts.attach(to, &mut message);
                self.times.attach(&mut message);
                self.mandates.attach(self.config.id, to, &mut message);
                self.attach_handover(to, &mut message);
                out.push(Output::Send { to, message: PeerMessage::Raft(message) });
            }
        }
        self.sign_heads(first, out);
    }

    /// Adds an append to an earlier one to the same peer, if it follows it and both fit one message.
    fn join(&self, output: &mut Output, message: &Message) -> bool {
        let Output::Send { to, message: PeerMessage::Raft(earlier) } = output else { return false };
        let follows = *to == message.to
            && earlier.kind == i32::from(crate::RaftKind::Append)
            && earlier.term == message.term
            && earlier.index + earlier.entries.len() as u64 == message.index;
        let bytes: usize = earlier.entries.iter().map(|entry| entry.data.len()).sum::<usize>()
            + message.entries.iter().map(|entry| entry.data.len()).sum::<usize>();
        let fits = earlier.entries.len() + message.entries.len() <= ENTRIES_MAX && bytes <= self.config.message_bytes;
        if !follows || !(fits || message.entries.is_empty()) {
            return false;
        }
        let Some(later) = RaftMessage::from_raft(message.clone()) else { return false };
        earlier.commit = earlier.commit.max(later.commit);
        earlier.entries.extend(later.entries);
        true
    }
}

/// The vote as it is written to the disk.
fn kept(vote: u64) -> u64 {
    if active(Mutation::ForgetTheVote) { 0 } else { vote }
}
