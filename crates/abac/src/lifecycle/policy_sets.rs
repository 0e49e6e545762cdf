//! Numbered sets of policies: reading a new one, and putting it in force.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::policy_approvals::NO_RULE;
use crate::lifecycle::{ends, policy_approvals, robots};
use crate::policy::decider::Decider;
use crate::policy::limits::POLICY_BYTES_MAX;
use crate::policy::texts::POLICIES_MAX;
use crate::policy::texts::own;
use crate::policy::{Texts, limits, texts};
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::msp::quota_reached;
use ledger::{Context, Quorum};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyDraft, PolicySet, PolicyText};
use std::collections::BTreeSet;

/// Longest id of a policy, in bytes.
pub(crate) const ID_BYTES_MAX: usize = 64;

/// The circumstances in which a set comes in force.
#[derive(Default)]
pub(crate) struct Made {
    pub(crate) by: String,
    pub(crate) message: String,
    pub(crate) approved_by: Vec<String>,
    pub(crate) break_glass: bool,
    pub(crate) restores: Option<u64>,
    /// The rule of the organisation from then on.
    pub(crate) rule: Option<Quorum>,
}

/// Puts a set in the place of the one in force, and ends the grants that it does not permit. `change` is the
/// word for what happened.
pub(crate) fn replace(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    set: &Texts,
    change: &str,
    made: Made,
) -> Result<Bytes, Rejection> {
    let before = own(ctx, organisation)?;
    texts::check(ctx, organisation, &before);
    let kept = |id: &str| set.iter().any(|(known, _)| known == id);
    for (gone, _) in before.iter().filter(|(id, _)| !kept(id)) {
        ctx.delete(&store::policy_key(organisation, gone));
    }
    for (id, text) in set.iter().filter(|policy| !before.contains(policy)) {
        ctx.put(&store::policy_key(organisation, id), text.as_bytes().to_vec());
    }
    let version = texts::changed(ctx, organisation, set)?;
    let change = PolicyChange {
        organisation: organisation.to_owned(),
        id: String::new(),
        change: change.to_owned(),
        default_in_force: set.is_empty(),
        ended: ends::policies_changed(ctx, decider, organisation)?,
        version,
        by: made.by.clone(),
        message: made.message.clone(),
    };
    record(ctx, organisation, version, set, made)?;
    let change = store::json(&change)?;
    ctx.emit("policy", organisation, change.clone());
    Ok(change)
}

/// Refuses more policies than an organisation may have.
pub(crate) fn check_number(ctx: &mut Context<'_>, organisation: &str, wanted: usize) -> Result<(), Rejection> {
    let most = robots::quotas(ctx, organisation)?.policies;
    if wanted as u64 <= most {
        return Ok(());
    }
    Err(quota_reached(organisation, "policies", most, "combine several rules in one policy, or remove one"))
}

pub(crate) fn check_id(id: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-');
    if (1..=ID_BYTES_MAX).contains(&id.len()) && id.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "the id of a policy is not usable")
        .found(shown(id))
        .wanted(format!("1 to {ID_BYTES_MAX} letters, digits, \"_\" and \"-\"")))
}

/// Longest set as an argument, in bytes of JSON: twice its texts.
const DRAFT_BYTES_MAX: usize = 2 * limits::STEPS_MAX as usize;

/// Longest message about a set, in bytes.
const MESSAGE_BYTES_MAX: usize = 512;

/// A set that an admin wants.
pub(crate) struct Draft {
    pub(crate) texts: Texts,
    pub(crate) message: String,
    pub(crate) restores: Option<u64>,
    /// The rule of the organisation from then on.
    pub(crate) rule: Option<Quorum>,
    pub(crate) means_it: bool,
    /// The number of the set in force.
    pub(crate) base: u64,
    /// Is it the set in force?
    pub(crate) is_in_force: bool,
}

/// The word for what became of a whole set.
pub(crate) fn done(restores: Option<u64>) -> &'static str {
    if restores.is_some() { "restored" } else { "applied" }
}

