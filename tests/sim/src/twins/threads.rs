//! The order thread of a node: events into its replica, whose effects are carried out; blocks are written and executed.

use super::world::{Timer, World, era};
use crate::clock::MILLISECOND;
use crate::invariant::{Check, Violation};
use ledger::Outcome;
use ledger::members::Membership;
use ledger_raft::{Desired, Input, Role};
use ledger_replica::certifier::{self, Certifiable};
use ledger_replica::{Circumstances, Effect, Event, Work};
use ledger_storage::entry::Entry;
use std::collections::BTreeSet;
use std::sync::Arc;

impl World {
    pub(super) fn input(&mut self, at: usize, input: Input) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        if up.flushing {
            up.inbox.push_back(Event::Input(input));
            return Ok(());
        }
        self.turn(at, [Event::Input(input)])
    }
    /// One turn of the order thread, as in `src/ordering/orderer/order.rs`.
    pub(super) fn turn(&mut self, at: usize, events: impl IntoIterator<Item = Event>) -> Check {
        for event in events {
            self.step(at, event)?;
        }
        self.step(at, Event::Time { full: false })?;
        self.begin_write(at);
        self.execute(at)?;
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return Ok(()) };
        let wait = if up.flushing { 50 * MILLISECOND } else { up.replica.wait(now) };
        let due = now.elapsed.saturating_add(wait);
        if due < up.turn_at || up.turn_at <= now.elapsed {
            up.turn_at = due;
            self.schedule_timer(at, wait, Timer::Turn);
        }
        Ok(())
    }
    pub(super) fn turned(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at).filter(|up| !up.flushing) else { return Ok(()) };
        let inbox = std::mem::take(&mut up.inbox);
        self.turn(at, inbox)
    }

    pub(super) fn step(&mut self, at: usize, mut event: Event) -> Check {
        if self.withholds(at, &mut event) {
            return Ok(());
        }
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return Ok(()) };
        let mut effects = Vec::new();
        up.replica.step(now, event, &mut effects);
        effects.into_iter().try_for_each(|effect| self.carry_out(at, effect))
    }
    pub(super) fn carry_out(&mut self, at: usize, effect: Effect) -> Check {
        match effect {
            Effect::Send { to, message } => return self.send(at, to, &message),
            Effect::Role(change) => {
                let label = self.label(at);
                self.note(format_args!(
                    "{label} {:?} of term {}, leader {:?}",
                    change.role, change.term, change.leader
                ));
                let (id, is_honest) = (self.copies[at].node.id, !self.copies[at].lies);
                if change.role == Role::Leader {
                    self.judge.leads(id, at, change.term);
                }
                let liars = self.copies[at].evidence.liars();
                if let Some(leader) = change.leader.filter(|leader| is_honest && liars.contains(leader)) {
                    let what = format!("{label} follows node {leader} in term {}", change.term);
                    return Err(Violation::new("nobody follows a liar of whom it has the proof", what));
                }
                return self.keeps_its_leader(at, change.term, change.leader);
            }
            Effect::Members { height, membership } => {
                self.note(format_args!("{} members at {height}: {membership:?}", self.label(at)));
            }
            Effect::Misbehaved(proof) => {
                let Some(up) = self.up(at) else { return Ok(()) };
                let mut found = Vec::new();
                up.disputes.found(*proof, &mut found);
                return self.follow(at, found);
            }
            Effect::Contradicted(found) => {
                self.note(format_args!("{} contradicted by {found:?}", self.label(at)));
                if let Some(up) = self.up(at) {
                    up.contradicting.insert(found.node);
                }
            }
            Effect::Ignored { from, reason } => {
                self.note(format_args!("{} ignores a message of n{from}: {reason}", self.label(at)));
            }
            Effect::Failed(reason) => {
                return Err(Violation::new("a node ends only for a reason", format!("{}: {reason}", self.label(at))));
            }
            Effect::Status(_)
            | Effect::Reconciles(_)
            | Effect::Read { .. }
            | Effect::Denied(_)
            | Effect::Refused { .. } => {}
            Effect::Behind { .. } => return self.fetch(at),
        }
        Ok(())
    }
    pub(super) fn begin_write(&mut self, at: usize) {
        let now = self.clocks(at);
        let Some(up) = self.up(at) else { return };
        if up.replica.must_write(now) && !std::mem::replace(&mut up.flushing, true) {
            let time = 50 + self.random.below(self.plan.disk_max);
            self.schedule_timer(at, time, Timer::Flushed);
        }
    }
    pub(super) fn flushed(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        up.flushing = false;
        let written = up.store.flush().map(drop);
        let inbox = std::mem::take(&mut up.inbox);
        self.step(at, Event::Written(written))?;
        self.execute(at)?;
        self.certify(at, certifier::Event::Time)?;
        self.turn(at, inbox)
    }
    pub(super) fn execute(&mut self, at: usize) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        let now = Circumstances { inputs_wait: false, other_is_idle: true };
        let Some(work) = up.replica.work(now) else { return Ok(()) };
        let executor = Arc::clone(&up.executor);
        let (Work::Here(entries) | Work::Elsewhere(entries)) = &work;
        for entry in entries {
            // A change of members counts from the next block on.
            let Membership { voters, .. } = executor.ledger().members().unwrap();
            let outcome = executor.execute(entry).map_err(|fault| {
                Violation::new("a node ends only for a reason", format!("block {}: {fault}", entry.index))
            })?;
            self.observe(at, entry, &outcome)?;
            if self.up(at).is_some_and(|up| up.replica.leads()) {
                self.is_held(at, entry, &voters)?;
            }
        }
        executor.look_at_deadline();
        let height = entries.last().map_or(0, |entry| entry.index);
        match work {
            Work::Here(_) => self.step(at, Event::Executed { height, took: 100 }),
            Work::Elsewhere(_) => {
                let at_clock = self.clocks(at).clock;
                self.step(at, Event::Input(Input::Applied { height, at: at_clock }))
            }
        }
    }
    /// A node has executed a block.
    pub(super) fn observe(&mut self, at: usize, entry: &Entry, outcome: &Outcome) -> Check {
        let (height, label) = (outcome.header.height, self.label(at));
        let codes: Vec<&str> = outcome.results.iter().map(|result| result.code().name()).collect();
        self.note(format_args!("{label} block {height} term {} {} {codes:?}", entry.term, outcome.hash));
        let now = self.now;
        let copy = &mut self.copies[at];
        copy.node.clock.observe(now, outcome.header.time);
        let (id, lies) = (copy.node.id, copy.lies);
        let Some(up) = &mut copy.up else { return Ok(()) };
        up.headers.insert(height, outcome.header.clone());
        let ledger = Arc::clone(&up.ledger);
        self.judge.executed(id, (height, entry.term), &entry.data, outcome.hash)?;
        self.control.executed(outcome);
        if !lies {
            self.done.extend(outcome.ids.iter().copied());
            let strict = ledger.voters().unwrap().rule.strict_since.is_some();
            self.judge.is_strict(id, height, strict)?;
        }
        if outcome.governs {
            let wanted = Desired::read(&**ledger.state()).unwrap();
            self.step(at, Event::Wanted(wanted))?;
        }
        if let Some(roots) = outcome.certifiable {
            let (time, block) = (outcome.header.time, outcome.hash);
            let block = Certifiable { height, time, block, results: roots.results };
            self.certify(at, certifier::Event::Executed { block, governs: outcome.governs })?;
        }
        if outcome.governs { self.certify(at, certifier::Event::Voters(era(&ledger))) } else { Ok(()) }
    }
    /// An honest leader executes what a majority of these voters has, liars whatever they say. A node that is down may have it.
    fn is_held(&self, at: usize, entry: &Entry, voters: &BTreeSet<u64>) -> Check {
        let leader = &self.copies[at];
        if leader.lies {
            return Ok(());
        }
        let holds = |id: &&u64| {
            let mut all = self.copies.iter().filter(|copy| copy.node.id == **id);
            all.any(|copy| match &copy.up {
                Some(up) if !copy.lies => up.entry(entry.index) == Some((entry.term, entry.data.clone())),
                _ => true,
            })
        };
        let holders: Vec<_> = voters.iter().filter(holds).collect();
        if 2 * holders.len() > voters.len() {
            return Ok(());
        }
        let what = format!("{} executes block {}, which {holders:?} of {voters:?} may have", leader.name, entry.index);
        Err(Violation::new("a leader counts only those who have its log", what))
    }
}
