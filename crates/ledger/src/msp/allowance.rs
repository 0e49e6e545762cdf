//! The number of nodes that the network allows an organisation.
//!
//! An organisation brings in nodes by certificates of its CA. Each costs the others connections, replication and a place, so
//! the network limits them. It changes the number by a proposal.

use super::ALLOW_NODES;
use super::caller::{admin, object};
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, allowance_key, json};
use crate::chaincode::Context;
use crate::members::NODES_MAX;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Most nodes of an organisation, unless the network has decided otherwise.
pub const NODES_ALLOWED_DEFAULT: usize = 16;

/// Argument of `allow_nodes`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AllowNodes {
    /// Name of the organisation.
    pub organisation: String,
    /// How many nodes it may have. Nodes that it has already stay.
    pub nodes: usize,
}

/// How many nodes this organisation may have.
pub(super) fn of(ctx: &Context<'_>, organisation: &str) -> Result<usize, Rejection> {
    Ok(store::read(ctx, &allowance_key(organisation))?.unwrap_or(NODES_ALLOWED_DEFAULT))
}

/// `allow_nodes {organisation, nodes}`: needs approval.
pub(super) fn allow(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let allow: AllowNodes = object(ALLOW_NODES, argument, "{\"organisation\": NAME, \"nodes\": NUMBER}")?;
    if ctx.approved_by().is_some() {
        check(ctx, &allow)?;
        store::write(ctx, &allowance_key(&allow.organisation), &allow.nodes)?;
        let event = json(&allow)?;
        ctx.emit("nodes_allowed", &allow.organisation, event.clone());
        return Ok(event);
    }
    let caller = admin(ctx, "set the number of nodes of an organisation")?;
    check(ctx, &allow)?;
    json(&decide(ctx, caller, own_call(ALLOW_NODES, &allow)?)?)
}

/// An organisation that leaves comes back with the number of a new one.
pub(super) fn forget(ctx: &mut Context<'_>, organisation: &str) {
    ctx.delete(allowance_key(organisation).as_bytes());
}

fn check(ctx: &Context<'_>, AllowNodes { organisation, nodes }: &AllowNodes) -> Result<(), Rejection> {
    if *nodes > NODES_MAX {
        return Err(Rejection::new(Code::BadArgument, "the number of nodes is too large")
            .found(nodes.to_string())
            .wanted(format!("at most {NODES_MAX}, the limit of a network")));
    }
    if organisations::find(ctx, organisation)?.is_some() {
        return Ok(());
    }
    Err(Rejection::new(Code::NotFound, "the network has no such organisation")
        .found(format!("{:?}", organisation.chars().take(80).collect::<String>()))
        .wanted(format!("one of {}", organisations::names(ctx)?.join(", "))))
}
