//! The order thread of a node: events into its replica, whose effects are carried out.

use super::{Event as Happening, Timer, World};
use crate::clock::SECOND;
use crate::coverage::Fault;
use crate::invariant::{Check, Violation};
use crate::node::{Running, Verdict};
use crate::withholding::withhold;
use bytes::Bytes;
use ledger_raft::{Input, PeerMessage, RaftKind, Role, RoleChange};
use ledger_replica::catch_up::Behind;
use ledger_replica::conductor::Happened;
use ledger_replica::{Circumstances, Effect, Event, Now, WAIT_MAX, Work};
use ledger_storage::block_store::StoreError;
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;

impl World {
    /// The process of a node, if it runs.
    pub(super) fn running(&mut self, id: u64) -> Option<&mut Running> {
        self.nodes.get_mut(&id)?.up.as_mut()
    }

    /// Both clocks of a node.
    pub(super) fn clocks(&self, id: u64) -> Now {
        let Some(clock) = self.nodes.get(&id).map(|node| &node.clock) else {
            return Now { clock: 0, elapsed: self.now, accepts_until: 0, doubt: None };
        };
        let (accepts_until, doubt) = (clock.accepts_until(self.now), clock.doubt(self.now));
        Now { clock: clock.now(self.now), elapsed: self.now, accepts_until, doubt }
    }

    /// Hands an input to a node; while its thread is busy with the disk, it waits in the inbox.
    pub(super) fn input(&mut self, id: u64, input: Input) -> Check {
        let Some(running) = self.running(id) else { return Ok(()) };
        if running.flushing && running.waits_for_disk {
            running.inbox.push_back(Event::Input(input));
            return Ok(());
        }
        self.turn(id, [Event::Input(input)])
    }

    /// One turn of the order thread, as in `src/ordering/orderer/order.rs`: what has come in, what is due, the write, execution.
    fn turn(&mut self, id: u64, events: impl IntoIterator<Item = Event>) -> Check {
        for event in events {
            self.step(id, event)?;
        }
        let Some(running) = self.running(id) else { return Ok(()) };
        let full = running.space.is_full();
        if std::mem::take(&mut running.wants_others) {
            let wanted = running.wanted.clone();
            self.step(id, Event::Wanted(wanted))?;
        }
        self.step(id, Event::Time { full })?;
        self.begin_write(id)?;
        self.execute_committed(id)?;
        self.sleep(id);
        Ok(())
    }

    /// A leader that withholds control calls takes them, and orders other things.
    fn withhold(&self, id: u64, event: &mut Event) -> bool {
        if self.plan.withholds != Some(id) || !self.chaos {
            return false;
        }
        let replica = self.nodes.get(&id).and_then(|node| node.up.as_ref()?.replica.as_ref());
        if !replica.is_some_and(|replica| replica.leads()) {
            return false;
        }
        withhold(event).0
    }

    /// A voter complains about its leader.
    fn complained(&mut self, id: u64, term: u64, leader: u64) -> Check {
        self.note(format_args!("n{id} complains about n{leader} in term {term}"));
        let mut voters = BTreeMap::<_, usize>::new();
        for node in &self.newest_members().voters {
            let of = self.people.node(*node, self.plan.organisations).identity.organisation.clone();
            *voters.entry(of).or_default() += 1;
        }
        let largest = voters.into_values().max().unwrap_or_default();
        let is_honest = self.plan.withholds != Some(leader);
        let deposed = self.invariants.honest_leaders.complains(id, (term, leader), largest, is_honest)?;
        self.coverage.deposed += u64::from(deposed);
        Ok(())
    }

    pub(super) fn step(&mut self, id: u64, mut event: Event) -> Check {
        if self.withhold(id, &mut event) {
            return Ok(());
        }
        let now = self.clocks(id);
        let Some(replica) = self.running(id).and_then(|running| running.replica.as_mut()) else { return Ok(()) };
        let mut effects = Vec::new();
        replica.step(now, event, &mut effects);
        // Nothing that comes after the end of a replica is carried out.
        effects.into_iter().try_for_each(|effect| match self.has_replica(id) {
            true => self.carry_out(id, effect),
            false => Ok(()),
        })?;
        self.tell(id)
    }

