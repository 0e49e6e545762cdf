//! `policy approve`: agreeing to a proposed set.

use crate::arguments::Arguments;
use crate::lifecycle::{policy_proposals, robots};
use crate::records::proposed::Approval;
use bytes::Bytes;
use ledger::{ADMINS_PER_ORGANISATION_MAX, Context};
use ledger_base::rejection::{Code, Rejection};

/// `policy approve ID`: by an admin of any organisation.
pub(crate) fn approve(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy approve ID", args, 1, 1)?;
    robots::admin(ctx, "approve policies")?;
    let mut proposed = policy_proposals::find(ctx, args)?;
    policy_proposals::check_base(ctx, &proposed)?;
    let (own, now) = (policy_proposals::approval(ctx)?, ctx.block_time());
    let counted: Vec<Approval> = proposed.counted(now).cloned().collect();
    let same = |other: &Approval| other.principal.id() == own.principal.id();
    proposed.approved = counted.into_iter().filter(|other| !same(other)).collect();
    let organisation = &own.principal.organisation;
    let theirs = proposed.approved.iter().filter(|other| other.principal.organisation == *organisation).count();
    if theirs >= ADMINS_PER_ORGANISATION_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("enough admins of {organisation} have approved this"))
            .found(format!("{theirs} approvals"))
            .wanted(format!("at most {ADMINS_PER_ORGANISATION_MAX} per organisation")));
    }
    proposed.approved.push(own);
    let told = policy_proposals::keep(ctx, &proposed)?;
    ctx.emit("policy_approved", &proposed.organisation, told.clone());
    Ok(told)
}
