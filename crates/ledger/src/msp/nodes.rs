//! The nodes of the network: who shall vote and who shall follow.
//!
//! These records say what is wanted. The leader compares them with the members in fact and orders the changes that lead
//! there one by one. So a change of members is signed, on the ledger, and survives a change of the leader.

use super::SET_NODE_ROLE;
use super::address::check_address;
use super::allowance;
use super::caller::{admin, node, object};
use super::own_call::own_call;
use super::proposals::{Decision, decide};
use super::rules::Speaks;
use super::store::{self, MEMBERS_KEY, NEXT_NODE, NODES, json, node_key};
use super::{NAME, attestations, carriers, joins, refusals, rules};
use crate::chaincode::Context;
use crate::members::{Membership, NODES_MAX};
use crate::network::Genesis;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;

/// Most records of nodes that were removed; beyond it the oldest is forgotten.
const REMOVED_MAX: usize = 256;
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
    json(&Nodes { nodes: all(ctx)?, members: members(ctx)? })
}

/// The members in fact.
pub(super) fn members(ctx: &Context<'_>) -> Result<Membership, Rejection> {
    let key = MEMBERS_KEY.get(NAME.len() + 1..).unwrap_or_default();
    let record = ctx.get(key).ok_or_else(|| Rejection::new(Code::Corrupt, "the ledger holds no members"))?;
    store::parse(key, &record)
}

/// Argument of `join_node`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JoinNode {
    /// `HOST:PORT` under which others reach it.
    pub address: String,
    /// Its name, if it wants to be sure that its certificate says the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// It has lost its disk: its old record is removed and it gets a new id.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub replace: bool,
}

/// `join_node {address, name?, replace?}`: a node brings itself in as a learner, or tells its new address.
pub(super) fn join(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let join: JoinNode = object("join_node", argument, "{\"address\": \"HOST:PORT\"}")?;
    let caller = node(ctx, "join as a node")?;
    if let Some(name) = join.name.filter(|name| *name != caller.name) {
        return Err(Rejection::new(Code::BadArgument, "a node joins under the name in its certificate")
            .found(format!("{:?}", name.chars().take(80).collect::<String>()))
            .wanted(format!("{:?}", caller.name)));
    }
    check_address(&join.address)?;
    let nodes = all(ctx)?;
    let live = || nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let own = |node: &&NodeRecord| node.organisation == caller.organisation && node.name == caller.name;
    let before = live().find(own);
    if let Some(other) = live().find(|node| node.address == join.address && !own(node)) {
        return Err(Rejection::new(Code::AlreadyExists, format!("address {} is taken", join.address))
            .found(format!("node {} ({})", other.id, other.full_name()))
            .wanted("an address under which the others reach this node and no other")
            .next("give this node another address or port"));
    }
    match before {
        Some(before) if !join.replace => {
            if before.address == join.address {
                return json(before);
            }
            let node = NodeRecord { address: join.address, ..before.clone() };
            write(ctx, &node)?;
            ctx.emit("moved", &node.full_name(), json(&node)?);
            return json(&node);
        }
        Some(before) => change_role(ctx, &nodes, before, NodeRole::Removed)?,
        None => check_room(ctx, caller, live())?,
    }
    joins::count(ctx, &caller.organisation)?;
    let id = store::next_number(ctx, NEXT_NODE)?;
    let node = NodeRecord::new(id, [&caller.organisation, &caller.name], &join.address, NodeRole::Learner);
    write(ctx, &node)?;
    ctx.emit("joined", &node.full_name(), json(&node)?);
    json(&node)
}

fn check_room<'a>(
    ctx: &Context<'_>,
    caller: &Identity,
    live: impl Iterator<Item = &'a NodeRecord>,
) -> Result<(), Rejection> {
    let allowed = allowance::of(ctx, &caller.organisation)?;
    let (mut nodes, mut own) = (0, 0);
    for node in live {
        nodes += 1;
        own += usize::from(node.organisation == caller.organisation);
    }
    for (found, max, whose) in [(nodes, NODES_MAX, "the network"), (own, allowed, caller.organisation.as_str())] {
        if found >= max {
            return Err(Rejection::new(Code::LimitExceeded, format!("{whose} has no room for another node"))
                .found(format!("{found} nodes"))
                .wanted(format!("at most {max}"))
                .next("ledgerctl network remove NODE; organisations allow more with msp allow_nodes"));
        }
    }
    Ok(())
}

/// Argument of `set_node_role`: the node by id, or by organisation and name. A proposal names all three.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetNodeRole {
    /// Its number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// Its organisation, together with `name`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub organisation: Option<String>,
    /// Its name, together with `organisation`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its wanted role.
    pub role: NodeRole,
}

impl SetNodeRole {
    /// The wish for a role of this node.
    fn of(node: &NodeRecord, role: NodeRole) -> Self {
        let (organisation, name) = (Some(node.organisation.clone()), Some(node.name.clone()));
        Self { id: Some(node.id), organisation, name, role }
    }
}

