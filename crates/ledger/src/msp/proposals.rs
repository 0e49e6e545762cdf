//! Calls that need approval: proposed by one organisation, executed in the block in which their quorum agrees.
//!
//! Only admins propose and approve, each for their organisation. Approvals are counted as things stand at that moment. They do
//! not count if the organisation was removed, the authority was lost, or the certificate was revoked. One by a certificate that
//! has run out since counts: it was good when it approved.
//!
//! A proposal ends after [`PROPOSAL_LIFE_MAX`] of block time, or when its call fails. Nothing of such a call is kept; the
//! proposal stands as failed until it expires or is withdrawn.

use super::MspChaincode;
use super::caller::{admin, bad, object, text};
use super::misbehaviour;
use super::quorums;
use super::store::{self, NEXT_PROPOSAL, PROPOSALS, REVOKED, json, proposal_key};
use super::{NAME, organisations};
use crate::chaincode::{ADMINS_PER_ORGANISATION_MAX, ApprovedBy, Call, Chaincode, Context, Quorum, quorum_of};
use crate::page::Paging;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::lie::MISBEHAVIOUR_BYTES_MAX;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How long a proposal stands, in microseconds of block time: seven days.
pub const PROPOSAL_LIFE_MAX: u64 = 7 * 24 * 3600 * 1_000_000;
/// Most proposals that stand at once.
pub const PROPOSALS_MAX: usize = 256;
/// Most of them by one organisation, so that none can fill the list.
pub(super) const PROPOSALS_PER_ORGANISATION_MAX: usize = 16;
/// Most bytes of a proposed call: its names and arguments.
pub const CALL_BYTES_MAX: usize = 16 * 1024;
/// Most bytes of a proposed call that has the proof of a lie, in hexadecimal.
const ACCUSATION_BYTES_MAX: usize = CALL_BYTES_MAX + 2 * MISBEHAVIOUR_BYTES_MAX;
/// Most arguments of a proposed call.
pub const CALL_ARGS_MAX: usize = 64;

/// A proposal as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proposal {
    /// SHA-256 over its content and a number that is used once.
    pub id: Hash,
    /// The proposed call.
    pub call: Call,
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
    /// The admins who approve for these organisations.
    pub approved_by: Vec<Approval>,
    /// Why it can be approved no longer, if its call was refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<Failed>,
}

/// An approval: the certificate that signed it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Approval {
    /// Organisation of the admin.
    pub organisation: String,
    /// Their name.
    pub admin: String,
    /// SHA-256 of the distinguished name of the certificate's issuer.
    pub issuer: Hash,
    /// Its serial number in hexadecimal.
    pub serial: String,
}

/// A proposed call that was refused when its quorum had agreed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failed {
    /// Number of the code that the call ended with. Its text may differ between releases, so it is in no state.
    pub code: u16,
    /// Height of the block.
    pub height: u64,
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
    /// How many must approve, while it waits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quorum: Option<Quorum>,
}

impl Decision {
    /// Done.
    pub(super) fn done(proposal: Option<Proposal>) -> Self {
        Self { executed: true, proposal, missing: 0, pending: Vec::new(), quorum: None }
    }

    /// The proposal has failed, and waits for nobody.
    fn failed(proposal: Proposal) -> Self {
        Self { executed: false, proposal: Some(proposal), missing: 0, pending: Vec::new(), quorum: None }
    }
}

impl Proposal {
    /// The approvals, as the call learns them.
    fn approved(&self) -> ApprovedBy {
        let mut approved =
            ApprovedBy { proposal: self.id, proposer: self.organisation.clone(), ..ApprovedBy::default() };
        for Approval { organisation, admin, .. } in &self.approved_by {
            approved.admins.entry(organisation.clone()).or_default().insert(admin.clone());
        }
        approved
    }

    /// The organisations of those who approve.
    fn count_organisations(&mut self) {
        self.approvals = self.approved_by.iter().map(|approval| approval.organisation.clone()).collect();
    }
}

