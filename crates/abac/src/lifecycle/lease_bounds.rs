//! The bounds of a lease: what a service allows, and what a caller asks for.

use crate::arguments::Arguments;
use crate::records::target::Target;
use ledger_base::rejection::Rejection;

/// Shortest lease (milliseconds): below it a grant would expire before its first use.
pub(crate) const LEASE_MS_MIN: u64 = 100;

/// The lease that the caller asks for.
pub(crate) fn lease(target: &Target, args: Arguments<'_>, index: usize) -> Result<u64, Rejection> {
    let lease_ms = args.number(index, "LEASE_MS")?;
    check_lease(target, args, index, lease_ms)?;
    Ok(lease_ms)
}

/// Refuses a lease that the service does not allow.
pub(crate) fn check_lease(target: &Target, args: Arguments<'_>, index: usize, lease_ms: u64) -> Result<(), Rejection> {
    let max = target.service.lease_ms_max;
    if (LEASE_MS_MIN..=max).contains(&lease_ms) {
        return Ok(());
    }
    let wanted = format!("{LEASE_MS_MIN} to {max} ms for {}", target.id);
    let refused = args.bad(index, "LEASE_MS", format!("{lease_ms} ms"), &wanted);
    if lease_ms <= max {
        return Err(refused);
    }
    let (service, owner) = (target.service_id(), &target.robot.organisation);
    Err(refused.next(format!(
        "renew it repeatedly: ledgerctl acquire {} --keep; an admin of {owner} can permit longer leases: ledgerctl \
         robot set {service} lease-max=…",
        target.id
    )))
}
