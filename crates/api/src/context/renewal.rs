//! When the certificate of a context is renewed, and from when on its end is near.

use super::Context;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// In the last days of a certificate whoever uses it is warned.
pub const WARNING_DAYS: u64 = 30;
const DAY: u64 = 24 * 3600 * 1_000_000;

/// Is a certificate renewed when it is used?
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RenewalRule {
    /// In the last third of its life.
    #[default]
    Auto,
    /// Only when somebody says so.
    Never,
}

impl RenewalRule {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// As it is written in `context.toml`.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Never => "never",
        }
    }
}

/// When a certificate of this validity shall be renewed: two thirds through it. The last third is for nodes that are
/// away and for people who look into it. All in microseconds since the UNIX epoch.
pub fn renewal_due(not_before: u64, not_after: u64) -> u64 {
    not_after.saturating_sub(not_after.saturating_sub(not_before) / 3)
}

/// From when on people are warned of the end of a certificate of this validity: thirty days before, but never while it
/// has no need to be renewed yet. All in microseconds since the UNIX epoch.
pub fn warning_due(not_before: u64, not_after: u64) -> u64 {
    renewal_due(not_before, not_after).max(not_after.saturating_sub(WARNING_DAYS * DAY))
}

impl Context {
    /// The home in which the context is stored, if it was loaded from one.
    pub fn home(&self) -> Option<PathBuf> {
        Some(self.memory.directory()?.parent()?.parent()?.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_are_warned_in_the_last_thirty_days_and_not_before_the_last_third() {
        assert_eq!(warning_due(0, 365 * DAY), 335 * DAY);
        assert_eq!(warning_due(0, 9 * DAY), 6 * DAY);
    }
}