/// The proposals that wait for approvals.
fn standing(ctx: &Context<'_>) -> Result<Vec<Proposal>, Rejection> {
    let mut proposals = known(ctx)?;
    proposals.retain(|proposal| proposal.failed.is_none());
    Ok(proposals)
}

/// The proposals that have not expired, with the approvals that count.
fn known(ctx: &Context<'_>) -> Result<Vec<Proposal>, Rejection> {
    let mut proposals: Vec<Proposal> = store::list(ctx, PROPOSALS.as_bytes(), PROPOSALS_MAX)?;
    proposals.sort_by_key(|proposal| (proposal.created, proposal.id));
    Ok(proposals.into_iter().filter_map(|proposal| counted(ctx, proposal)).collect())
}

/// A proposal that has not expired, with the approvals that count.
fn counted(ctx: &Context<'_>, mut proposal: Proposal) -> Option<Proposal> {
    if proposal.expires < ctx.block_time() {
        return None;
    }
    proposal.approved_by.retain(|approval| !is_revoked(ctx, approval));
    proposal.count_organisations();
    Some(proposal)
}

fn is_revoked(ctx: &Context<'_>, approval: &Approval) -> bool {
    let serial = hex::decode(&approval.serial).unwrap_or_default();
    ctx.get(&[REVOKED, &approval.issuer.0, &serial].concat()).is_some()
}

/// `proposals [PAGE_JSON]`: each with what it still needs.
pub(super) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let decide = |proposal: Proposal| match proposal.failed {
        None => waiting(ctx, proposal),
        Some(_) => Ok(Decision::failed(proposal)),
    };
    let paging = Paging::of("msp proposals", args)?;
    let read = |key: &[u8], value: &[u8]| counted(ctx, store::parse(key, value)?).map(decide).transpose();
    let mut page = paging.page(ctx, PROPOSALS.as_bytes(), read)?;
    page.items.sort_by_key(|decision| decision.proposal.as_ref().map(|proposal| (proposal.created, proposal.id)));
    paging.answer(&page)
}

/// `propose {chaincode, function, args}`. A function of this chaincode is proposed by calling it.
pub(super) fn propose(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"chaincode\": NAME, \"function\": NAME, \"args\": [hexadecimal, ...]}";
    let call: Call = object("propose", argument, wanted)?;
    let caller = admin(ctx, "propose")?;
    quorum_of(ctx.registry().find(&call.chaincode)?, &call.function)?;
    if call.chaincode == NAME {
        return MspChaincode.invoke(ctx, &call.function, &call.args);
    }
    json(&decide(ctx, caller, call)?)
}

/// Does this call wait for approvals already?
pub(super) fn is_proposed(ctx: &Context<'_>, call: &Call) -> Result<bool, Rejection> {
    Ok(standing(ctx)?.iter().any(|proposal| proposal.call == *call))
}

/// Proposes a call for the caller's organisation, or approves the same one that is proposed already.
pub(super) fn decide(ctx: &mut Context<'_>, caller: &Identity, call: Call) -> Result<Decision, Rejection> {
    forget_expired(ctx)?;
    let proposals = standing(ctx)?;
    if let Some(same) = proposals.iter().find(|proposal| proposal.call == call) {
        return add_approval(ctx, caller, same.clone());
    }
    check_call(ctx, caller, &call)?;
    let known = known(ctx)?;
    let own = known.iter().filter(|proposal| proposal.organisation == caller.organisation).count();
    for (found, max) in [(known.len(), PROPOSALS_MAX), (own, PROPOSALS_PER_ORGANISATION_MAX)] {
        if found >= max {
            return Err(Rejection::new(Code::LimitExceeded, "too many open proposals")
                .found(format!("{found} proposals"))
                .wanted(format!("at most {PROPOSALS_MAX}, and {PROPOSALS_PER_ORGANISATION_MAX} per organisation"))
                .next("withdraw one: ledgerctl network withdraw ID"));
        }
    }
    let number = store::next_number(ctx, NEXT_PROPOSAL)?;
    let created = ctx.block_time();
    let mut proposal = Proposal {
        id: Hash::of(&[b"ledgerd proposal v1\0", &number.to_be_bytes(), &json(&call)?]),
        call,
        by: caller.id(),
        organisation: caller.organisation.clone(),
        approvals: BTreeSet::new(),
        created,
        expires: created.saturating_add(PROPOSAL_LIFE_MAX),
        approved_by: Vec::new(),
        failed: None,
    };
    agree(caller, &mut proposal)?;
    ctx.emit("proposed", &proposal.id.to_string(), json(&proposal)?);
    settle(ctx, proposal)
}

