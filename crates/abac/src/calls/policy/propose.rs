//! `policy propose`: a set that others are to agree to.

use crate::arguments::Arguments;
use crate::lifecycle::policy_proposals::ID_DIGITS;
use crate::lifecycle::policy_sets::Draft;
use crate::lifecycle::{policy_proposals, policy_sets, reachable, robots};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::records::proposed::Proposed;
use crate::records::{policy_set, proposed, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// Most proposals of one organisation.
const PROPOSALS_MAX: usize = 8;

/// `policy propose SET_JSON`: by an admin, who agrees thereby.
pub(crate) fn propose(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy propose SET_JSON", args, 1, 1)?;
    let caller = robots::admin(ctx, "propose policies")?;
    let organisation = &caller.organisation;
    let draft = policy_sets::read(ctx, decider, organisation, args)?;
    if draft.is_in_force {
        return Err(Rejection::new(
            Code::AlreadyExists,
            format!("this policy set of {organisation} is in force already"),
        )
        .found(format!("the policies and the rule of version {}", draft.base))
        .wanted("a set with changes"));
    }
    reachable::check(ctx, decider, organisation, &draft.texts, draft.means_it)?;
    let own = proposed::all(ctx)?.into_iter().filter(|proposed| proposed.organisation == *organisation).count();
    if own >= PROPOSALS_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("{organisation} has too many proposed policy sets"))
            .found(format!("{own} proposals"))
            .wanted(format!("at most {PROPOSALS_MAX}"))
            .next("withdraw one: ledgerctl policy withdraw ID"));
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
        approved: vec![policy_proposals::approval(ctx)?],
    };
    let told = policy_proposals::keep(ctx, &proposed)?;
    ctx.emit("policy_proposed", &proposed.organisation, told.clone());
    Ok(told)
}
