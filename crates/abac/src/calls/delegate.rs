//! `delegate`: a holder passes its grant on, and may take it back.

use crate::arguments::Arguments;
use crate::lifecycle::delegation;
use crate::lifecycle::lease_bounds::LEASE_MS_MIN;
use crate::policy::decider::Decider;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// Longest time for which a grant is delegated (milliseconds): a day.
const FOR_MS_MAX: u64 = 86_400_000;

/// `delegate SERVICE RECEIVER [OPTIONS_JSON]`: by the holder, who may take it back.
pub(crate) fn delegate(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("delegate SERVICE RECEIVER [OPTIONS_JSON]", args, 2, 3)?;
    let options = delegation::options(args, 2)?;
    if let Some(ms) = options.for_ms.filter(|ms| !(LEASE_MS_MIN..=FOR_MS_MAX).contains(ms)) {
        let wanted = format!("for_ms from {LEASE_MS_MIN} to {FOR_MS_MAX}");
        return Err(args.bad(2, "OPTIONS_JSON", format!("{ms} ms"), &wanted));
    }
    delegation::pass_on(ctx, decider, args, &options, false)
}
