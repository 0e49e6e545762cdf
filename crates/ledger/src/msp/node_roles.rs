//! Changes of the wanted roles of nodes.

use super::arguments::SetNodeRole;
use super::caller::{admin, object};
use super::nodes::{NodeRecord, NodeRole, RECORDS_MAX, REMOVED_MAX, all, desired, write};
use super::own_call::own_call;
use super::proposals::{Decision, decide};
use super::store::{self, NODES, json, node_key};
use super::{SET_NODE_ROLE, attestations, carriers, certificate_rule, misbehaviour, refusals, rules};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;

/// `set_node_role {id | organisation, name; role; proof}`: an organisation takes votes from its own nodes and removes them
/// alone; everything else concerns all and needs their approval. With the proof that the node has lied, its organisation need
/// not approve that it votes no more.
pub(super) fn set_role(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"id\": NUMBER, \"role\": \"voter\", \"learner\" or \"removed\"}, or organisation and name for id";
    let set: SetNodeRole = object("set_node_role", argument, wanted)?;
    let alone = match ctx.approved_by() {
        Some(_) => None,
        None => Some(admin(ctx, "change the roles of nodes")?),
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
    if let Some(proof) = &set.proof {
        misbehaviour::check(ctx, &nodes, (node, set.role), proof)?;
    }
    let ends_strict = certificate_rule::would_end(ctx, &with_role(&nodes, set.role, |other| other.id == node.id))?;
    let needs_approval = |caller: &&Identity| {
        let is_own = node.organisation == caller.organisation && set.role != NodeRole::Voter;
        node.role != set.role && (!is_own || (ends_strict && !active(Mutation::DemoteFreely)))
    };
    let Some(caller) = alone.filter(needs_approval) else {
        if ends_strict {
            certificate_rule::end(ctx)?;
        }
        put_role(ctx, node, set.role)?;
        certificate_rule::settle(ctx)?;
        return json(&Decision::done(None));
    };
    json(&decide(ctx, caller, own_call(SET_NODE_ROLE, &wish(node, &set))?)?)
}

/// The records, with another role of these nodes.
fn with_role(nodes: &[NodeRecord], role: NodeRole, these: impl Fn(&NodeRecord) -> bool) -> Vec<NodeRecord> {
    let after = |node: &NodeRecord| NodeRecord { role: if these(node) { role } else { node.role }, ..node.clone() };
    nodes.iter().map(after).collect()
}

/// The wish for a role of this node, as a proposal has it.
fn wish(node: &NodeRecord, set: &SetNodeRole) -> SetNodeRole {
    let (organisation, name) = (Some(node.organisation.clone()), Some(node.name.clone()));
    SetNodeRole { id: Some(node.id), organisation, name, role: set.role, proof: set.proof.clone() }
}

/// Removes the nodes of an organisation that leaves.
pub(super) fn remove_all_of(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let nodes = all(ctx)?;
    let (voters, _) = desired(nodes.iter().filter(|node| node.organisation != organisation));
    if voters.is_empty() {
        return Err(Rejection::new(Code::LastOne, format!("{organisation} has the last voters"))
            .wanted("a voter of another organisation")
            .next("ledgerctl network promote NODE"));
    }
    let leaves = |node: &NodeRecord| node.organisation == organisation && node.role != NodeRole::Removed;
    if certificate_rule::would_end(ctx, &with_role(&nodes, NodeRole::Removed, leaves))? {
        certificate_rule::end(ctx)?;
    }
    for node in nodes.iter().filter(|node| leaves(node)) {
        put_role(ctx, node, NodeRole::Removed)?;
    }
    Ok(())
}

/// Wants another role of a node, if that may be.
pub(super) fn change_role(
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
            .wanted("a node of the network; ids are never reused"));
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
        .wanted("another voter")
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

fn no_such_node(nodes: &[NodeRecord]) -> Rejection {
    let live = nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let names: Vec<_> = live.map(|node| format!("{} ({})", node.id, node.full_name())).collect();
    Rejection::new(Code::NotFound, "the network has no such node").wanted(format!("one of {}", names.join(", ")))
}
