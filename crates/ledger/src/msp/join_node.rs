//! Entry of a node: by itself, with the certificate of its organisation.

use super::address::check_address;
use super::caller::{node, object};
use super::node_roles::change_role;
use super::nodes::{NodeRecord, NodeRole, all, certificate_rule, write};
use super::store::{self, NEXT_NODE, json};
use super::{allowance, joins};
use crate::chaincode::Context;
use crate::members::NODES_MAX;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use serde::{Deserialize, Serialize};

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
        return Err(Rejection::new(Code::BadArgument, "a node must join under the name in its certificate")
            .found(format!("{:?}", name.chars().take(80).collect::<String>()))
            .wanted(format!("{:?}", caller.name)));
    }
    check_address(&join.address)?;
    let nodes = all(ctx)?;
    let live = || nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let own = |node: &&NodeRecord| node.organisation == caller.organisation && node.name == caller.name;
    let before = live().find(own);
    if let Some(other) = live().find(|node| node.address == join.address && !own(node)) {
        return Err(Rejection::new(Code::AlreadyExists, format!("the address {} is in use", join.address))
            .found(format!("node {} ({})", other.id, other.full_name()))
            .wanted("an address that leads to this node only")
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
    // While certificates are strict, a vote stays with the node that rejoins under another number: one joint change, and never
    // a voter less in between.
    let is_strict = certificate_rule(ctx)?.strict_since.is_some();
    let role = before.filter(|_| is_strict).map_or(NodeRole::Learner, |before| before.role);
    let id = store::next_number(ctx, NEXT_NODE)?;
    let node = NodeRecord::new(id, [&caller.organisation, &caller.name], &join.address, role);
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
            return Err(Rejection::new(Code::LimitExceeded, format!("{whose} has reached its limit of nodes"))
                .found(format!("{found} nodes"))
                .wanted(format!("at most {max}"))
                .next("ledgerctl network remove NODE; organisations raise the limit with msp allow_nodes"));
        }
    }
    Ok(())
}
