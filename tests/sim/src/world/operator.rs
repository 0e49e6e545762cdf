//! The operator of the network takes out broken nodes, and puts new ones in their place.

use super::{Event, World, address, clock};
use crate::client::Call;
use crate::clock::{EPOCH, MILLISECOND};
use crate::coverage::Fault;
use crate::invariant::{Check, Violation};
use crate::node::Node;
use crate::people::organisation_of;
use ledger::Rules;
use ledger::block::Payload;
use ledger::members::spare_one;
use ledger::msp::NodeRole;
use ledger_raft::{Desired, TIME_AHEAD_MAX};
use ledger_storage::segment::{Found, LogPosition, scan};
use std::collections::BTreeSet;

/// A node whose disk is lost, and the new one that takes its place.
#[derive(Clone, Copy, Debug)]
pub struct Replacement {
    /// Is taken out.
    pub lost: u64,
    /// Comes in.
    pub new: u64,
}

impl World {
    /// May this node's disk be lost? The promise is about a majority of the voters, so it happens to one at a time.
    pub(super) fn may_lose(&self, id: u64) -> bool {
        let members = self.newest_members();
        let healthy = self.nodes.values().all(|node| node.damaged.is_none());
        // Everybody must know who is needed: one who does not know of the last change would wait for the lost one.
        let known = members.voters.iter().filter(|voter| **voter != id).all(|voter| {
            let replica = self.nodes.get(voter).and_then(|node| node.up.as_ref()?.replica.as_ref());
            replica.is_some_and(|replica| replica.status().membership == *members)
        });
        let in_time = members.voters.iter().filter(|voter| **voter != id).all(|voter| self.is_in_time(*voter));
        let settled = self.replacement.is_none() && self.is_settled() && healthy && known;
        settled
            && in_time
            && self.may_come(Some(id))
            && members.voters.len() >= 3
            && (members.voters.contains(&id) || members.learners.contains(&id))
    }

    /// Does the log of this node hold no block that is ahead of its time? Clocks of a majority that are wrong at once leave such
    /// blocks in logs, and the others refuse them until their time has come. With one voter less, nobody goes on meanwhile.
    fn is_in_time(&self, id: u64) -> bool {
        let store = self.nodes.get(&id).and_then(|node| Some(&node.up.as_ref()?.store));
        let last = store.and_then(|store| store.entries(store.last_index()..store.last_index() + 1, 0).ok());
        let time = last
            .iter()
            .flatten()
            .filter_map(|entry| Payload::from_bytes(entry.data.clone()).ok())
            .map(|found| found.time);
        time.max().is_none_or(|time| time <= EPOCH + self.now + TIME_AHEAD_MAX)
    }

    /// A bit flips in what a node had on its disk for sure; it must find out when it starts again.
    pub(super) fn flip(&mut self, id: u64) {
        // While it stands still, or while it runs and may read it.
        if self.random.faults.percent(60) {
            self.stop(id, false);
            let delay = self.random.faults.between(2, 2_000) * MILLISECOND;
            self.schedule(delay, Event::Start { node: id });
        }
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let mut records = Vec::new();
        let mut proven = LogPosition::default();
        for found in scan(&node.disk, None).into_iter().flatten().flatten() {
            if let Found::Record { file, position, bytes, durable_upto, .. } = found {
                records.push((file, position, bytes));
                proven = durable_upto;
            }
        }
        records.retain(|(_, position, bytes)| {
            (position.sequence, position.offset + bytes) <= (proven.sequence, proven.offset)
        });
        let Some((file, position, bytes)) = self.random.faults.pick(&records).cloned() else { return };
        let at = u64::from(position.offset) + self.random.faults.below(u64::from(bytes));
        node.disk.flip(&file, at * 8 + self.random.faults.below(8));
        node.damaged = Some(file.to_string());
        self.coverage.fault(Fault::BitFlip);
        self.note(format_args!("n{id} has a flipped bit at {file} byte {at}"));
    }

    /// A node has started although a bit of its log is not what it was.
    pub(super) fn undetected(&self, id: u64, file: &str) -> Check {
        Err(Violation::new("damage is refused", format!("node {id} starts with a damaged {file}")))
    }

