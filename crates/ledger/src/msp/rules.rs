//! Which rules of execution the nodes speak, and the activation of newer ones.
//!
//! A node says what it speaks by a transaction that it signs. Newer rules are activated by a proposal, when more than half
//! of the organisations approve it and every voter has said that it speaks them. They hold from the next block on, or from
//! a later one that the proposal names.

use super::ACTIVATE_RULES;
use super::arguments::ActivateRules;
use super::caller::{admin, bad, node, object};
use super::nodes::{self, NodeRecord, NodeRole, Speaks};
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, ACTIVATIONS, json};
use crate::chaincode::Context;
use crate::rules::Activation;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Longest name of a release, in bytes.
const RELEASE_BYTES_MAX: usize = 64;

/// Answer of `rules`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RulesOverview {
    /// The rules by which the next block is executed.
    pub active: u32,
    /// The activation that is decided for a later block.
    pub pending: Option<Activation>,
    /// The activations since the network was founded, and the one that is decided, in order of heights.
    pub activations: Vec<Activation>,
    /// The nodes in order of ids, without those that were removed.
    pub nodes: Vec<SpokenBy>,
}

/// A node, and what it has said that it speaks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpokenBy {
    /// Its number.
    pub id: u64,
    /// Its organisation and name.
    pub node: String,
    /// The number that it shall be.
    pub role: NodeRole,
    /// Number of the newest rules that it speaks: those in force, if it has said nothing.
    pub newest: u32,
    /// The release that it ran when it said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release: Option<String>,
}

/// `rules`
pub(super) fn show(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let activations = activations(ctx)?;
    let (active, pending) = (ctx.rules().number(), pending(ctx)?);
    let live = nodes::all(ctx)?.into_iter().filter(|node| node.role != NodeRole::Removed);
    let nodes = live.map(|node| SpokenBy {
        id: node.id,
        node: node.full_name(),
        role: node.role,
        newest: newest(&node, active),
        release: node.speaks.map(|speaks| speaks.release),
    });
    json(&RulesOverview { active, pending, activations, nodes: nodes.collect() })
}

/// `speak {newest, release}`: a node says what it speaks.
pub(super) fn speak(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let speaks: Speaks = object("speak", argument, "{\"newest\": NUMBER, \"release\": \"VERSION\"}")?;
    let caller = node(ctx, "register the rules that it supports")?;
    let plain = |c: u8| c.is_ascii_alphanumeric() || b".-+".contains(&c);
    if !(1..=RELEASE_BYTES_MAX).contains(&speaks.release.len()) || !speaks.release.bytes().all(plain) {
        let wanted = format!("1 to {RELEASE_BYTES_MAX} letters, digits, \".\", \"-\" and \"+\"");
        return Err(bad("speak", "release", &wanted));
    }
    let Some(record) = nodes::present(ctx, &caller.organisation, &caller.name)? else {
        return Err(Rejection::new(Code::NotAMember, format!("{} is not a node of this network", caller.id()))
            .wanted("a node that is a member"));
    };
    let record = NodeRecord { speaks: Some(speaks), ..record };
    nodes::write(ctx, &record)?;
    ctx.emit("speaks", &record.full_name(), json(&record)?);
    json(&record)
}

/// `activate_rules {number, height?}`
pub(super) fn activate(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let ActivateRules { number, height } =
        object("activate_rules", argument, "{\"number\": NUMBER, \"height\": HEIGHT}")?;
    if ctx.approved_by().is_some() {
        return execute(ctx, number, height);
    }
    let caller = admin(ctx, "activate rules")?;
    check(ctx, number)?;
    json(&decide(ctx, caller, own_call(ACTIVATE_RULES, &ActivateRules { number, height })?)?)
}

/// The activation that was approved.
fn execute(ctx: &mut Context<'_>, number: u32, height: Option<u64>) -> Result<Bytes, Rejection> {
    check(ctx, number)?;
    let mut activations = activations(ctx)?;
    let next = ctx.height().saturating_add(1);
    let activation = Activation { number, height: height.map_or(next, |height| height.max(next)) };
    activations.push(activation);
    store::write(ctx, ACTIVATIONS, &activations)?;
    let answer = json(&activation)?;
    ctx.emit("rules_activated", &number.to_string(), answer.clone());
    Ok(answer)
}

/// A node that does not speak what was decided must not become a voter: the network would lose it at that height.
pub(super) fn check_voter(ctx: &Context<'_>, node: &NodeRecord) -> Result<(), Rejection> {
    let Some(Activation { number, height }) = pending(ctx)? else { return Ok(()) };
    if newest(node, ctx.rules().number()) >= number {
        return Ok(());
    }
    let message =
        format!("{} does not support rules {number}, which are in force from block {height}", node.full_name());
    Err(Rejection::new(Code::RulesNotSpoken, message)
        .found(format!("rules {} at most", newest(node, ctx.rules().number())))
        .wanted(format!("rules {number}")))
}

/// Newer than what is in force, alone, and spoken by every voter.
fn check(ctx: &Context<'_>, number: u32) -> Result<(), Rejection> {
    let active = ctx.rules().number();
    if number <= active {
        return Err(Rejection::new(Code::BadArgument, format!("rules {number} cannot be activated"))
            .found(format!("rules {active} in force"))
            .wanted("newer rules: rules are never reverted"));
    }
    if let Some(Activation { number, height }) = pending(ctx)? {
        return Err(Rejection::new(Code::AlreadyExists, "an activation of rules is pending")
            .found(format!("rules {number} from block {height}"))
            .wanted("one activation at a time")
            .next("wait for that block: ledgerctl network rules"));
    }
    let members = nodes::members(ctx)?;
    let votes = |node: &NodeRecord| node.role == NodeRole::Voter || members.is_voter(node.id);
    let silent: Vec<_> = nodes::all(ctx)?
        .into_iter()
        .filter(|node| votes(node) && newest(node, active) < number)
        .map(|node| format!("{} (up to {})", node.full_name(), newest(&node, active)))
        .collect();
    if silent.is_empty() {
        return Ok(());
    }
    Err(Rejection::new(Code::RulesNotSpoken, format!("not every voter supports rules {number}"))
        .found(silent.join(", "))
        .wanted(format!("rules {number}, supported by every voter")))
}

/// The activation that is decided and not in force yet. A query asks with the rules of the next block.
fn pending(ctx: &Context<'_>) -> Result<Option<Activation>, Rejection> {
    let active = ctx.rules().number();
    Ok(activations(ctx)?.into_iter().find(|activation| activation.number > active))
}

fn activations(ctx: &Context<'_>) -> Result<Vec<Activation>, Rejection> {
    Ok(store::read(ctx, ACTIVATIONS)?.unwrap_or_default())
}

/// A node that has said nothing speaks what is in force, because it executes it.
fn newest(node: &NodeRecord, active: u32) -> u32 {
    node.speaks.as_ref().map_or(active, |speaks| speaks.newest)
}
