//! Conflict: the rule behind a service's mode says which of several callers that may gets the service. One file for
//! each rule, and one table of them.
//!
//! Nothing above this layer knows the name of a rule. A caller asks what the rule [decides](Rule::decide), or what
//! [follows](Rule::capabilities) from it for publishers, gates and clients. A new rule is a file here and a row of
//! [`TABLE`]; a demand of it that no rule made before becomes a capability or a part of [`Decision`].

mod exclusive;
mod open;

use crate::records::principal::Principal;
use crate::records::service::Target;
use ledger_contract::{Capabilities, Direction, Grant, Mode};
use ledger_rejection::{Code, Rejection};

/// Decides between one who may have a service and those who have it. A rule is pure: the same contender and holders
/// give the same decision on every node.
pub(crate) trait Rule: Sync {
    /// The consequences of the rule for publishers, for gates and for clients.
    fn capabilities(&self) -> Capabilities;

    /// The treatment of a contender that policies permit and that holds nothing of this service yet. `holders` are
    /// those who hold it now, oldest grant first.
    fn decide<'g>(&self, contender: &Principal, holders: &[&'g Grant]) -> Decision<'g>;
}

/// The decision of a [`Rule`] about a contender.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Decision<'g> {
    /// The contender gets a grant. The grants in `ends` end first, in the same block.
    Grant { ends: Vec<&'g Grant> },
    /// The contender waits until this grant ends. No service has a line yet, so whoever would wait is refused.
    Wait(&'g Grant),
}

/// Every mode with its rule.
static TABLE: [(Mode, &dyn Rule); 2] = [(Mode::Open, &open::Open), (Mode::Exclusive, &exclusive::Exclusive)];

/// The mode of a service whose owner names none.
pub(crate) fn default_mode(direction: Direction) -> Mode {
    match direction {
        Direction::Feed => Mode::Open,
        _ => Mode::Exclusive,
    }
}

/// The rule of a service.
///
/// # Errors
/// [`Code::Internal`] if its mode has no rule.
pub(crate) fn rule(target: &Target) -> Result<&'static dyn Rule, Rejection> {
    let mode = target.service.mode;
    TABLE.iter().find(|(of, _)| *of == mode).map(|(_, rule)| *rule).ok_or_else(|| {
        Rejection::new(Code::Internal, format!("the mode {mode} of {} has no rule", target.id))
            .next("report it: this is a fault of the program")
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Fencing, Sequence, Word};

    #[test]
    fn every_mode_has_one_rule() {
        let modes: Vec<Mode> = TABLE.iter().map(|(mode, _)| *mode).collect();
        assert_eq!(modes, Mode::ALL);
    }

    #[test]
    fn a_client_derives_the_capabilities_of_an_older_node_as_that_node_would_tell_them() {
        for (mode, rule) in TABLE {
            assert_eq!(Capabilities::of_mode(mode).unwrap(), rule.capabilities(), "{mode}");
        }
    }

    /// Only one holder at a time can share a key with nobody: see `records::last`.
    #[test]
    fn sequences_count_by_epoch_only_where_the_newest_epoch_alone_may_publish() {
        for (mode, rule) in TABLE {
            let Capabilities { fencing, sequence, .. } = rule.capabilities();
            assert!(sequence != Sequence::PerEpoch || fencing == Fencing::Newest, "{mode}");
        }
    }
}