/// `approve ID`
pub(super) fn approve(ctx: &mut Context<'_>, id: &Bytes) -> Result<Bytes, Rejection> {
    let caller = admin(ctx, "approve on behalf of its organisation")?;
    let proposal = find(standing(ctx)?, "approve", id)?;
    json(&add_approval(ctx, caller, proposal)?)
}

/// `withdraw ID`: the proposer's organisation takes the proposal back, another one its approval, whoever of its admins
/// gave it.
pub(super) fn withdraw(ctx: &mut Context<'_>, id: &Bytes) -> Result<Bytes, Rejection> {
    let caller = admin(ctx, "withdraw on behalf of its organisation")?;
    let mut proposal = find(known(ctx)?, "withdraw", id)?;
    if caller.organisation == proposal.organisation {
        ctx.delete(proposal_key(&proposal.id).as_bytes());
    } else if proposal.approvals.remove(&caller.organisation) {
        proposal.approved_by.retain(|approval| approval.organisation != caller.organisation);
        store::write(ctx, &proposal_key(&proposal.id), &proposal)?;
    } else {
        return Err(Rejection::new(Code::NotFound, format!("{} has not approved this", caller.organisation))
            .found(format!("approved by {}", joined(&proposal.approvals)))
            .wanted("its own proposal or approval"));
    }
    ctx.emit("withdrawn", &proposal.id.to_string(), json(&proposal)?);
    json(&proposal)
}

/// Takes approvals back whose admins speak for nobody any more: of an organisation that leaves, or by an authority that is lost.
/// If they come back, they are asked again.
pub(super) fn forget_approvals(ctx: &mut Context<'_>, of: impl Fn(&Approval) -> bool) -> Result<(), Rejection> {
    for mut proposal in known(ctx)? {
        if proposal.approved_by.iter().any(&of) {
            proposal.approved_by.retain(|approval| !of(approval));
            proposal.count_organisations();
            store::write(ctx, &proposal_key(&proposal.id), &proposal)?;
        }
    }
    Ok(())
}

