//! The list of refusals, for admins.

use crate::clients::rejections::Rejections;
use ledger_api::v1::DenialsResponse;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};

/// Refusals that are answered if the caller names no limit.
const DENIALS_DEFAULT: u32 = 100;

/// The latest refusals.
pub(super) fn latest(denials: &Rejections, caller: &Identity, limit: u32) -> Result<DenialsResponse, Rejection> {
    if caller.role != Role::Admin {
        return Err(Rejection::new(Code::NotAdmin, format!("{} may not read the rejections of others", caller.id()))
            .found(format!("role {}", caller.role))
            .wanted(format!("an admin of {}", caller.organisation)));
    }
    let limit = if limit == 0 { DENIALS_DEFAULT } else { limit };
    Ok(DenialsResponse { denials: denials.latest(limit as usize) })
}
