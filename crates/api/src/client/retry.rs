//! Retries: their times, and the rejections that end them.

use ledger_base::rejection::{Class, Code, Rejection};
use std::time::Duration;

/// After this long without any answer, while one is due, the node counts as stuck, and another one is asked.
pub(super) const ATTEMPT_MAX: Duration = Duration::from_secs(3);
/// After this long without its answer, a call is given to a node of another organisation, too: the leader, or the node that the client
/// has, may withhold it.
pub(super) const ELSEWHERE_AFTER: Duration = Duration::from_secs(1);
/// How long a node that said "not now" is left in peace.
pub(super) const RETRY_AFTER: Duration = Duration::from_millis(100);

/// Is it the trouble of a node, and no verdict about a call?
pub(super) fn is_of_node(reason: &Rejection) -> bool {
    !is_final(reason) || matches!(reason.code, Code::DiskFull | Code::Behind)
}

/// Is it a reason that waiting does not cure?
pub(super) fn is_final(reason: &Rejection) -> bool {
    reason.code.class() != Class::Unreachable
}
