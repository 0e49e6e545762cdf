//! Since which rules services have settings of their own for who wins, and robots can be stopped.

use ledger::{Context, Rules};

/// The rules that brought lines, limits and stops.
const SINCE: u32 = 3;

/// The same, for tables of defaults.
pub(crate) const RULES: Rules = match Rules::find(SINCE) {
    Some(rules) => rules,
    None => Rules::NEWEST,
};

/// Do these rules know them?
pub(crate) fn known(ctx: &Context<'_>) -> bool {
    ctx.rules() >= RULES
}
