//! When a service is looked at again, at the start of a block.

use crate::records::target::Target;
use crate::records::{line, pending, task};
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// Something about the service has changed that may make it somebody's turn.
pub(crate) fn look_now(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let nobody = |ctx: &Context<'_>| {
        line::is_empty(ctx, service) && task::open(ctx, service, 1).is_empty() && pending::is_empty(ctx, service)
    };
    if !nobody(ctx) {
        line::look_by(ctx, service, ctx.block_time())?;
    }
    Ok(())
}

/// The settings of the service have changed.
pub(crate) fn settings_changed(ctx: &mut Context<'_>, target: &Target) -> Result<(), Rejection> {
    if Terms::of(&target.service.sharing).idle_release_us.is_some() {
        line::look_by(ctx, &target.id, ctx.block_time())?;
    }
    look_now(ctx, &target.id)
}

/// When a service is to be looked at next (block time, microseconds).
pub(crate) fn next_look(ctx: &Context<'_>) -> Option<u64> {
    line::next_looks(ctx, 1).first().map(|(time, _)| *time)
}