    fn carry_out(&mut self, id: u64, effect: Effect) -> Check {
        match effect {
            Effect::Send { to, message } => return self.send(id, to, message),
            Effect::Status(_) | Effect::Reconciles(_) => {}
            Effect::Role(change) => return self.role(id, change),
            Effect::Members { height, membership } => {
                self.note(format_args!("n{id} members at {height}: {membership:?}"));
            }
            Effect::Read { context, answer } => {
                return self.reads(id, |reads, now, out| reads.answered(now, context, answer, out));
            }
            Effect::Denied(refusal) => {
                let (code, transaction) = (refusal.rejection.code, refusal.transaction.map(|denied| denied.id()));
                self.note(format_args!("n{id} drops {transaction:?}: {code}"));
            }
            Effect::Refused { input, reason } => self.note(format_args!("n{id} refuses {input:?}: {}", reason.code)),
            Effect::Misbehaved(proof) => {
                let what = format!("node {id} has a proof: {proof:?}");
                return Err(Violation::new("no honest node signs two things for one place", what));
            }
            Effect::Contradicted(found) => {
                return Err(Violation::new(
                    "nobody contradicts the chain of an honest node",
                    format!("node {id}: {found:?}"),
                ));
            }
            Effect::Ignored { from, reason } => self.note(format_args!("n{id} ignores a message of n{from}: {reason}")),
            Effect::Behind { from, first_index } => {
                return self.conduct(id, Happened::Behind(Behind { from, first_index }));
            }
            Effect::Failed(reason) => return self.failed(id, &reason.to_string()),
        }
        Ok(())
    }

    fn has_replica(&self, id: u64) -> bool {
        self.nodes.get(&id).and_then(|node| node.up.as_ref()).is_some_and(|running| running.replica.is_some())
    }

    /// When the thread is to be woken, if nothing comes in before.
    fn sleep(&mut self, id: u64) {
        let (now, tick) = (self.clocks(id), self.plan.timing.tick);
        let Some(running) = self.running(id) else { return };
        let Some(replica) = &running.replica else { return };
        // The write that it waits for is under way.
        let wait = if running.flushing { tick } else { replica.wait(now) };
        let at = now.elapsed.saturating_add(wait);
        if at < running.turn_at || running.turn_at <= now.elapsed {
            running.turn_at = at;
            self.schedule_timer(id, wait, Timer::Turn);
        }
    }

    fn role(&mut self, id: u64, change: RoleChange) -> Check {
        self.note(format_args!("n{id} {:?} of term {}, leader {:?}", change.role, change.term, change.leader));
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let elected = change.role == Role::Leader && !running.leading;
        running.leading = change.role == Role::Leader;
        self.invariants.log_matching.look(id, &running.store)?;
        if running.leading {
            self.invariants.election_safety.leads(id, change.term)?;
        }
        if let Some(leader) = change.leader {
            self.invariants.election_safety.follows(id, change.term, leader)?;
        }
        if elected {
            self.invariants.leader_completeness.elected(id, change.term, &running.store)?;
        }
        Ok(())
    }

