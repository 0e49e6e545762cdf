//! `policy withdraw`: taking back a proposal or an approval.

use crate::arguments::Arguments;
use crate::lifecycle::{policy_proposals, robots};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};

/// `policy withdraw ID`: an admin of the organisation takes the proposal back, one of another their approval.
pub(crate) fn withdraw(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy withdraw ID", args, 1, 1)?;
    let caller = robots::admin(ctx, "withdraw policies")?;
    let mut proposed = policy_proposals::find(ctx, args)?;
    let before = proposed.approved.len();
    proposed.approved.retain(|approval| approval.principal.id() != caller.id());
    let told = if caller.organisation == proposed.organisation {
        policy_proposals::end(ctx, &proposed)?;
        store::json(&policy_proposals::told(ctx, &proposed)?)?
    } else if proposed.approved.len() < before {
        policy_proposals::keep(ctx, &proposed)?
    } else {
        return Err(Rejection::new(Code::NotFound, format!("{} has not approved this", caller.id()))
            .found(format!("a proposal of {}", proposed.organisation))
            .wanted("a proposal of its own organisation, or its own approval"));
    };
    ctx.emit("policy_withdrawn", &proposed.organisation, told.clone());
    Ok(told)
}
