//! The nodes of the network: who shall vote and who shall follow.
//!
//! These records say what is wanted. The leader compares them with the members in fact and orders the changes that lead
//! there one by one. So a change of members is signed, on the ledger, and survives a change of the leader.

use super::NAME;
use super::store::{self, CERTIFICATE_RULE, MEMBERS_KEY, NODES, json, node_key};
use crate::chaincode::Context;
use crate::members::{Membership, NODES_MAX};
use crate::network::Genesis;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{CertificateRule, Voter, Voters};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Most records of nodes that were removed; beyond it the oldest is forgotten.
pub(super) const REMOVED_MAX: usize = 256;
/// Most records there can be.
pub(super) const RECORDS_MAX: usize = NODES_MAX + REMOVED_MAX;

/// The wanted role of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeRole {
    /// Orders.
    Voter,
    /// Only follows.
    Learner,
    /// Belongs to the network no longer; its id never comes back.
    Removed,
}

impl fmt::Display for NodeRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Voter => "voter",
            Self::Learner => "learner",
            Self::Removed => "removed",
        })
    }
}

/// The rules that a node speaks; argument of `speak`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Speaks {
    /// Number of the newest rules that it speaks.
    pub newest: u32,
    /// The release that it runs, for people.
    pub release: String,
}

/// A node as it stands on the ledger. Known by organisation and name, never by its certificate: a renewed certificate
/// changes nothing here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeRecord {
    /// Its number in the ordering protocol, never used again.
    pub id: u64,
    /// Common name of its certificate.
    pub name: String,
    /// Organisation that runs it.
    pub organisation: String,
    /// `HOST:PORT` under which others reach it.
    pub address: String,
    /// Its wanted role.
    pub role: NodeRole,
    /// Which rules it speaks; none if it has said nothing: then those in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speaks: Option<Speaks>,
}

impl NodeRecord {
    /// A node that has not said which rules it speaks.
    pub fn new(id: u64, [organisation, name]: [&str; 2], address: &str, role: NodeRole) -> Self {
        let [organisation, name, address] = [organisation, name, address].map(str::to_owned);
        Self { id, name, organisation, address, role, speaks: None }
    }

    /// The name that people see: `Org1/node1`.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }
}

/// Answer of `nodes`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Nodes {
    /// The records in order of ids: what is wanted.
    pub nodes: Vec<NodeRecord>,
    /// The members in fact; the leader leads them to what is wanted.
    pub members: Membership,
    /// How many signatures make a certificate.
    pub certificates: CertificateRule,
}

impl Nodes {
    /// The voters of the next block, and how many of them must sign.
    pub fn voters(&self) -> Voters {
        let voter = |node: &NodeRecord| Voter { organisation: node.organisation.clone(), name: node.name.clone() };
        Voters {
            nodes: self.nodes.iter().map(|node| (node.id, voter(node))).collect(),
            voters: self.members.voters.clone(),
            outgoing: self.members.outgoing.clone(),
            rule: self.certificates.clone(),
            // They count signatures here, and check none.
            recoveries: 0,
        }
    }
}

/// The wanted voters and learners, by the records.
pub fn desired<'a>(nodes: impl IntoIterator<Item = &'a NodeRecord>) -> (BTreeSet<u64>, BTreeSet<u64>) {
    let (mut voters, mut learners) = (BTreeSet::new(), BTreeSet::new());
    for node in nodes {
        match node.role {
            NodeRole::Voter => voters.insert(node.id),
            NodeRole::Learner => learners.insert(node.id),
            NodeRole::Removed => false,
        };
    }
    (voters, learners)
}

/// The numbers of nodes that have joined again, with the newer number under which the same node votes.
pub fn replacements(nodes: &[NodeRecord]) -> BTreeMap<u64, u64> {
    let voters = nodes.iter().filter(|node| node.role == NodeRole::Voter);
    let olds = voters.flat_map(|voter| {
        let is_old = |node: &&NodeRecord| {
            node.id < voter.id && (&node.organisation, &node.name) == (&voter.organisation, &voter.name)
        };
        nodes.iter().filter(is_old).map(|old| (old.id, voter.id))
    });
    olds.collect()
}

/// Does a change of the members lead to what these records want? It gives no vote to a node that shall have none, and takes none
/// from one that shall have it. The end of a joint change only completes it.
pub(crate) fn leads_to_wanted(before: &Membership, after: &Membership, nodes: &[NodeRecord]) -> bool {
    let (wanted, _) = desired(nodes);
    before.is_joint()
        || after.voters.difference(&before.voters).all(|node| wanted.contains(node))
            && before.voters.difference(&after.voters).all(|node| !wanted.contains(node))
}

/// The records of the founding nodes, and the next id.
pub(super) fn founding(genesis: &Genesis) -> (Vec<NodeRecord>, u64) {
    let nodes = genesis.nodes.iter().map(|node| {
        let role = if node.voter { NodeRole::Voter } else { NodeRole::Learner };
        NodeRecord::new(node.id, [&node.organisation, &node.name], &node.address, role)
    });
    (nodes.collect(), genesis.nodes.iter().map(|node| node.id).max().unwrap_or(0).saturating_add(1))
}

/// Every record, in order of ids.
pub(super) fn all(ctx: &Context<'_>) -> Result<Vec<NodeRecord>, Rejection> {
    store::list(ctx, NODES.as_bytes(), RECORDS_MAX)
}

/// The record that is not removed of that organisation and name.
pub(super) fn present(ctx: &Context<'_>, organisation: &str, name: &str) -> Result<Option<NodeRecord>, Rejection> {
    let of =
        |node: &NodeRecord| node.role != NodeRole::Removed && node.organisation == organisation && node.name == name;
    Ok(all(ctx)?.into_iter().find(of))
}

/// `nodes`
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    json(&Nodes { nodes: all(ctx)?, members: members(ctx)?, certificates: certificate_rule(ctx)? })
}

/// How many signatures make a certificate of the next block.
pub(super) fn certificate_rule(ctx: &Context<'_>) -> Result<CertificateRule, Rejection> {
    Ok(store::read(ctx, CERTIFICATE_RULE)?.unwrap_or_default())
}

/// The members in fact.
pub(super) fn members(ctx: &Context<'_>) -> Result<Membership, Rejection> {
    let key = MEMBERS_KEY.get(NAME.len() + 1..).unwrap_or_default();
    let record = ctx.get(key).ok_or_else(|| Rejection::new(Code::Corrupt, "the ledger contains no members"))?;
    store::parse(key, &record)
}

/// Writes a record.
pub(super) fn write(ctx: &mut Context<'_>, node: &NodeRecord) -> Result<(), Rejection> {
    store::write(ctx, &node_key(node.id), node)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_desired_follows_from_the_records_alone() {
        let node = |id, role| NodeRecord::new(id, ["Org1", &format!("node{id}")], &format!("h:{id}"), role);
        let nodes = [
            node(4, NodeRole::Learner),
            node(1, NodeRole::Voter),
            node(2, NodeRole::Removed),
            node(3, NodeRole::Voter),
        ];
        assert_eq!(desired(&nodes), ([1, 3].into(), [4].into()));
        assert_eq!(desired(&[]), (BTreeSet::new(), BTreeSet::new()));
    }
}
