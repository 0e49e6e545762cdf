//! Side doors: the last report of each command service on which somebody publishes around the ledger.

use super::robot::Robot;
use super::store;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::SideDoor;

/// The last report about a service.
///
/// # Errors
/// [`ledger_base::rejection::Code::Corrupt`] if the state cannot be read.
pub(crate) fn of(ctx: &Context<'_>, service: &str) -> Result<Option<SideDoor>, Rejection> {
    store::read(ctx, &store::side_door_key(service))
}

/// Puts a report in the place of the last one.
pub(crate) fn put(ctx: &mut Context<'_>, report: &SideDoor) -> Result<(), Rejection> {
    store::write(ctx, &store::side_door_key(&report.service), report)
}

/// Forgets the reports about services that `before` offers and `after` does not.
pub(crate) fn forget(ctx: &mut Context<'_>, before: &Robot, after: Option<&Robot>) {
    for service in &before.services {
        let stays = after.is_some_and(|after| after.services.iter().any(|kept| kept.topic == service.topic));
        let key = store::side_door_key(&before.service_id(service));
        if !stays && ctx.get(&key).is_some() {
            ctx.delete(&key);
        }
    }
}
