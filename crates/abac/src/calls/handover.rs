//! `handover`: a holder passes its grant on for good.

use crate::arguments::Arguments;
use crate::lifecycle::delegation;
use crate::policy::decider::Decider;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `handover SERVICE RECEIVER [OPTIONS_JSON]`: by the holder, for good.
pub(crate) fn handover(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("handover SERVICE RECEIVER [OPTIONS_JSON]", args, 2, 3)?;
    let options = delegation::options(args, 2)?;
    delegation::only_stop(args, 2, &options)?;
    delegation::pass_on(ctx, decider, args, &options, true)
}
