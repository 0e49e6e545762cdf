//! Proposed sets of policies: `policy propose|approve|withdraw|enact`, `policy_proposals`, `policy_proposal`.
//!
//! A proposal names its content, so an approval counts for exactly these bytes. It stands until it is enacted or withdrawn, and
//! replaces only the set that was in force when it was made. An approval counts for [`APPROVAL_LIFE`], once for each admin, and
//! ends with a revoked certificate. No organisation takes the room of another one's admins.
//!
//! Nobody is locked out by an organisation's own rule: after [`BREAK_GLASS_AFTER`] one of its admins enacts a proposal without
//! it. Meanwhile any other admin of the organisation sees the proposal and can withdraw it. The rule of the network stays.

use super::policies::{self, Made};
use super::policy_rules::{self, OF_NETWORK};
use super::policy_sets::{self, Draft};
use super::{reachable, robots};
use crate::arguments::{Arguments, shown};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::records::principal::Principal;
use crate::records::proposed::{self, Approval, Proposed};
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::{ADMINS_PER_ORGANISATION_MAX, Context, Paging};
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyApproval, PolicyProposal, PolicyProposalTexts};
use std::collections::BTreeMap;

/// Most proposals of one organisation.
const PROPOSALS_MAX: usize = 8;
/// For how long an approval counts, in microseconds of block time: seven days.
const APPROVAL_LIFE: u64 = 7 * 24 * 3600 * 1_000_000;
/// How long a proposal must have stood before it is enacted without the organisation's own rule: three days of block time.
const BREAK_GLASS_AFTER: u64 = 3 * 24 * 3600 * 1_000_000;
/// The word of who enacts a proposal without that rule.
const BREAK_GLASS: &str = "break-glass";
/// Digits of the id of a proposal.
const ID_DIGITS: usize = 32;

/// `policy propose SET_JSON`: by an admin, who agrees thereby.
pub(super) fn propose(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy propose SET_JSON", args, 1, 1)?;
    let caller = robots::admin(ctx, "propose policies")?;
    let organisation = &caller.organisation;
    let draft = policy_sets::read(ctx, decider, organisation, args)?;
    if draft.is_in_force {
        return Err(Rejection::new(Code::AlreadyExists, format!("this set of policies of {organisation} is in force"))
            .found(format!("the policies and the rule of version {}", draft.base))
            .wanted("a set that changes something"));
    }
    reachable::check(ctx, decider, organisation, &draft.texts, draft.means_it)?;
    let own = proposed::all(ctx)?.into_iter().filter(|proposed| proposed.organisation == *organisation).count();
    if own >= PROPOSALS_MAX {
        return Err(Rejection::new(
            Code::LimitExceeded,
            format!("{organisation} has proposed too many sets of policies"),
        )
        .found(format!("{own} proposals"))
        .wanted(format!("at most {PROPOSALS_MAX}"))
        .next("ledgerctl policy withdraw ID"));
    }
    let Draft { texts, message, restores, rule, means_it, base, .. } = draft;
    let hash = texts::hash(&texts);
    let rule = rule.map(|rule| rule.to_string());
    let named = store::json(&(organisation, base, &message, restores, &rule, means_it))?;
    let id = Hash::of(&[b"ledgerd policies v1\0", &ctx.transaction().0, &hash.0, &named]).to_string();
    let proposed = Proposed {
        id: id.chars().take(ID_DIGITS).collect(),
        organisation: organisation.clone(),
        base,
        by: caller.id(),
        message,
        created: ctx.block_time(),
        height: ctx.height(),
        restores,
        approvals: rule,
        means_it,
        hash: hash.to_string(),
        policies: policy_set::keep(ctx, organisation, &texts),
        approved: vec![approval(ctx)?],
    };
    let told = keep(ctx, &proposed)?;
    ctx.emit("policy_proposed", &proposed.organisation, told.clone());
    Ok(told)
}

