//! `replace`: describing robots again.

use crate::arguments::Arguments;
use crate::calls::setup::ROBOTS_PER_SETUP_MAX;
use crate::calls::{description, robot_change};
use crate::lifecycle::robots;
use crate::policy::decider::Decider;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `replace ROBOT_JSON...`: as `setup`, also for robots that exist; by an admin of their owner.
pub(crate) fn replace(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("replace ROBOT_JSON...", args, 1, ROBOTS_PER_SETUP_MAX)?;
    let admin = robots::admin(ctx, "change robots")?;
    let mut changes = Vec::new();
    for index in 0..args.rest(0).len() {
        let spec = description::read_spec(args, index)?;
        let before = description::registered(ctx, &spec.name)?;
        match &before {
            Some(robot) => robots::check_owner(robot, admin)?,
            None => description::check_look(ctx, &spec.name)?,
        }
        description::check_base(&spec.name, before.as_ref(), spec.base.as_deref())?;
        let after = description::describe(ctx, decider, &admin.organisation, spec, before.as_ref())?;
        changes.push(robot_change::change(ctx, decider, before, after)?);
    }
    store::json(&changes)
}
