//! As many holders as the owner says, and as many readers: `k1` and `k2` of the paper.

use super::contest::contend;
use super::open::Open;
use super::{Claim, Decision, Rule, Situation};
use ledger_contract::{Capabilities, Fencing, Mode, Publishing, Sequence, Sharing};

/// Holders stand side by side until every place is taken. Where only readers are limited, everybody may publish.
pub(super) struct Limited;

impl Rule for Limited {
    fn mode(&self) -> Mode {
        Mode::LIMITED
    }

    fn capabilities(&self, sharing: &Sharing) -> Capabilities {
        if sharing.publishers.is_none() {
            return Open.capabilities(sharing);
        }
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher }
    }

    fn keys(&self) -> &'static [&'static str] {
        &[
            "publishers",
            "subscribers",
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
        &["publishers", "subscribers"]
    }

    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision {
        match situation.sharing.publishers {
            Some(places) => contend(usize::try_from(places).unwrap_or(usize::MAX), contender, situation),
            None => Open.decide(contender, situation),
        }
    }
}
