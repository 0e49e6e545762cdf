//! The nodes of the network, and what they attest.

use super::{Judged, Person, Verdict};
use crate::people::organisation_of;
use ledger_identity::Role;
use ledger_rejection::Code;
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
}

#[derive(Deserialize)]
struct SetRole {
    id: u64,
    role: String,
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
        Self { nodes, proposed: BTreeMap::new(), attested: BTreeMap::new() }
    }

    fn present(&self, name: &str) -> bool {
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
        let voters = self.nodes.values().filter(|(_, role)| role == "voter").count();
        if role != "voter" && before == "voter" && voters == 1 {
            return Err(Code::LastOne);
        }
        let organisation = &who.identity.organisation;
        let own = name.split_once('/').is_some_and(|(of, _)| of == organisation) && role != "voter";
        if before == role {
            return Ok(Code::Ok.into());
        }
        let approvals = self.proposed.entry((id, role.clone())).or_default();
        approvals.insert(organisation.clone());
        if own || approvals.len() >= APPROVALS_MIN {
            self.proposed.remove(&(id, role.clone()));
            if role == "removed" {
                self.attested.remove(&name);
            }
            self.nodes.insert(id, (name, role));
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