    /// Puts a new node in the place of one that is lost, if that was still wanted.
    pub(super) fn replace(&mut self, lost: u64) {
        let Desired { voters, learners, .. } = &self.desired;
        if !voters.contains(&lost) && !learners.contains(&lost) {
            return;
        }
        let new = self.newcomer();
        if self.desired.voters.remove(&lost) {
            self.desired.voters.insert(new);
        } else if self.desired.learners.remove(&lost) {
            self.desired.learners.insert(new);
        }
        self.replacement = Some(Replacement { lost, new });
        self.note(format_args!("n{new} takes the place of n{lost}"));
    }

    /// Could a new node catch up, without this one? Where old blocks are dropped it needs a snapshot that nodes of two
    /// organisations attest; those of one that has no other node are locked out.
    pub(super) fn may_come(&self, without: Option<u64>) -> bool {
        let present = self.desired.voters.union(&self.desired.learners).filter(|id| Some(**id) != without);
        let organisations: BTreeSet<String> = present.map(|id| organisation_of(*id, self.plan.organisations)).collect();
        !self.plan.faults.contains(&Fault::Pruning) || organisations.len() > 1
    }

    /// A new machine, with a number that nobody had.
    pub(super) fn newcomer(&mut self) -> u64 {
        let new = self.nodes.keys().next_back().map_or(1, |last| last + 1);
        let clock = clock(&mut self.random.faults, self.plan.faults.contains(&Fault::ClockDrift));
        let mut node = Node::new(new, self.random.disk.number(), clock);
        if self.plan.faults.contains(&Fault::Pruning) {
            node.keep = Some(self.random.faults.between(5, 60));
        }
        self.nodes.insert(new, node);
        self.schedule(MILLISECOND, Event::Start { node: new });
        new
    }

    /// Looks whether a replacement is complete, and takes the next step towards what is wanted.
    pub(super) fn operate(&mut self) -> Check {
        self.schedule(300 * MILLISECOND, Event::Operator);
        if let Some(Replacement { lost, new }) = self.replacement.filter(|_| self.is_settled()) {
            self.note(format_args!("n{new} has taken the place of n{lost}"));
            self.replacement = None;
        }
        self.release()?;
        let (operating, turn) = self.operating;
        if operating.is_some_and(|client| !self.clients[client].orders.is_empty()) {
            return Ok(());
        }
        if let Some((person, call)) = self.next_order(turn).or_else(|| self.next_rules(turn)) {
            self.note(format_args!("{person} is asked for {call:?}"));
            self.operating = (Some(self.employ_for(&person, vec![call], true)), turn + 1);
        }
        Ok(())
    }

    /// The next transaction towards the wanted members, and who signs it. One at a time, so that a new node gets the
    /// number that it is known by here.
    fn next_order(&self, turn: usize) -> Option<(String, Call)> {
        let organisations = self.plan.organisations;
        let Desired { voters, learners, .. } = &self.desired;
        let role = |id: &u64| self.records.iter().find(|record| record.id == *id).map(|record| record.role);
        let own_admin = |id: u64| format!("{}/admin", organisation_of(id, organisations));
        if let Some(new) = voters.union(learners).find(|id| role(id).is_none()) {
            let node = format!("{}/node{new}", organisation_of(*new, organisations));
            return Some((node, Call::Join { address: address(*new) }));
        }
        if let Some(id) = voters.iter().find(|id| role(id) != Some(NodeRole::Voter)) {
            // A vote needs the approval of most organisations: each of them says the same in its turn.
            return Some((format!("Org{}/admin", 1 + turn % 3), Call::SetRole { id: *id, role: "voter" }));
        }
        // Its own organisation takes a vote away alone. Where that ends strict certificates, each of them says the same, too.
        let admin = |id: u64| match self.would_end_strict(id) {
            true => format!("Org{}/admin", 1 + turn % 3),
            false => own_admin(id),
        };
        if let Some(id) = learners.iter().find(|id| role(id) != Some(NodeRole::Learner)) {
            return Some((admin(*id), Call::SetRole { id: *id, role: "learner" }));
        }
        let present = self.records.iter().filter(|record| record.role != NodeRole::Removed).map(|record| record.id);
        let gone = present.filter(|id| !voters.contains(id) && !learners.contains(id)).min()?;
        if !self.nobody_is_left_behind_without(gone) {
            return None;
        }
        Some((admin(gone), Call::SetRole { id: gone, role: "removed" }))
    }

