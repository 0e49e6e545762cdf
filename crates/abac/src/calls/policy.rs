//! `policy`: changing the policies of an organisation, and proposing a change.

pub(super) mod apply;
mod approve;
mod enact;
mod propose;
mod withdraw;

use crate::arguments::{Arguments, shown};
use crate::policy::decider::Decider;
use bytes::Bytes;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::Rejection;

const USAGE: &str = "policy apply SET_JSON | propose SET_JSON | approve ID | withdraw ID | enact ID [break-glass]";
const VERBS: [&str; 5] = ["apply", "approve", "enact", "propose", "withdraw"];

/// `policy VERB …`: by an admin, for the robots of their organisation.
pub(crate) fn policy(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let given = Arguments::new(USAGE, args, 2, 3)?;
    match given.text(0, "VERB")? {
        "apply" => apply::apply(ctx, decider, given.rest(1)),
        "propose" => propose::propose(ctx, decider, given.rest(1)),
        "approve" => approve::approve(ctx, given.rest(1)),
        "withdraw" => withdraw::withdraw(ctx, given.rest(1)),
        "enact" => enact::enact(ctx, decider, given.rest(1)),
        verb => Err(given
            .bad(0, "VERB", shown(verb), &format!("one of {}", VERBS.join(", ")))
            .next(did_you_mean(verb, VERBS, ""))),
    }
}
