//! Emergency stops: a stopped robot is not commanded.

use crate::records::stopped;
use crate::records::target::Target;
use ledger::Context;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, Stopped};

/// May the service be commanded, or is its robot stopped?
///
/// # Errors
/// [`Code::Stopped`].
pub(crate) fn check_goes(ctx: &Context<'_>, target: &Target) -> Result<(), Rejection> {
    if target.service.direction != Direction::Command || target.is_for_readers() {
        return Ok(());
    }
    let Some(Stopped { by, reason, since }) = stopped::of(ctx, &target.robot.name)? else { return Ok(()) };
    let (name, owner) = (&target.robot.name, &target.robot.organisation);
    let why = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    Err(Rejection::new(Code::Stopped, format!("{name} is stopped"))
        .found(format!("stopped by {by} at {}{why}", rfc3339(since)))
        .wanted("a robot that is not stopped")
        .next(format!("once it is safe, an admin of {owner} resumes it: ledgerctl resume {name}")))
}