/// `set_node_role {id | organisation, name; role}`: an organisation takes votes from its own nodes and removes them
/// alone; everything else concerns all and needs their approval.
pub(super) fn set_role(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"id\": NUMBER, \"role\": \"voter\", \"learner\" or \"removed\"}, or organisation and name for id";
    let set: SetNodeRole = object("set_node_role", argument, wanted)?;
    let alone = match ctx.approved_by() {
        Some(_) => None,
        None => Some(admin(ctx, "decide what nodes shall be")?),
    };
    let nodes = all(ctx)?;
    let node = match (&set.id, &set.organisation, &set.name) {
        (Some(id), None, None) => nodes.iter().find(|node| node.id == *id),
        (Some(id), Some(organisation), Some(name)) => {
            nodes.iter().find(|node| node.id == *id && node.organisation == *organisation && node.name == *name)
        }
        (None, Some(organisation), Some(name)) => nodes
            .iter()
            .rfind(|node| node.organisation == *organisation && node.name == *name && node.role != NodeRole::Removed),
        _ => {
            return Err(Rejection::new(Code::BadArgument, "msp set_node_role names no node")
                .wanted("id, or organisation and name, or all three"));
        }
    };
    let Some(node) = node else { return Err(no_such_node(&nodes)) };
    check_change(ctx, &nodes, node, set.role)?;
    let needs_approval = |caller: &&Identity| {
        node.role != set.role && (node.organisation != caller.organisation || set.role == NodeRole::Voter)
    };
    let Some(caller) = alone.filter(needs_approval) else {
        put_role(ctx, node, set.role)?;
        return json(&Decision::done(None));
    };
    json(&decide(ctx, caller, own_call(SET_NODE_ROLE, &SetNodeRole::of(node, set.role))?)?)
}

/// Removes the nodes of an organisation that leaves.
pub(super) fn remove_all_of(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let nodes = all(ctx)?;
    let (voters, _) = desired(nodes.iter().filter(|node| node.organisation != organisation));
    if voters.is_empty() {
        return Err(Rejection::new(Code::LastOne, format!("{organisation} runs the last voters"))
            .wanted("a voter of another organisation")
            .next("ledgerctl network promote NODE"));
    }
    for node in nodes.iter().filter(|node| node.organisation == organisation && node.role != NodeRole::Removed) {
        put_role(ctx, node, NodeRole::Removed)?;
    }
    Ok(())
}

fn change_role(
    ctx: &mut Context<'_>,
    nodes: &[NodeRecord],
    node: &NodeRecord,
    role: NodeRole,
) -> Result<(), Rejection> {
    check_change(ctx, nodes, node, role)?;
    put_role(ctx, node, role)
}

fn check_change(ctx: &Context<'_>, nodes: &[NodeRecord], node: &NodeRecord, role: NodeRole) -> Result<(), Rejection> {
    if node.role == NodeRole::Removed && role != NodeRole::Removed {
        return Err(Rejection::new(Code::NotAMember, format!("node {} ({}) was removed", node.id, node.full_name()))
            .wanted("a node of the network; numbers are never used again")
            .next("let it join again as a new node: ledgerctl network invite --node NAME"));
    }
    if role == NodeRole::Voter {
        rules::check_voter(ctx, node)?;
    }
    let (voters, _) = desired(nodes);
    if role != NodeRole::Voter && voters.len() == 1 && voters.contains(&node.id) {
        return Err(Rejection::new(
            Code::LastOne,
            format!("node {} ({}) is the last voter", node.id, node.full_name()),
        )
        .wanted("another voter, which goes on ordering")
        .next("ledgerctl network promote NODE"));
    }
    Ok(())
}

/// Wants another role of a node, and tells of it.
pub(super) fn put_role(ctx: &mut Context<'_>, node: &NodeRecord, role: NodeRole) -> Result<(), Rejection> {
    if node.role == role {
        return Ok(());
    }
    let node = NodeRecord { role, ..node.clone() };
    write(ctx, &node)?;
    if role == NodeRole::Removed {
        attestations::forget(ctx, &node);
        refusals::forget(ctx, &node);
        carriers::forget(ctx, &node)?;
        forget_removed(ctx)?;
    }
    ctx.emit("role_changed", &node.full_name(), json(&node)?);
    Ok(())
}

/// Forgets the oldest removed record beyond the limit. The counter of ids still knows it, so its id stays used.
fn forget_removed(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    let nodes = store::list::<NodeRecord>(ctx, NODES.as_bytes(), RECORDS_MAX + 1)?;
    let removed: Vec<_> = nodes.iter().filter(|node| node.role == NodeRole::Removed).collect();
    if let (Some(oldest), true) = (removed.first(), removed.len() > REMOVED_MAX) {
        ctx.delete(node_key(oldest.id).as_bytes());
    }
    Ok(())
}

/// Writes a record.
pub(super) fn write(ctx: &mut Context<'_>, node: &NodeRecord) -> Result<(), Rejection> {
    store::write(ctx, &node_key(node.id), node)
}

fn no_such_node(nodes: &[NodeRecord]) -> Rejection {
    let live = nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let names: Vec<_> = live.map(|node| format!("{} ({})", node.id, node.full_name())).collect();
    Rejection::new(Code::NotFound, "the network has no such node").wanted(format!("one of {}", names.join(", ")))
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