/// `policy approve ID`: by an admin of any organisation.
pub(super) fn approve(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy approve ID", args, 1, 1)?;
    robots::admin(ctx, "approve policies")?;
    let mut proposed = find(ctx, args)?;
    check_base(ctx, &proposed)?;
    let (own, now) = (approval(ctx)?, ctx.block_time());
    let counted: Vec<Approval> = proposed.counted(now).cloned().collect();
    let same = |other: &Approval| other.principal.id() == own.principal.id();
    proposed.approved = counted.into_iter().filter(|other| !same(other)).collect();
    let organisation = &own.principal.organisation;
    let theirs = proposed.approved.iter().filter(|other| other.principal.organisation == *organisation).count();
    if theirs >= ADMINS_PER_ORGANISATION_MAX {
        return Err(Rejection::new(
            Code::LimitExceeded,
            format!("so many admins of {organisation} approve this already"),
        )
        .found(format!("{theirs} approvals"))
        .wanted(format!("at most {ADMINS_PER_ORGANISATION_MAX} of each organisation")));
    }
    proposed.approved.push(own);
    let told = keep(ctx, &proposed)?;
    ctx.emit("policy_approved", &proposed.organisation, told.clone());
    Ok(told)
}

/// `policy withdraw ID`: an admin of the organisation takes the proposal back, one of another their approval.
pub(super) fn withdraw(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy withdraw ID", args, 1, 1)?;
    let caller = robots::admin(ctx, "withdraw policies")?;
    let mut proposed = find(ctx, args)?;
    let before = proposed.approved.len();
    proposed.approved.retain(|approval| approval.principal.id() != caller.id());
    let told = if caller.organisation == proposed.organisation {
        end(ctx, &proposed)?;
        store::json(&told(ctx, &proposed)?)?
    } else if proposed.approved.len() < before {
        keep(ctx, &proposed)?
    } else {
        return Err(Rejection::new(Code::NotFound, format!("{} has not approved this", caller.id()))
            .found(format!("a proposal of {}", proposed.organisation))
            .wanted("a proposal of one's own organisation, or an approval of one's own"));
    };
    ctx.emit("policy_withdrawn", &proposed.organisation, told.clone());
    Ok(told)
}

/// `policy enact ID [break-glass]`: puts a proposal in force to which enough agree; by an admin of its organisation.
pub(super) fn enact(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy enact ID [break-glass]", args, 1, 2)?;
    let caller = robots::admin(ctx, "enact policies")?;
    let breaks = match args.has(1).then(|| args.text(1, BREAK_GLASS)).transpose()? {
        None => false,
        Some(BREAK_GLASS) => true,
        Some(word) => return Err(args.bad(1, BREAK_GLASS, shown(word), BREAK_GLASS)),
    };
    let proposed = find(ctx, args)?;
    let organisation = &proposed.organisation;
    if caller.organisation != *organisation {
        return Err(Rejection::new(Code::NotOwner, format!("this proposal belongs to {organisation}"))
            .found(format!("{}, an admin of {}", caller.id(), caller.organisation))
            .wanted(format!("an admin of {organisation}"))
            .next(format!("ask an admin of {organisation}: ledgerctl policy apply --proposal {}", proposed.id)));
    }
    check_base(ctx, &proposed)?;
    let told = told(ctx, &proposed)?;
    let approved_by: Vec<String> = told.approved.iter().map(|approval| approval.who.clone()).collect();
    let mut broken = false;
    for need in told.needs.iter().filter(|need| need.missing > 0) {
        let refused =
            || policy_rules::not_agreed(organisation, need).found(format!("approved by {}", approved_by.join(", ")));
        if need.of == OF_NETWORK || !breaks {
            return Err(refused().next(format!("the others agree with: ledgerctl policy approve {}", proposed.id)));
        }
        if ctx.block_time() < told.break_glass_from {
            let hours = (told.break_glass_from - ctx.block_time()).div_ceil(3600 * 1_000_000);
            return Err(refused()
                .next(format!("wait until others agree, or {hours} hours more: then it can be applied without them")));
        }
        broken = true;
    }
    let policies = policy_set::texts(ctx, organisation, &proposed.policies)?;
    let texts = policy_sets::checked(ctx, decider, &policies)?;
    reachable::check(ctx, decider, organisation, &texts, proposed.means_it)?;
    let made = Made {
        by: proposed.by.clone(),
        message: proposed.message.clone(),
        approved_by,
        break_glass: broken,
        restores: proposed.restores,
        rule: policy_rules::parse(proposed.approvals.as_deref())?,
    };
    let done = policies::replace(ctx, decider, organisation, &texts, ("", policy_sets::done(proposed.restores)), made)?;
    end(ctx, &proposed)?;
    Ok(done)
}

