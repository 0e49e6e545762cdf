//! The clock of this machine.

use std::time::{SystemTime, UNIX_EPOCH};

/// The machine's clock, microseconds since the UNIX epoch.
pub(crate) fn now() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_micros()).unwrap_or(u64::MAX)
}
