//! Proposed sets of policies.
//!
//! A proposal names its content, so an approval counts for exactly these bytes. It stands until it is enacted or withdrawn, and
//! replaces only the set that was in force when it was made. An approval counts for [`APPROVAL_LIFE`], once for each admin, and
//! ends with a revoked certificate. No organisation takes the room of another one's admins.
//!
//! No organisation is locked out by its own rule: after [`BREAK_GLASS_AFTER`] one of its admins enacts a proposal without
//! it. Meanwhile any other admin of the organisation sees the proposal and can withdraw it. The rule of the network stays.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::{policy_approvals, policy_sets};
use crate::policy::texts;
use crate::records::principal::Principal;
use crate::records::proposed::{Approval, Proposed};
use crate::records::{policy_set, proposed, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyApproval, PolicyProposal};
use std::collections::BTreeMap;

/// For how long an approval counts, in microseconds of block time: seven days.
const APPROVAL_LIFE: u64 = 7 * 24 * 3600 * 1_000_000;

/// How long a proposal must have stood before it is enacted without the organisation's own rule: three days of block time.
const BREAK_GLASS_AFTER: u64 = 3 * 24 * 3600 * 1_000_000;

/// Digits of the id of a proposal.
pub(crate) const ID_DIGITS: usize = 32;

/// The approval of the caller.
pub(crate) fn approval(ctx: &Context<'_>) -> Result<Approval, Rejection> {
    let until = ctx.block_time().saturating_add(APPROVAL_LIFE);
    let principal = Principal { attributes: BTreeMap::new(), ..Principal::of(ctx.submitter()?) };
    Ok(Approval { principal, until })
}

/// Refuses a proposal that was made from another set than the one in force.
pub(crate) fn check_base(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<(), Rejection> {
    let in_force = texts::version(ctx, &proposed.organisation)?.number;
    policy_sets::check_base(&proposed.organisation, proposed.base, in_force)
}

pub(crate) fn find(ctx: &Context<'_>, args: Arguments<'_>) -> Result<Proposed, Rejection> {
    let id = args.text(0, "ID")?;
    let is_id = id.len() == ID_DIGITS && id.bytes().all(|digit| digit.is_ascii_hexdigit());
    let proposed = if is_id { proposed::find(ctx, id)? } else { None };
    proposed.ok_or_else(|| {
        Rejection::new(Code::NotFound, "no proposed policy set has this id")
            .found(shown(id))
            .wanted(format!("the id of an open proposal, {ID_DIGITS} hexadecimal digits"))
            .next("ledgerctl policy proposals")
    })
}

/// Removes a proposal, and its texts where nothing else has them.
pub(crate) fn end(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<(), Rejection> {
    proposed::remove(ctx, &proposed.id)?;
    policy_set::forget(ctx, &proposed.organisation, &proposed.policies)
}

/// Writes a proposal, and answers with what counts of it now.
pub(crate) fn keep(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<Bytes, Rejection> {
    proposed::write(ctx, proposed)?;
    store::json(&told(ctx, proposed)?)
}

/// The proposal with what counts now.
pub(crate) fn told(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<PolicyProposal, Rejection> {
    let now = ctx.block_time();
    let counted: Vec<&Approval> = proposed.counted(now).collect();
    let admins =
        counted.iter().map(|approval| (approval.principal.organisation.as_str(), approval.principal.name.as_str()));
    let again = active(Mutation::CountTheProposerTwice).then_some((proposed.organisation.as_str(), ""));
    let admins = admins.chain(again);
    let needs = policy_approvals::needs(ctx, &proposed.organisation, admins)?;
    let approved =
        counted.iter().map(|approval| PolicyApproval { who: approval.principal.id(), until: approval.until });
    let Proposed { id, organisation, base, by, message, created, height, .. } = proposed.clone();
    let Proposed { restores, approvals, means_it, hash, policies, .. } = proposed.clone();
    Ok(PolicyProposal {
        id,
        organisation,
        base,
        by,
        message,
        created,
        height,
        restores,
        approvals,
        means_it,
        hash,
        policies,
        approved: approved.collect(),
        needs,
        break_glass_from: created.saturating_add(BREAK_GLASS_AFTER),
    })
}
