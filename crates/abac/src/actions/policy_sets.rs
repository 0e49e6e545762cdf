//! Numbered sets of policies: `policy apply`, `policy_history`, `policy_set`.

use super::policies::{self, Made};
use super::{policy_rules, reachable, robots};
use crate::arguments::{Arguments, shown};
use crate::policy::Texts;
use crate::policy::decider::Decider;
use crate::policy::limits::{self, POLICY_BYTES_MAX};
use crate::policy::texts::{self, POLICIES_MAX};
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::{Context, Quorum};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyDraft, PolicySet, PolicySetTexts, PolicyText};
use std::collections::BTreeSet;

/// Longest set as an argument, in bytes of JSON: twice its texts.
const DRAFT_BYTES_MAX: usize = 2 * limits::STEPS_MAX as usize;
/// Longest message about a set, in bytes.
const MESSAGE_BYTES_MAX: usize = 512;
/// The rule of an organisation that has none.
pub(super) const NO_RULE: &str = "none";

/// A set that an admin wants.
pub(super) struct Draft {
    pub(super) texts: Texts,
    pub(super) message: String,
    pub(super) restores: Option<u64>,
    /// The rule of the organisation from then on.
    pub(super) rule: Option<Quorum>,
    pub(super) means_it: bool,
    /// The number of the set in force.
    pub(super) base: u64,
    /// Is it the set in force?
    pub(super) is_in_force: bool,
}

/// `policy apply SET_JSON`: the set takes the place of the one in force, if an admin may decide that alone.
pub(super) fn apply(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy apply SET_JSON", args, 1, 1)?;
    let caller = robots::admin(ctx, "change policies")?;
    let organisation = &caller.organisation;
    let draft = read(ctx, decider, organisation, args)?;
    policy_rules::check_alone(ctx, caller)?;
    if draft.is_in_force {
        return store::json(&PolicyChange {
            organisation: organisation.clone(),
            id: String::new(),
            change: "unchanged".to_owned(),
            default_in_force: draft.texts.is_empty(),
            ended: Vec::new(),
            version: draft.base,
            by: caller.id(),
            message: draft.message,
        });
    }
    reachable::check(ctx, decider, organisation, &draft.texts, draft.means_it)?;
    let Draft { texts, message, restores, rule, .. } = draft;
    let made = Made { by: caller.id(), message, restores, rule, ..Made::default() };
    policies::replace(ctx, decider, organisation, &texts, ("", done(restores)), made)
}

/// The word for what became of a whole set.
pub(super) fn done(restores: Option<u64>) -> &'static str {
    if restores.is_some() { "restored" } else { "applied" }
}

/// Reads a set that is to take the place of the one in force.
pub(super) fn read(
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
    let in_force = texts::own(ctx, organisation)?;
    let base = texts::version(ctx, organisation)?.number;
    check_base(organisation, made_from.unwrap_or(base), base)?;
    let own_rule = policy_rules::own(ctx, organisation)?;
    let (policies, restored_rule) = match (policies, restores) {
        (Some(policies), None) => (policies, None),
        (None, Some(version)) => {
            let set = find(ctx, organisation, version)?;
            let policies = policy_set::texts(ctx, organisation, &set.policies)?;
            (policies, Some(policy_rules::parse(set.approvals.as_deref())?))
        }
        _ => return Err(args.bad(0, "SET_JSON", "both of policies and restores, or none of them".to_owned(), wanted)),
    };
    // Before they are validated, which takes long.
    policies::check_number(ctx, organisation, policies.len())?;
    let texts = texts_of(ctx, decider, &policies)?;
    limits::steps_of_all(&texts)?;
    let rule = match approvals.as_deref() {
        None => restored_rule.unwrap_or_else(|| own_rule.clone()),
        Some(NO_RULE) => None,
        Some(text) => Some(policy_rules::quorum(ctx, args, text)?),
    };
    let is_in_force = texts == in_force && rule == own_rule && base > 0;
    Ok(Draft { texts, message, restores, rule, means_it, base, is_in_force })
}

/// Refuses a set that was made from another one than the one in force.
pub(super) fn check_base(organisation: &str, made_from: u64, in_force: u64) -> Result<(), Rejection> {
    if made_from == in_force {
        return Ok(());
    }
    Err(Rejection::new(Code::PoliciesChanged, format!("the policies of {organisation} have changed meanwhile"))
        .found(format!("version {in_force} in force"))
        .wanted(format!("version {made_from}, which this was made from"))
        .next("ledgerctl policy history shows what has changed; make it again from the set in force"))
}

fn texts_of(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    for policy in policies {
        policies::check_id(&policy.id)?;
    }
    checked(ctx, decider, policies)
}

/// Policies that are not on the ledger, each acceptable there.
pub(super) fn checked(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    if policies.len() > POLICIES_MAX {
        return Err(Rejection::new(Code::LimitExceeded, "the set has too many policies")
            .found(policies.len().to_string())
            .wanted(format!("at most {POLICIES_MAX}"))
            .next("put several rules into one policy"));
    }
    let (mut texts, mut ids) = (Texts::new(), BTreeSet::new());
    for PolicyText { id, text } in policies {
        if id.is_empty() || id.len() > policies::ID_BYTES_MAX || !ids.insert(id) {
            return Err(Rejection::new(Code::BadArgument, "the name of a policy is not usable")
                .found(shown(id))
                .wanted(format!("a name of its own of at most {} bytes for each", policies::ID_BYTES_MAX))
                .next("name each policy file differently"));
        }
        decider.check(ctx, text).map_err(|mut refused| {
            refused.message = format!("{} ({id})", refused.message);
            refused.next =
                format!("its places: ledgerctl policy check FILE; a policy has at most {POLICY_BYTES_MAX} bytes");
            refused
        })?;
        texts.push((id.clone(), text.clone()));
    }
    texts.sort();
    Ok(texts)
}

/// Keeps a set that is in force now.
pub(super) fn record(
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

/// `policy_history ORGANISATION`: its sets that are kept, the newest first.
pub(crate) fn history(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy_history ORGANISATION", args, 1, 1)?;
    store::json(&policy_set::all(ctx, args.text(0, "ORGANISATION")?)?)
}

/// `policy_set ORGANISATION VERSION`: one of them with its texts.
pub(crate) fn show(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy_set ORGANISATION VERSION", args, 2, 2)?;
    let organisation = args.text(0, "ORGANISATION")?;
    let set = find(ctx, organisation, args.number(1, "VERSION")?)?;
    let policies = policy_set::texts(ctx, organisation, &set.policies)?;
    store::json(&PolicySetTexts { set, policies })
}

fn find(ctx: &Context<'_>, organisation: &str, version: u64) -> Result<PolicySet, Rejection> {
    let set = policy_set::of(ctx, organisation, version)?;
    set.ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("{organisation} keeps no set of policies with this number"))
            .found(version.to_string())
            .wanted(format!("one of its newest {} sets", policy_set::KEPT))
            .next("ledgerctl policy history")
    })
}