/// Does what has become due without another approval: there are fewer organisations now, or a quorum has changed.
fn settle_all(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    // Each round ends one proposal, so this ends.
    for _ in 0..PROPOSALS_MAX {
        let mut done = false;
        for proposal in standing(ctx)? {
            if waiting(ctx, proposal.clone())?.missing == 0 {
                done = execute(ctx, proposal).is_ok();
            }
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
    if agree(caller, &mut proposal)? {
        ctx.emit("approved", &proposal.id.to_string(), json(&proposal)?);
    }
    settle(ctx, proposal)
}

/// Adds the caller to those who agree. Answers whether that is new.
fn agree(caller: &Identity, proposal: &mut Proposal) -> Result<bool, Rejection> {
    let approval = Approval {
        organisation: caller.organisation.clone(),
        admin: caller.name.clone(),
        issuer: Hash(caller.issuer),
        serial: hex::encode(&caller.serial),
    };
    if proposal.approved_by.contains(&approval) {
        return Ok(false);
    }
    // With a renewed certificate the same admin agrees again, and counts once.
    let same = |other: &Approval| (&other.organisation, &other.admin) == (&approval.organisation, &approval.admin);
    proposal.approved_by.retain(|other| !same(other));
    let own = proposal.approved_by.iter().filter(|other| other.organisation == caller.organisation).count();
    if own >= ADMINS_PER_ORGANISATION_MAX {
        return Err(Rejection::new(
            Code::LimitExceeded,
            "enough admins of one organisation have approved this proposal",
        )
        .found(format!("{own} of {}", caller.organisation))
        .wanted(format!("at most {ADMINS_PER_ORGANISATION_MAX}")));
    }
    proposal.approved_by.push(approval);
    proposal.count_organisations();
    Ok(true)
}

/// Executes the proposal if enough have approved, else keeps it.
fn settle(ctx: &mut Context<'_>, proposal: Proposal) -> Result<Decision, Rejection> {
    let decision = waiting(ctx, proposal.clone())?;
    if decision.missing > 0 {
        store::write(ctx, &proposal_key(&proposal.id), &proposal)?;
        return Ok(decision);
    }
    let decision = execute(ctx, proposal)?;
    if decision.executed {
        settle_all(ctx)?;
    }
    Ok(decision)
}

/// Executes the call of a proposal, and ends the proposal. One that fails leaves nothing but that.
fn execute(ctx: &mut Context<'_>, mut proposal: Proposal) -> Result<Decision, Rejection> {
    let key = proposal_key(&proposal.id);
    match ctx.call_approved(&proposal.approved(), &proposal.call) {
        Ok(_) => {
            ctx.delete(key.as_bytes());
            ctx.emit("executed", &proposal.id.to_string(), json(&proposal)?);
            Ok(Decision::done(Some(proposal)))
        }
        Err(reason) => {
            proposal.failed = Some(Failed { code: reason.code.number(), height: ctx.height() });
            store::write(ctx, &key, &proposal)?;
            ctx.emit("failed", &proposal.id.to_string(), json(&proposal)?);
            Ok(Decision::failed(proposal))
        }
    }
}

/// Refuses a call that is too long, and one that would be refused now if every organisation agreed.
fn check_call(ctx: &mut Context<'_>, caller: &Identity, call: &Call) -> Result<(), Rejection> {
    let names = call.chaincode.len().saturating_add(call.function.len());
    let bytes = call.args.iter().map(Bytes::len).fold(names, usize::saturating_add);
    let bytes_max = if misbehaviour::accused(call).is_some() { ACCUSATION_BYTES_MAX } else { CALL_BYTES_MAX };
    for (found, max, what) in [(bytes, bytes_max, "bytes"), (call.args.len(), CALL_ARGS_MAX, "arguments")] {
        if found > max {
            return Err(Rejection::new(Code::TooLarge, "the proposed call is too long")
                .found(format!("{found} {what}"))
                .wanted(format!("at most {max} {what}")));
        }
    }
    let mut approved = ApprovedBy { proposer: caller.organisation.clone(), ..ApprovedBy::default() };
    approved.admins = organisations::names(ctx)?.into_iter().map(|name| (name, BTreeSet::new())).collect();
    approved.admins.entry(caller.organisation.clone()).or_default().insert(caller.name.clone());
    ctx.rehearse_approved(&approved, call).map(drop)
}

fn waiting(ctx: &Context<'_>, proposal: Proposal) -> Result<Decision, Rejection> {
    let (organisations, quorum) = quorums::electorate(ctx, &proposal.call)?;
    let approved = proposal.approved();
    Ok(Decision {
        executed: false,
        missing: quorum.missing(&approved, &organisations),
        pending: quorum.pending(&approved, &organisations),
        proposal: Some(proposal),
        quorum: Some(quorum),
    })
}

fn find(proposals: Vec<Proposal>, function: &str, id: &Bytes) -> Result<Proposal, Rejection> {
    let wanted = "the id of a proposal, or its first 8 digits or more";
    let id = text(function, "ID", id)?.to_ascii_lowercase();
    if id.len() < 8 || id.len() > 64 || !id.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(bad(function, "ID", wanted).found(format!("{:?}", id.chars().take(64).collect::<String>())));
    }
    let mut found = proposals.into_iter().filter(|proposal| proposal.id.to_string().starts_with(&id));
    match (found.next(), found.next()) {
        (Some(proposal), None) => Ok(proposal),
        (Some(_), Some(_)) => Err(bad(function, "ID", "more digits: several proposals start with these").found(id)),
        _ => Err(Rejection::new(Code::NotFound, "there is no such proposal").found(id).wanted(wanted).next(
            "ledgerctl network proposals; it may have been executed or withdrawn, or may have failed or expired",
        )),
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
