//! As many holders as the owner says: `k1` of the paper.

use super::contest::contend;
use super::{Claim, Decision, Rule, Situation};
use ledger_contract::{Capabilities, Fencing, Mode, Publishing, Sequence};

/// Holders stand side by side until every place is taken.
pub(super) struct Limited;

impl Rule for Limited {
    fn mode(&self) -> Mode {
        Mode::LIMITED
    }

    fn capabilities(&self) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher }
    }

    fn keys(&self) -> &'static [&'static str] {
        &[
            "publishers",
            "on_conflict",
            "queue_max",
            "queue_wait_max_ms",
            "priority",
            "aging_ms",
            "min_hold_ms",
            "idle_release_ms",
            "delegable",
            "confirm",
            "confirm_within_ms",
        ]
    }

    fn required(&self) -> &'static [&'static str] {
        &["publishers"]
    }

    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision {
        contend(usize::try_from(situation.sharing.publishers.unwrap_or(1)).unwrap_or(usize::MAX), contender, situation)
    }
}
