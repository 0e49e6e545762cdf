//! Actions that concern every organisation: proposed by one organisation, done in the block in which more than half
//! have approved.
//!
//! Only admins propose and approve, each for their organisation. Approvals are counted against the organisations of
//! that moment: those of an organisation that was removed do not count. A proposal ends after
//! [`PROPOSAL_LIFE_MAX`] of block time.

use super::caller::{admin, bad, text};
use super::nodes::{self, NodeRole};
use super::store::{self, NEXT_PROPOSAL, PROPOSALS, json, proposal_key};
use super::{invitations, organisations, rules};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_hash::Hash;
use ledger_identity::Identity;
use ledger_rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How long a proposal stands, in microseconds of block time: seven days.
pub const PROPOSAL_LIFE_MAX: u64 = 7 * 24 * 3600 * 1_000_000;
/// Most proposals that stand at once.
pub const PROPOSALS_MAX: usize = 256;
/// Most of them by one organisation, so that none can fill the list.
pub(super) const PROPOSALS_PER_ORGANISATION_MAX: usize = 16;

/// An action that needs approval.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case")]
pub enum Action {
    /// A node shall be something else.
    SetNodeRole {
        /// Its number.
        id: u64,
        /// Its organisation and name, for people.
        node: String,
        /// Its wanted role.
        role: NodeRole,
    },
    /// An organisation may join.
    InviteOrganisation {
        /// Its name.
        name: String,
        /// The public half of the invitation's Ed25519 key.
        key: Hash,
        /// Until when, in block time (microseconds).
        expires: u64,
    },
    /// An organisation leaves with everything it has.
    RemoveOrganisation {
        /// Its name.
        name: String,
    },
    /// Blocks are executed by newer rules.
    ActivateRules {
        /// Number of the rules.
        number: u32,
        /// They hold from this block on at the earliest.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        height: Option<u64>,
    },
}

/// A proposal as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proposal {
    /// SHA-256 over its content and a number that is used once.
    pub id: Hash,
    /// The proposed action.
    pub action: Action,
    /// The admin who proposed it.
    pub by: String,
    /// Their organisation.
    pub organisation: String,
    /// Organisations that approve, the proposer's among them.
    pub approvals: BTreeSet<String>,
    /// Block time of the proposal, microseconds.
    pub created: u64,
    /// Last block time at which it can be approved, microseconds.
    pub expires: u64,
}

/// Answer of every function that may need approval.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decision {
    /// Done, or still waiting for approvals?
    pub executed: bool,
    /// The proposal; none if the caller could decide alone.
    pub proposal: Option<Proposal>,
    /// How many approvals are missing.
    pub missing: usize,
    /// The organisations that could give them.
    pub pending: Vec<String>,
}

impl Decision {
    /// Done.
    pub(super) fn done(proposal: Option<Proposal>) -> Self {
        Self { executed: true, proposal, missing: 0, pending: Vec::new() }
    }
}

/// The proposals that still stand.
pub(super) fn standing(ctx: &Context<'_>) -> Result<Vec<Proposal>, Rejection> {
    let mut proposals: Vec<Proposal> = store::list(ctx, PROPOSALS.as_bytes(), PROPOSALS_MAX)?;
    proposals.retain(|proposal| proposal.expires >= ctx.block_time());
    proposals.sort_by_key(|proposal| (proposal.created, proposal.id));
    Ok(proposals)
}

/// `proposals`: each with what it still needs.
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let organisations = organisations::names(ctx)?;
    let decisions = standing(ctx)?.into_iter().map(|proposal| waiting(proposal, &organisations));
    json(&decisions.collect::<Vec<_>>())
}

/// Proposes an action for the caller's organisation, or approves the same one that stands already.
pub(super) fn decide(ctx: &mut Context<'_>, caller: &Identity, action: Action) -> Result<Decision, Rejection> {
    forget_expired(ctx)?;
    let proposals = standing(ctx)?;
    if let Some(same) = proposals.iter().find(|proposal| proposal.action == action) {
        return add_approval(ctx, caller, same.clone());
    }
    let own = proposals.iter().filter(|proposal| proposal.organisation == caller.organisation).count();
    for (found, max) in [(proposals.len(), PROPOSALS_MAX), (own, PROPOSALS_PER_ORGANISATION_MAX)] {
        if found >= max {
            return Err(Rejection::new(Code::LimitExceeded, "too many proposals wait for approval")
                .found(format!("{found} proposals"))
                .wanted(format!("at most {PROPOSALS_MAX}, and {PROPOSALS_PER_ORGANISATION_MAX} of one organisation"))
                .next("ledgerctl network withdraw ID"));
        }
    }
    let number = store::next_number(ctx, NEXT_PROPOSAL)?;
    let created = ctx.block_time();
    let proposal = Proposal {
        id: Hash::of(&[b"ledgerd proposal v1\0", &number.to_be_bytes(), &json(&action)?]),
        action,
        by: caller.id(),
        organisation: caller.organisation.clone(),
        approvals: BTreeSet::from([caller.organisation.clone()]),
        created,
        expires: created.saturating_add(PROPOSAL_LIFE_MAX),
    };
    ctx.emit("proposed", &proposal.id.to_string(), json(&proposal)?);
    settle(ctx, proposal)
}

/// `approve ID`
pub(super) fn approve(ctx: &mut Context<'_>, id: &Bytes) -> Result<Bytes, Rejection> {
    let caller = admin(ctx, "approve for its organisation")?;
    let proposal = find(ctx, "approve", id)?;
    json(&add_approval(ctx, caller, proposal)?)
}

