//! `policy enact`: a proposed set comes in force.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::policy_approvals::OF_NETWORK;
use crate::lifecycle::policy_sets::Made;
use crate::lifecycle::{policy_approvals, policy_proposals, policy_sets, reachable, robots};
use crate::policy::decider::Decider;
use crate::records::policy_set;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};

/// The word of who enacts a proposal without that rule.
const BREAK_GLASS: &str = "break-glass";

/// `policy enact ID [break-glass]`: puts a proposal in force to which enough agree; by an admin of its organisation.
pub(crate) fn enact(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy enact ID [break-glass]", args, 1, 2)?;
    let caller = robots::admin(ctx, "enact policies")?;
    let breaks = match args.has(1).then(|| args.text(1, BREAK_GLASS)).transpose()? {
        None => false,
        Some(BREAK_GLASS) => true,
        Some(word) => return Err(args.bad(1, BREAK_GLASS, shown(word), BREAK_GLASS)),
    };
    let proposed = policy_proposals::find(ctx, args)?;
    let organisation = &proposed.organisation;
    if caller.organisation != *organisation {
        return Err(Rejection::new(Code::NotOwner, format!("this proposal belongs to {organisation}"))
            .found(format!("{}, an admin of {}", caller.id(), caller.organisation))
            .wanted(format!("an admin of {organisation}"))
            .next(format!("ask an admin of {organisation}: ledgerctl policy apply --proposal {}", proposed.id)));
    }
    policy_proposals::check_base(ctx, &proposed)?;
    let told = policy_proposals::told(ctx, &proposed)?;
    let approved_by: Vec<String> = told.approved.iter().map(|approval| approval.who.clone()).collect();
    let mut broken = false;
    for need in told.needs.iter().filter(|need| need.missing > 0) {
        let refused = || {
            policy_approvals::not_agreed(organisation, need).found(format!("approved by {}", approved_by.join(", ")))
        };
        if need.of == OF_NETWORK || !breaks {
            return Err(refused().next(format!("to approve: ledgerctl policy approve {}", proposed.id)));
        }
        if ctx.block_time() < told.break_glass_from {
            let hours = (told.break_glass_from - ctx.block_time()).div_ceil(3600 * 1_000_000);
            return Err(refused()
                .next(format!("wait for the approvals, or {hours} hours: then it can be applied without them")));
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
        rule: policy_approvals::parse(proposed.approvals.as_deref())?,
    };
    let done = policy_sets::replace(ctx, decider, organisation, &texts, policy_sets::done(proposed.restores), made)?;
    policy_proposals::end(ctx, &proposed)?;
    Ok(done)
}
