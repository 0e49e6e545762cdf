//! Who wins when several may: the rules behind a service's mode.

use crate::grant::Principal;
use ledger_contract::{Grant, Mode};

/// Decides between one who may have a service and those who have it. A rule is pure: the same contender and
/// holders give the same outcome on every node.
///
/// A rule for more modes (limited, queued, preemptive) is another implementation and, where it needs an answer that
/// does not exist yet, another [`Outcome`]; the compiler then names every place that must learn it.
pub(crate) trait ConflictRule: Sync {
    /// Does publishing need a grant, or only a policy that permits it?
    fn publishing_needs_grant(&self) -> bool;

    /// What happens to a contender that policies permit and that holds nothing of this service yet. `holders` are
    /// those who hold it now, oldest grant first.
    fn resolve<'g>(&self, contender: &Principal, holders: &[&'g Grant]) -> Outcome<'g>;
}

/// What a [`ConflictRule`] decides.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Outcome<'g> {
    /// The contender gets a grant beside those who have one.
    Granted,
    /// Somebody else keeps the service from the contender.
    Held(&'g Grant),
}

/// Any number of holders.
pub(crate) struct Open;

impl ConflictRule for Open {
    fn publishing_needs_grant(&self) -> bool {
        false
    }

    fn resolve<'g>(&self, _contender: &Principal, _holders: &[&'g Grant]) -> Outcome<'g> {
        Outcome::Granted
    }
}

/// One holder at a time, first come, first served.
pub(crate) struct Exclusive;

impl ConflictRule for Exclusive {
    fn publishing_needs_grant(&self) -> bool {
        true
    }

    fn resolve<'g>(&self, _contender: &Principal, holders: &[&'g Grant]) -> Outcome<'g> {
        holders.first().map_or(Outcome::Granted, |grant| Outcome::Held(grant))
    }
}

/// The rule of a mode.
pub(crate) fn rule(mode: Mode) -> &'static dyn ConflictRule {
    match mode {
        Mode::Open => &Open,
        Mode::Exclusive => &Exclusive,
    }
}
