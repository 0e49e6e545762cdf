//! Any number of holders, and publishers without a grant.

use super::{Claim, Decision, Rule, Situation};
use ledger_contract::{Capabilities, Fencing, Mode, Publishing, Sequence, Sharing};

/// Everybody whom policies permit.
pub(super) struct Open;

impl Rule for Open {
    fn mode(&self) -> Mode {
        Mode::OPEN
    }

    fn capabilities(&self, _sharing: &Sharing) -> Capabilities {
        Capabilities { publishing: Publishing::Policy, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher }
    }

    fn keys(&self) -> &'static [&'static str] {
        &["idle_release_ms"]
    }

    fn decide(&self, _contender: &Claim, _situation: &Situation<'_>) -> Decision {
        Decision::Grant { ends: Vec::new() }
    }
}
