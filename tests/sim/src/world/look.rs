//! The question with which a node starts, and what the others answer.

use super::start::secret;
use super::{Contact, Timer, World};
use crate::invariant::Check;
use ledger::Ledger;
use ledger::msp::{self, NodeRole};
use ledger_raft::ReceiptKey;
use ledger_replica::catch_up::{Heard, Holding, Offer, Stage, Who};
use ledger_replica::conductor::Happened;
use std::sync::Arc;

impl World {
    /// Those that a node would ask, as far as its ledger knows them; a newcomer asks one that let it in as well.
    pub(super) fn asked_by(&mut self, id: u64, ledger: &Ledger) -> Vec<Who> {
        let records = msp::nodes(&**ledger.state()).unwrap();
        let members = ledger.members().unwrap();
        let present = |id: u64, role| role != NodeRole::Removed || members.contains(id);
        let mut asked: Vec<Who> = records
            .iter()
            .filter(|record| record.id != id && present(record.id, record.role))
            .map(|record| Who {
                id: record.id,
                organisation: record.organisation.clone(),
                name: record.full_name(),
                vouched: false,
            })
            .collect();
        if records.iter().all(|record| record.id != id) {
            let known: Vec<u64> = self.newest_members().voters.iter().copied().collect();
            let door = self.random.nodes.pick(&known).copied().unwrap_or_default();
            asked.push(Who { id: door, organisation: String::new(), name: format!("node{door}"), vouched: true });
        }
        asked
    }

    /// Is there a way between two nodes, and does the other one answer? None if it is silent, `false` if it refuses.
    pub(super) fn answers(&self, id: u64, peer: u64) -> Option<bool> {
        let node = self.nodes.get(&peer)?;
        let is_silent = node.lost || self.links.is_cut((id, peer)) || self.links.is_cut((peer, id));
        if is_silent || node.paused_until > self.now {
            return None;
        }
        Some(node.up.is_some())
    }

    /// The answer of a node about its blocks.
    pub(super) fn holding(&self, peer: u64, asking: u64) -> Option<Holding> {
        let running = self.nodes.get(&peer)?.up.as_ref()?;
        let status = running.replica.as_ref().map(ledger_replica::Replica::status);
        let stores = (&*running.ledger, &*running.store, &*running.snapshots);
        Some(Holding::of(stores, status.as_ref(), (asking, None), &ReceiptKey::new(peer, &secret(peer))))
    }

    /// A node that has started asks all others at the same time.
    pub(super) fn ask_all(&mut self, id: u64, asked: &[Who]) -> Check {
        self.invariants.informed_votes.asks(id, asked.len() as u64);
        for who in asked {
            let way = self.links.client(self.now, &mut self.random.network, &mut self.coverage);
            if let (Some(_), Some(at)) = (self.answers(id, who.id), way) {
                self.schedule_timer(id, at - self.now, Timer::Answered(who.id));
            }
        }
        self.looked(id, None)
    }

    /// A node that was asked answers, or refuses.
    pub(super) fn answered_question(&mut self, id: u64, peer: u64) -> Check {
        let has = match self.answers(id, peer) {
            None => return Ok(()),
            Some(false) => None,
            Some(true) => self.holding(peer, id),
        };
        self.looked(id, Some((peer, has)))
    }

    /// Goes on with the question; the first engine may start then.
    pub(super) fn looked(&mut self, id: u64, answer: Option<(u64, Option<Holding>)>) -> Check {
        let now = self.now;
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let before = running.look.stage();
        if before == Stage::Closed && running.begun {
            return Ok(());
        }
        let heard = match &answer {
            None => running.look.step(now, Heard::Time),
            Some((_, None)) => running.look.step(now, Heard::Refusal),
            Some((peer, Some(has))) => {
                running.heard.push(has.clone());
                let who = Who { id: *peer, organisation: String::new(), name: format!("node{peer}"), vouched: false };
                running.look.step(now, Heard::Answer(&who, has))
            }
        };
        if answer.is_some() {
            self.invariants.informed_votes.answered(id);
        }
        let stage = match heard {
            Ok(stage) => stage,
            Err(lost) => return self.failed(id, &lost.to_string()),
        };
        if stage == Stage::Closed {
            self.invariants.informed_votes.closed(id);
        }
        if let Some(due) = running.look.due().filter(|due| *due != running.look_at) {
            running.look_at = due;
            self.schedule_timer(id, due.saturating_sub(now), Timer::Look);
        }
        let Some(running) = self.running(id) else { return Ok(()) };
        if stage != Stage::Asking && !std::mem::replace(&mut running.begun, true) {
            let heard = std::mem::take(&mut running.heard);
            return self.conduct(id, Happened::Looked(heard));
        }
        Ok(())
    }

    /// The answers of those that are asked while a node catches up.
    pub(super) fn offers(&mut self, id: u64) -> Vec<Offer<Contact>> {
        let Some(ledger) = self.running(id).map(|running| Arc::clone(&running.ledger)) else { return Vec::new() };
        let asked = self.asked_by(id, &ledger);
        let mut offers = Vec::new();
        for who in asked {
            let way = self.links.client(self.now, &mut self.random.network, &mut self.coverage);
            if let (Some(true), Some(_)) = (self.answers(id, who.id), way)
                && let Some(has) = self.holding(who.id, id)
            {
                let peer = Contact { id: who.id, vouched: who.vouched };
                offers.push(Offer { who, has, peer });
            }
        }
        offers
    }
}
