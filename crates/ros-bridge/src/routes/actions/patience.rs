//! How long a result is waited for.

use std::time::Duration;

use ledger_base::settings::Section;

use crate::routes::calls::WAIT_MS_MIN;

/// The setting of how long a result is waited for.
pub(super) const RESULT_KEY: &str = "result_timeout_ms";
/// Longest time that a result is waited for, or that a goal runs.
pub(super) const RUN_MS_MAX: u64 = 86_400_000;
/// `result_timeout_ms` by default: actions take their time.
const RESULT_MS_DEFAULT: u64 = 3_600_000;
/// How long a result is waited for by default.
pub(super) const RESULT_PATIENCE: Duration = Duration::from_millis(RESULT_MS_DEFAULT);

/// Reads how long a result is waited for.
pub(super) fn result_patience(section: &mut Section<'_, '_>) -> Duration {
    let mut wait_ms = RESULT_MS_DEFAULT;
    section.integer(RESULT_KEY, WAIT_MS_MIN..=RUN_MS_MAX, &mut wait_ms);
    Duration::from_millis(wait_ms)
}
