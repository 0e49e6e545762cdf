//! `remove`: taking a robot out of service.

use crate::arguments::Arguments;
use crate::lifecycle::robots;
use crate::lifecycle::settle::settle;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `remove ROBOT`: takes a robot out of service; by an admin of its owner. Its epochs are kept.
pub(crate) fn remove(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("remove ROBOT", args, 1, 1)?;
    let admin = robots::admin(ctx, "remove robots")?;
    let robot = robot::find(ctx, args.text(0, "ROBOT")?)?;
    robots::check_owner(&robot, admin)?;
    let ending = robots::take_out(ctx, &robot)?;
    let ended = settle(ctx, ending)?;
    robots::tell(ctx, &robot, "removed")?;
    store::json(&ended)
}