    fn send(&mut self, id: u64, to: u64, message: PeerMessage) -> Check {
        if let PeerMessage::Complaint(complaint) = &message {
            self.complained(id, complaint.term, complaint.leader)?;
        }
        if let PeerMessage::Raft(raft) = &message {
            let (kind, term, index, entries) = (raft.kind(), raft.term, raft.index, raft.entries.len());
            let (commit, reject) = (raft.commit, if raft.reject { " refused" } else { "" });
            match kind {
                RaftKind::VoteResponse if !raft.reject => {
                    self.invariants.informed_votes.votes(id)?;
                    self.invariants.election_safety.votes(id, term, to)?;
                    self.forgets(id);
                }
                RaftKind::Vote => self.invariants.election_safety.votes(id, term, id)?,
                _ => {}
            }
            let what =
                format_args!("n{id} > n{to} {kind:?} term {term} index {index} +{entries} commit {commit}{reject}");
            self.trace.note(self.now, what);
        } else {
            let what = match &message {
                PeerMessage::Mandate(mandate) => {
                    self.old_votes.clone_from(&mandate.votes);
                    format!("mandate of term {}", mandate.term)
                }
                PeerMessage::MandateWanted(wanted) => format!("where is the mandate of term {}", wanted.term),
                _ => "transactions".to_owned(),
            };
            self.note(format_args!("n{id} > n{to} {what}"));
            // A connection that is broken is known to be, or not yet.
            if self.links.is_cut((id, to)) && self.random.nodes.percent(50) {
                return self.step(id, Event::Unsent { to, message });
            }
        }
        let bytes = message.to_bytes();
        for at in self.links.send(self.now, (id, to), &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Happening::Deliver { from: id, to, bytes: bytes.clone() });
        }
        Ok(())
    }

    /// A voter that has just voted is made to forget it, if it can: power fails now and then at this moment.
    fn forgets(&mut self, id: u64) {
        let fault = Fault::Crash;
        if self.chaos && self.plan.faults.contains(&fault) && self.random.faults.percent(10) {
            self.fell(fault, id, true);
        }
    }

    /// A message arrives.
    pub(super) fn deliver(&mut self, from: u64, to: u64, bytes: Bytes) -> Check {
        // A node whose disk is gone has no key with which to speak any more.
        if self.nodes.get(&from).is_none_or(|node| node.lost) {
            return Ok(());
        }
        let message = PeerMessage::decode(bytes).unwrap();
        let withheld = self.running(to).is_some_and(|running| running.ballot.withholds(&message));
        if withheld { Ok(()) } else { self.input(to, Input::Message { from, message }) }
    }

    /// The work of a process at its own time.
    pub(super) fn timer(&mut self, id: u64, timer: Timer) -> Check {
        match timer {
            Timer::Turn => {
                let Some(running) = self.running(id) else { return Ok(()) };
                if running.flushing && running.waits_for_disk {
                    return Ok(());
                }
                let inbox = std::mem::take(&mut running.inbox);
                self.turn(id, inbox)
            }
            Timer::Flushed => self.flushed(id),
            Timer::Execute => self.execute(id),
            Timer::Reads => self.reads(id, |reads, now, out| reads.time(now, out)),
            Timer::Stream(stream) => self.tend(id, stream),
            Timer::TurnOver(stream) => self.turn_over(id, stream),
            Timer::Fetch => self.fetch(id),
            Timer::Conduct => self.conduct(id, Happened::Waited),
            Timer::Answered(peer) => self.answered_question(id, peer),
            Timer::Look => self.looked(id, None),
            Timer::Attest => self.attest(id),
            Timer::Tell => {
                self.schedule_timer(id, SECOND, Timer::Tell);
                self.tell_again(id)
            }
            Timer::Housekeeping => self.keep_house(id),
        }
    }

    /// The log is to be flushed if the replica says so: that takes time.
    fn begin_write(&mut self, id: u64) -> Check {
        let now = self.clocks(id);
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let due = running.replica.as_ref().is_some_and(|replica| replica.must_write(now));
        if !due || std::mem::replace(&mut running.flushing, true) {
            return Ok(());
        }
        self.invariants.log_matching.look(id, &running.store)?;
        let mut time = 50 + self.random.disk.below(self.plan.disk_max);
        if self.chaos && self.plan.faults.contains(&Fault::SlowDisk) && self.random.disk.percent(2) {
            self.coverage.fault(Fault::SlowDisk);
            time += self.random.disk.below(50 * self.plan.disk_max);
        }
        self.schedule_timer(id, time, Timer::Flushed);
        Ok(())
    }

    fn flushed(&mut self, id: u64) -> Check {
        if self.nodes.get(&id).is_some_and(|node| node.tear) {
            self.tear(id);
            return Ok(());
        }
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        // The replica that wanted it may have ended meanwhile.
        if !std::mem::take(&mut running.flushing) {
            return Ok(());
        }
        let room = !running.space.is_full();
        let written = running.write_log();
        let found_none = room && running.space.is_full();
        let inbox = std::mem::take(&mut running.inbox);
        match &written {
            Ok(durable) => {
                self.invariants.acknowledged.flushed(id, &running.store);
                self.note(format_args!("n{id} flushed, durable up to {durable}"));
            }
            Err(error) => self.note(format_args!("n{id} cannot flush: {error}")),
        }
        if found_none {
            self.coverage.fault(Fault::FullDisk);
            self.note(format_args!("n{id} has no room"));
        }
        self.step(id, Event::Written(written.map(drop)))?;
        self.execute_committed(id)?;
        self.turn(id, inbox)
    }

    /// Committed blocks are executed here, or given to the execute thread.
    fn execute_committed(&mut self, id: u64) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let Some(replica) = running.replica.as_mut() else { return Ok(()) };
        let now = Circumstances { inputs_wait: !running.inbox.is_empty(), other_is_idle: running.given.is_empty() };
        let Some(work) = replica.work(now) else { return Ok(()) };
        let (Work::Here(entries) | Work::Elsewhere(entries)) = &work;
        self.committed(id, entries)?;
        match work {
            Work::Here(entries) => {
                self.coverage.in_place += 1;
                self.execute_all(id, &entries)?;
                let height = entries.last().map_or(0, |entry| entry.index);
                let took = self.random.nodes.below(1_020);
                self.step(id, Event::Executed { height, took })
            }
            Work::Elsewhere(entries) => {
                let Some(running) = self.running(id) else { return Ok(()) };
                running.given.extend(entries);
                if !std::mem::replace(&mut running.executing, true) {
                    let delay = 20 + self.random.nodes.below(if self.chaos { 2_000 } else { 200 });
                    self.schedule_timer(id, delay, Timer::Execute);
                }
                Ok(())
            }
        }
    }

    /// These blocks are committed, by all that this node knows.
    pub(super) fn committed(&mut self, id: u64, entries: &[Entry]) -> Check {
        let Some(replica) = self.running(id).and_then(|running| running.replica.as_ref()) else { return Ok(()) };
        let term = replica.status().role.term;
        for entry in entries {
            self.invariants.committed.committed(id, entry)?;
            self.invariants.leader_completeness.committed(entry.index, entry.term, term);
        }
        Ok(())
    }

    fn keep_house(&mut self, id: u64) -> Check {
        let now = self.now;
        self.schedule_timer(id, self.plan.state_flush, Timer::Housekeeping);
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        running.space.look(&mut running.ground);
        let room = !running.space.is_full();
        // A full disk keeps it in memory; the blocks have it.
        let kept = match room {
            true => running.ledger.flush_up_to(running.store.durable_index(), Some(&running.snapshots)),
            false => Ok(()),
        };
        let reached = running.ledger.state().stored().map_or(0, |tip| tip.height);
        if let Some(snapshot) = running.snapshots.newest() {
            let (height, content) = (snapshot.manifest().height, snapshot.content());
            self.invariants.state_agreement.snapshot(id, height, content)?;
        }
        let prepared = if self.plan.prepares && room { running.store.prepare() } else { Ok(false) };
        running.waiters.sweep(now);
        match prepared {
            Ok(_) | Err(StoreError::DiskFull { .. }) => {}
            Err(error) => return self.failed(id, &error.to_string()),
        }
        self.tell(id)?;
        self.nobody_is_forgotten(id)?;
        self.catch_up(id)?;
        if kept.is_ok()
            && let Some(node) = self.nodes.get_mut(&id)
        {
            node.saved = reached;
        }
        self.prune(id)
    }

    /// A client that waits is answered within a bounded time, if only that nobody knows.
    fn nobody_is_forgotten(&mut self, id: u64) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        match running.waiting.iter().find(|(_, since)| now > **since + WAIT_MAX) {
            None => Ok(()),
            Some((reply, since)) => {
                let what = format!("node {id} has not answered {reply:?} for {} us", now - since);
                Err(Violation::new("everybody is answered", what))
            }
        }
    }

    /// The waiters' answers go to their clients.
    pub(super) fn tell(&mut self, id: u64) -> Check {
        let Some(running) = self.running(id) else { return Ok(()) };
        let answers: Vec<Verdict> = running.answers.1.try_iter().collect();
        for Verdict { reply, transaction, answer } in answers {
            if let Some(running) = self.running(id) {
                running.waiting.remove(&reply);
            }
            if let crate::node::Answer::Verdict { height, .. } = &answer {
                self.acknowledge(id, &transaction, *height)?;
            }
            self.reply(id, reply, answer);
        }
        Ok(())
    }
}
