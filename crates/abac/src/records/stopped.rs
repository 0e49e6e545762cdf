//! Stops that last: a robot that is stopped is commanded by nobody.

use super::store;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::Stopped;

/// The stop that holds for a robot.
///
/// # Errors
/// [`ledger_base::rejection::Code::Corrupt`] if the state cannot be read.
pub(crate) fn of(ctx: &Context<'_>, robot: &str) -> Result<Option<Stopped>, Rejection> {
    store::read(ctx, &store::stopped_key(robot))
}

/// Stops a robot.
pub(crate) fn put(ctx: &mut Context<'_>, robot: &str, stopped: &Stopped) -> Result<(), Rejection> {
    store::write(ctx, &store::stopped_key(robot), stopped)
}

/// Ends the stop of a robot.
pub(crate) fn remove(ctx: &mut Context<'_>, robot: &str) {
    ctx.delete(&store::stopped_key(robot));
}
