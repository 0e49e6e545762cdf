//! One holder at a time.

use super::contest::contend;
use super::{Claim, Decision, Rule, Situation};
use ledger_contract::{Capabilities, Fencing, Mode, Publishing, Sequence, Sharing};

/// The holder of the service keeps it from the others.
pub(super) struct Exclusive;

impl Rule for Exclusive {
    fn mode(&self) -> Mode {
        Mode::EXCLUSIVE
    }

    fn capabilities(&self, _sharing: &Sharing) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::Newest, sequence: Sequence::PerEpoch }
    }

    fn keys(&self) -> &'static [&'static str] {
        &[
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

    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision {
        contend(1, contender, situation)
    }
}