/// `withdraw ID`: the proposer's organisation takes the proposal back, another one its approval.
pub(super) fn withdraw(ctx: &mut Context<'_>, id: &Bytes) -> Result<Bytes, Rejection> {
    let caller = admin(ctx, "withdraw for its organisation")?;
    let mut proposal = find(ctx, "withdraw", id)?;
    if caller.organisation == proposal.organisation {
        ctx.delete(proposal_key(&proposal.id).as_bytes());
    } else if proposal.approvals.remove(&caller.organisation) {
        store::write(ctx, &proposal_key(&proposal.id), &proposal)?;
    } else {
        return Err(Rejection::new(Code::NotFound, format!("{} has not approved this", caller.organisation))
            .found(format!("approved by {}", joined(&proposal.approvals)))
            .wanted("a proposal or an approval of one's own"));
    }
    ctx.emit("withdrawn", &proposal.id.to_string(), json(&proposal)?);
    json(&proposal)
}

/// Does what has become due because there are fewer organisations now. An action that cannot be done stays a proposal.
pub(super) fn settle_all(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    // Each round removes one proposal, so this ends.
    for _ in 0..PROPOSALS_MAX {
        let organisations = organisations::names(ctx)?;
        let due = standing(ctx)?.into_iter().filter(|proposal| missing(proposal, &organisations) == 0);
        let mut done = false;
        for proposal in due {
            done = execute(ctx, &proposal).is_ok();
            if done {
                break;
            }
        }
        if !done {
            break;
        }
    }
    Ok(())
}

fn add_approval(ctx: &mut Context<'_>, caller: &Identity, mut proposal: Proposal) -> Result<Decision, Rejection> {
    if proposal.approvals.insert(caller.organisation.clone()) {
        ctx.emit("approved", &proposal.id.to_string(), json(&proposal)?);
    }
    settle(ctx, proposal)
}

/// Executes the proposal if enough have approved, else keeps it.
fn settle(ctx: &mut Context<'_>, proposal: Proposal) -> Result<Decision, Rejection> {
    let organisations = organisations::names(ctx)?;
    let decision = waiting(proposal.clone(), &organisations);
    if decision.missing > 0 {
        store::write(ctx, &proposal_key(&proposal.id), &proposal)?;
        return Ok(decision);
    }
    let removes = matches!(proposal.action, Action::RemoveOrganisation { .. });
    execute(ctx, &proposal)
        .map_err(|fault| fault.next(format!("if it can never be done: ledgerctl network withdraw {}", proposal.id)))?;
    if removes {
        settle_all(ctx)?;
    }
    Ok(Decision::done(Some(proposal)))
}

/// Checks everything before it writes anything: [`settle_all`] goes on after a refusal.
fn execute(ctx: &mut Context<'_>, proposal: &Proposal) -> Result<(), Rejection> {
    match &proposal.action {
        Action::SetNodeRole { id, role, .. } => nodes::execute_role(ctx, *id, *role)?,
        Action::InviteOrganisation { name, key, expires } => {
            invitations::execute(ctx, name, *key, *expires, &proposal.organisation)?;
        }
        Action::RemoveOrganisation { name } => organisations::execute_remove(ctx, name)?,
        Action::ActivateRules { number, height } => rules::execute(ctx, *number, *height)?,
    }
    ctx.delete(proposal_key(&proposal.id).as_bytes());
    ctx.emit("executed", &proposal.id.to_string(), json(proposal)?);
    Ok(())
}

fn waiting(proposal: Proposal, organisations: &[String]) -> Decision {
    let pending = organisations.iter().filter(|name| !proposal.approvals.contains(*name)).cloned().collect();
    Decision { executed: false, missing: missing(&proposal, organisations), proposal: Some(proposal), pending }
}

/// How many approvals are missing to more than half of the organisations.
fn missing(proposal: &Proposal, organisations: &[String]) -> usize {
    let approved = organisations.iter().filter(|name| proposal.approvals.contains(*name)).count();
    (organisations.len() / 2 + 1).saturating_sub(approved)
}

fn find(ctx: &Context<'_>, function: &str, id: &Bytes) -> Result<Proposal, Rejection> {
    let wanted = "the id of a proposal, or its first 8 digits or more";
    let id = text(function, "ID", id)?.to_ascii_lowercase();
    if id.len() < 8 || id.len() > 64 || !id.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(bad(function, "ID", wanted).found(format!("{:?}", id.chars().take(64).collect::<String>())));
    }
    let mut found = standing(ctx)?.into_iter().filter(|proposal| proposal.id.to_string().starts_with(&id));
    match (found.next(), found.next()) {
        (Some(proposal), None) => Ok(proposal),
        (Some(_), Some(_)) => Err(bad(function, "ID", "more digits: several proposals begin so").found(id)),
        _ => Err(Rejection::new(Code::NotFound, "no such proposal stands")
            .found(id)
            .wanted(wanted)
            .next("ledgerctl network proposals; it may have been executed, withdrawn, or have expired")),
    }
}

fn forget_expired(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    for proposal in store::list::<Proposal>(ctx, PROPOSALS.as_bytes(), PROPOSALS_MAX)? {
        if proposal.expires < ctx.block_time() {
            ctx.delete(proposal_key(&proposal.id).as_bytes());
        }
    }
    Ok(())
}

fn joined(names: &BTreeSet<String>) -> String {
    names.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}
