//! The nodes of the network, and what they attest.

use super::{Judged, Person, Verdict};
use crate::people::organisation_of;
use ledger::members::Membership;
use ledger::{Activation, Rules};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// More than half of three organisations.
const APPROVALS_MIN: usize = 2;

/// Every node that ever was.
#[derive(Clone)]
pub(super) struct Nodes {
    /// By number: organisation and name, and the role.
    nodes: BTreeMap<u64, (String, String)>,
    /// The organisations that want a node to have a role.
    proposed: BTreeMap<(u64, String), BTreeSet<String>>,
    /// Greatest height that a node has attested, and of a snapshot.
    attested: BTreeMap<String, (u64, u64)>,
    /// The newest rules that a node said it speaks.
    speaks: BTreeMap<u64, u32>,
    /// The rules that the network was founded with, and those that followed.
    rules: Vec<Activation>,
    /// The organisations that want an activation.
    wanted: BTreeMap<(u32, Option<u64>), BTreeSet<String>>,
    /// The next block, and the members before it.
    next: (u64, Membership),
    /// Certificates are strict, so that no organisation makes them weaker alone.
    strict: bool,
}

#[derive(Deserialize)]
struct SetRole {
    id: u64,
    role: String,
}

#[derive(Deserialize)]
struct Speaks {
    newest: u32,
}

#[derive(Deserialize)]
struct Activate {
    number: u32,
    height: Option<u64>,
}

#[derive(Deserialize)]
struct Attest {
    height: u64,
    content: Option<String>,
}

impl Nodes {
    pub(super) fn founded(voters: u64, learners: u64, organisations: usize) -> Self {
        let node = |id| {
            let role = if id <= voters { "voter" } else { "learner" };
            (id, (format!("{}/node{id}", organisation_of(id, organisations)), role.to_owned()))
        };
        let nodes = (1..=voters + learners).map(node).collect();
        Self {
            nodes,
            proposed: BTreeMap::new(),
            attested: BTreeMap::new(),
            speaks: BTreeMap::new(),
            rules: vec![Activation { number: Rules::NEWEST.number(), height: 0 }],
            wanted: BTreeMap::new(),
            next: (1, Membership::new(1..=voters, voters + 1..=voters + learners)),
            strict: false,
        }
        .settled()
    }

    /// With strict certificates, where the voters allow it.
    fn settled(mut self) -> Self {
        let Membership { voters, outgoing, .. } = &self.next.1;
        self.strict |= outgoing.is_empty() && self.spares_one(voters) && self.spares_one(&self.voters());
        self
    }

    /// The voters by their roles.
    fn voters(&self) -> BTreeSet<u64> {
        self.nodes.iter().filter(|(_, (_, role))| role == "voter").map(|(id, _)| *id).collect()
    }

    /// Without any one of these voters, the rest is still more than half of all and the largest organisation's together.
    fn spares_one(&self, voters: &BTreeSet<u64>) -> bool {
        let mut largest = BTreeMap::<&str, usize>::new();
        for (name, _) in voters.iter().filter_map(|id| self.nodes.get(id)) {
            *largest.entry(name.split('/').next().unwrap_or_default()).or_default() += 1;
        }
        let largest = largest.into_values().max().unwrap_or_default();
        2 * voters.len() > voters.len() + largest + 2
    }

    /// Later calls are executed in the block of this height, or judged by its rules.
    pub(super) fn next(&mut self, height: u64, members: &Membership) {
        self.next = (height, members.clone());
        *self = self.clone().settled();
    }

    /// The rules of the last block instead of those of the next; answers whether they are others.
    pub(super) fn keep_rules(&mut self) -> bool {
        let newest = self.active();
        self.next.0 -= 1;
        self.active() != newest
    }

    /// The height of the next block.
    pub(super) fn height(&self) -> u64 {
        self.next.0
    }

    pub(super) fn active(&self) -> u32 {
        let reached = self.rules.iter().rfind(|activation| activation.height <= self.next.0);
        reached.map_or(0, |activation| activation.number)
    }