/// `policy_proposals [PAGE_JSON]`
pub(crate) fn list(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("policy_proposals [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("policy_proposals", args)?;
    let page = paging.page(ctx, store::PROPOSED, |key, value| store::parse::<Proposed>(key, value).map(Some))?;
    let items: Vec<PolicyProposal> = page.items.iter().map(|proposed| told(ctx, proposed)).collect::<Result<_, _>>()?;
    paging.answer(&ledger::Page { items, next: page.next })
}

/// `policy_proposal ID`: one with its texts.
pub(crate) fn show(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let proposed = find(ctx, Arguments::new("policy_proposal ID", args, 1, 1)?)?;
    let policies = policy_set::texts(ctx, &proposed.organisation, &proposed.policies)?;
    store::json(&PolicyProposalTexts { proposal: told(ctx, &proposed)?, policies })
}

/// The approval of the caller.
fn approval(ctx: &Context<'_>) -> Result<Approval, Rejection> {
    let until = ctx.block_time().saturating_add(APPROVAL_LIFE);
    let principal = Principal { attributes: BTreeMap::new(), ..Principal::of(ctx.submitter()?) };
    Ok(Approval { principal, until })
}

/// Refuses a proposal that was made from another set than the one in force.
fn check_base(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<(), Rejection> {
    let in_force = texts::version(ctx, &proposed.organisation)?.number;
    policy_sets::check_base(&proposed.organisation, proposed.base, in_force)
}

fn find(ctx: &Context<'_>, args: Arguments<'_>) -> Result<Proposed, Rejection> {
    let id = args.text(0, "ID")?;
    let is_id = id.len() == ID_DIGITS && id.bytes().all(|digit| digit.is_ascii_hexdigit());
    let proposed = if is_id { proposed::find(ctx, id)? } else { None };
    proposed.ok_or_else(|| {
        Rejection::new(Code::NotFound, "no proposed set of policies has this id")
            .found(shown(id))
            .wanted(format!("the id of one that stands, {ID_DIGITS} hexadecimal digits"))
            .next("ledgerctl policy proposals")
    })
}

/// Removes a proposal, and its texts where nothing else has them.
fn end(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<(), Rejection> {
    proposed::remove(ctx, &proposed.id)?;
    policy_set::forget(ctx, &proposed.organisation, &proposed.policies)
}

/// Writes a proposal, and answers with what counts of it now.
fn keep(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<Bytes, Rejection> {
    proposed::write(ctx, proposed)?;
    store::json(&told(ctx, proposed)?)
}

/// The proposal with what counts now.
fn told(ctx: &mut Context<'_>, proposed: &Proposed) -> Result<PolicyProposal, Rejection> {
    let now = ctx.block_time();
    let counted: Vec<&Approval> = proposed.counted(now).collect();
    let admins =
        counted.iter().map(|approval| (approval.principal.organisation.as_str(), approval.principal.name.as_str()));
    let again = active(Mutation::CountTheProposerTwice).then_some((proposed.organisation.as_str(), ""));
    let admins = admins.chain(again);
    let needs = policy_rules::needs(ctx, &proposed.organisation, admins)?;
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