    /// Are certificates strict, and would they not be without the vote of this node?
    fn would_end_strict(&self, id: u64) -> bool {
        let (voters, _) = ledger::msp::desired(&self.records);
        let hand = |id: &u64| (*id, organisation_of(*id, self.plan.organisations));
        let (hands, without) = (voters.iter().map(hand).collect(), voters.iter().copied().filter(|voter| *voter != id));
        self.strict.last() == Some(&true) && spare_one(&voters, &hands) && !spare_one(&without.collect(), &hands)
    }

    /// Does each wanted node that is the only one of its organisation, once this one is gone, know the members? One that does
    /// not would find too few of the voters that it knows, and nobody else that it may believe. So a careful operator removes
    /// nobody meanwhile. Nodes that go next may be switched off already, and are not waited for.
    fn nobody_is_left_behind_without(&self, gone: u64) -> bool {
        let present = self.records.iter().filter(|record| record.role != NodeRole::Removed);
        let Desired { voters, learners, .. } = &self.desired;
        let wanted = |id: &u64| voters.contains(id) || learners.contains(id);
        let stay = |id: &u64| *id != gone && wanted(id) && !self.nodes[id].lost;
        let present: Vec<u64> = present.map(|record| record.id).filter(stay).collect();
        let organisation = |id: &u64| organisation_of(*id, self.plan.organisations);
        let is_alone = |id: &u64| present.iter().filter(|other| organisation(other) == organisation(id)).count() == 1;
        let knows = |id: &u64| {
            let replica = self.nodes.get(id).and_then(|node| node.up.as_ref()?.replica.as_ref());
            replica.is_some_and(|replica| replica.status().membership == *self.newest_members())
        };
        present.iter().filter(|id| is_alone(id)).all(knows)
    }

    /// Now and then, a newer release is installed on a node. Learners may have to wait until they stop.
    fn release(&mut self) -> Check {
        let older =
            |id: &u64| self.nodes.get(id).is_some_and(|node| node.up.is_some() && node.speaks != Rules::OF_TESTS);
        if !self.plan.activates {
            return Ok(());
        }
        let Some(id) = self.desired.voters.iter().copied().find(older) else { return Ok(()) };
        if self.random.nodes.percent(10) { self.upgrade(id) } else { Ok(()) }
    }

    /// The next transaction towards newer rules: the nodes say that they speak them, then the organisations activate them.
    fn next_rules(&mut self, turn: usize) -> Option<(String, Call)> {
        let (number, height) = (Rules::OF_TESTS.number(), self.blocks.len() as u64);
        let newest = self.invariants.rules_by_height.newest();
        if !self.plan.activates || newest == number || !self.is_settled() {
            return None;
        }
        let silent = self.records.iter().find(|record| {
            let speaks = record.speaks.as_ref().is_some_and(|speaks| speaks.newest == number);
            let newer = self.nodes.get(&record.id).is_some_and(|node| node.speaks == Rules::OF_TESTS);
            record.role != NodeRole::Removed && !speaks && newer
        });
        if let Some(record) = silent {
            return Some((record.full_name(), Call::Speak { newest: number }));
        }
        let ahead = self.random.nodes.between(2, 40);
        let height = *self.activation.get_or_insert(height + ahead);
        Some((format!("Org{}/admin", 1 + turn % 3), Call::Activate { number, height }))
    }

    /// Do the records on the ledger say what the operator wants?
    pub(crate) fn is_recorded(&self) -> bool {
        let (voters, learners) = ledger::msp::desired(&self.records);
        voters == self.desired.voters && learners == self.desired.learners
    }

    /// Are the members what the operator wants?
    pub(crate) fn is_settled(&self) -> bool {
        let members = self.newest_members();
        let same = members.voters == self.desired.voters && members.learners == self.desired.learners;
        same && !members.is_joint()
    }
}
