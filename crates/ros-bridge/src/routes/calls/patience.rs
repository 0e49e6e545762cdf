//! How long a reply is waited for.

use std::time::Duration;

use ledger_base::settings::Section;

/// Shortest and longest time that a reply is waited for.
pub(in crate::routes) const WAIT_MS_MIN: u64 = 100;
const WAIT_MS_MAX: u64 = 3_600_000;
const WAIT_MS_DEFAULT: u64 = 10_000;
/// How long a reply is waited for by default.
pub(in crate::routes) const PATIENCE: Duration = Duration::from_millis(WAIT_MS_DEFAULT);

/// Reads how long a reply is waited for.
pub(in crate::routes) fn patience(section: &mut Section<'_, '_>, key: &'static str) -> Duration {
    let mut wait_ms = WAIT_MS_DEFAULT;
    section.integer(key, WAIT_MS_MIN..=WAIT_MS_MAX, &mut wait_ms);
    Duration::from_millis(wait_ms)
}
