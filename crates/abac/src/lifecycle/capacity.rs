//! How much one call or the start of one block may report.

use ledger::Context;

/// Most grants that one call or the start of one block ends with an event each.
pub(crate) const ENDINGS_MAX: usize = 256;

/// Events that the end of one right, or one turn, may take.
const EVENTS_OF_ONE: usize = 64;

/// Is there no room for the events of one more end or turn? The rest is done by the following blocks.
pub(crate) fn is_full(ctx: &Context<'_>) -> bool {
    ctx.events_left() < EVENTS_OF_ONE
}