/// Reads a set that is to take the place of the one in force.
pub(crate) fn read(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    args: Arguments<'_>,
) -> Result<Draft, Rejection> {
    let wanted =
        "JSON with policies (of id and text) or restores (a number), and some of message, base, approvals and means_it";
    let draft: PolicyDraft = serde_json::from_str(args.document(0, "SET_JSON", DRAFT_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "SET_JSON", fault.to_string(), wanted))?;
    let PolicyDraft { policies, restores, message, base: made_from, approvals, means_it } = draft;
    if message.len() > MESSAGE_BYTES_MAX {
        let found = format!("a message of {} bytes", message.len());
        return Err(args.bad(0, "SET_JSON", found, &format!("at most {MESSAGE_BYTES_MAX} bytes")));
    }
    let in_force = own(ctx, organisation)?;
    let base = texts::version(ctx, organisation)?.number;
    check_base(organisation, made_from.unwrap_or(base), base)?;
    let own_rule = policy_approvals::own(ctx, organisation)?;
    let (policies, restored_rule) = match (policies, restores) {
        (Some(policies), None) => (policies, None),
        (None, Some(version)) => {
            let set = find(ctx, organisation, version)?;
            let policies = policy_set::texts(ctx, organisation, &set.policies)?;
            (policies, Some(policy_approvals::parse(set.approvals.as_deref())?))
        }
        _ => return Err(args.bad(0, "SET_JSON", "both of policies and restores, or none of them".to_owned(), wanted)),
    };
    // Before they are validated, which takes long.
    check_number(ctx, organisation, policies.len())?;
    let texts = texts_of(ctx, decider, &policies)?;
    limits::steps_of_all(&texts)?;
    let rule = match approvals.as_deref() {
        None => restored_rule.unwrap_or_else(|| own_rule.clone()),
        Some(NO_RULE) => None,
        Some(text) => Some(policy_approvals::quorum(ctx, args, text)?),
    };
    let is_in_force = texts == in_force && rule == own_rule && base > 0;
    Ok(Draft { texts, message, restores, rule, means_it, base, is_in_force })
}

/// Refuses a set that was made from another one than the one in force.
pub(crate) fn check_base(organisation: &str, made_from: u64, in_force: u64) -> Result<(), Rejection> {
    if made_from == in_force {
        return Ok(());
    }
    Err(Rejection::new(Code::PoliciesChanged, format!("the policies of {organisation} have changed in the meantime"))
        .found(format!("version {in_force} in force"))
        .wanted(format!("version {made_from}, from which this was made")))
}

fn texts_of(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    for policy in policies {
        check_id(&policy.id)?;
    }
    checked(ctx, decider, policies)
}

/// Policies that are not on the ledger, each acceptable there.
pub(crate) fn checked(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    if policies.len() > POLICIES_MAX {
        return Err(Rejection::new(Code::LimitExceeded, "the set has too many policies")
            .found(policies.len().to_string())
            .wanted(format!("at most {POLICIES_MAX}"))
            .next("combine several rules in one policy"));
    }
    let (mut texts, mut ids) = (Texts::new(), BTreeSet::new());
    for PolicyText { id, text } in policies {
        if id.is_empty() || id.len() > ID_BYTES_MAX || !ids.insert(id) {
            return Err(Rejection::new(Code::BadArgument, "the name of a policy is not usable")
                .found(shown(id))
                .wanted(format!("a unique name of at most {} bytes for each policy", ID_BYTES_MAX))
                .next("name each policy file differently"));
        }
        decider.check(ctx, text).map_err(|mut refused| {
            refused.message = format!("{} ({id})", refused.message);
            refused.next(format!(
                "for the positions: ledgerctl policy check FILE; a policy has at most \
                               {POLICY_BYTES_MAX} bytes"
            ))
        })?;
        texts.push((id.clone(), text.clone()));
    }
    texts.sort();
    Ok(texts)
}

/// Keeps a set that is in force now.
pub(crate) fn record(
    ctx: &mut Context<'_>,
    organisation: &str,
    version: u64,
    texts: &Texts,
    made: Made,
) -> Result<(), Rejection> {
    let Made { by, message, approved_by, break_glass, restores, rule } = made;
    let set = PolicySet {
        organisation: organisation.to_owned(),
        version,
        hash: texts::hash(texts).to_string(),
        by,
        message,
        time: ctx.block_time(),
        height: ctx.height(),
        approved_by,
        break_glass,
        restores,
        approvals: rule.map(|rule| rule.to_string()),
        policies: policy_set::keep(ctx, organisation, texts),
    };
    policy_set::put(ctx, &set)
}

pub(crate) fn find(ctx: &Context<'_>, organisation: &str, version: u64) -> Result<PolicySet, Rejection> {
    let set = policy_set::of(ctx, organisation, version)?;
    set.ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("{organisation} has no stored policy set with this number"))
            .found(version.to_string())
            .wanted(format!("one of its newest {} sets", policy_set::KEPT))
            .next("ledgerctl policy history")
    })
}