    fn pending(&self) -> Option<u32> {
        self.rules.last().map(|last| last.number).filter(|number| *number > self.active())
    }

    fn speaks(&self, id: u64) -> u32 {
        self.speaks.get(&id).copied().unwrap_or(self.active())
    }

    pub(super) fn speak(&mut self, who: &Person, argument: &str) -> Verdict {
        let Speaks { newest } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        let own = self.nodes.iter().find(|(_, (name, role))| *name == who.id() && role != "removed");
        let (id, _) = own.ok_or(Code::NotAMember)?;
        self.speaks.insert(*id, newest);
        Ok(Code::Ok.into())
    }

    pub(super) fn activate(&mut self, who: &Person, argument: &str) -> Verdict {
        let Activate { number, height } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        if who.identity.role != Role::Admin {
            return Err(Code::NotAdmin);
        }
        if number <= self.active() {
            return Err(Code::BadArgument);
        }
        if self.pending().is_some() {
            return Err(Code::AlreadyExists);
        }
        let votes = |id: &u64, role: &str| role == "voter" || self.next.1.is_voter(*id);
        if self.nodes.iter().any(|(id, (_, role))| votes(id, role) && self.speaks(*id) < number) {
            return Err(Code::RulesNotSpoken);
        }
        let approvals = self.wanted.entry((number, height)).or_default();
        approvals.insert(who.identity.organisation.clone());
        if approvals.len() >= APPROVALS_MIN {
            self.wanted.clear();
            let next = self.next.0 + 1;
            self.rules.push(Activation { number, height: height.map_or(next, |height| height.max(next)) });
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn present(&self, name: &str) -> bool {
        self.nodes.values().any(|(node, role)| node == name && role != "removed")
    }

    pub(super) fn join(&mut self, who: &Person, _address: &str) -> Verdict {
        if !self.present(&who.id()) {
            let next = self.nodes.keys().next_back().map_or(1, |last| last + 1);
            self.nodes.insert(next, (who.id(), "learner".to_owned()));
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn set_role(&mut self, who: &Person, argument: &str) -> Verdict {
        let SetRole { id, role } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        if who.identity.role != Role::Admin {
            return Err(Code::NotAdmin);
        }
        let (name, before) = self.nodes.get(&id).cloned().ok_or(Code::NotFound)?;
        if before == "removed" && role != "removed" {
            return Err(Code::NotAMember);
        }
        if role == "voter" && self.pending().is_some_and(|number| self.speaks(id) < number) {
            return Err(Code::RulesNotSpoken);
        }
        let voters = self.nodes.values().filter(|(_, role)| role == "voter").count();
        if role != "voter" && before == "voter" && voters == 1 {
            return Err(Code::LastOne);
        }
        let organisation = &who.identity.organisation;
        let own = name.split_once('/').is_some_and(|(of, _)| of == organisation) && role != "voter";
        if before == role {
            return Ok(Code::Ok.into());
        }
        let mut after = self.clone();
        after.nodes.insert(id, (name.clone(), role.clone()));
        let ends = self.strict && self.spares_one(&self.voters()) && !after.spares_one(&after.voters());
        let approvals = self.proposed.entry((id, role.clone())).or_default();
        approvals.insert(organisation.clone());
        if (own && !ends) || approvals.len() >= APPROVALS_MIN {
            self.proposed.remove(&(id, role.clone()));
            if role == "removed" {
                self.attested.remove(&name);
            }
            self.nodes.insert(id, (name, role));
            self.strict &= !ends;
            *self = self.clone().settled();
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn attest(&mut self, who: &Person, argument: &str) -> Verdict {
        let Attest { height, content } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        if !self.present(&who.id()) {
            return Err(Code::NotAMember);
        }
        let (latest, snapshot) = self.attested.entry(who.id()).or_default();
        if height < if content.is_some() { *snapshot } else { *latest } {
            return Err(Code::BadArgument);
        }
        *latest = height.max(*latest);
        if content.is_some() {
            *snapshot = height;
        }
        Ok(Judged::from(Code::Ok))
    }
}
