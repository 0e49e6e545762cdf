//! Conflict: the rule behind a service's mode says which of several callers that may gets the service. One file for
//! each rule, and one table of them.
//!
//! Nothing above this layer knows the name of a rule. A caller asks what the rule [decides](Rule::decide), whose
//! [turn](Rule::order) it is, or what [follows](Rule::capabilities) from it for publishers, gates and clients. A new rule is
//! a type that implements [`Rule`], installed with [`crate::AccessControl::with_rule`]; those of this crate are in a file
//! each and in [`BUILT_IN`].

mod contest;
mod exclusive;
mod limited;
mod open;
pub(crate) mod priority;
pub(crate) mod terms;

use self::terms::Terms;
use crate::records::target::Target;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Capabilities, Direction, Mode, Sharing};
use std::sync::Arc;

pub use contest::{contend, precedence};

/// Decides between one who may have a service, those who have it, and those who wait. A rule is pure: the same arguments
/// give the same decision on every node.
pub trait Rule: Send + Sync {
    /// The mode by which owners choose the rule.
    fn mode(&self) -> Mode;

    /// The consequences of the rule with these settings for publishers, for gates and for clients.
    fn capabilities(&self, sharing: &Sharing) -> Capabilities;

    /// The keys of [`Sharing`] that the rule reads. A service that sets another one is refused.
    fn keys(&self) -> &'static [&'static str];

    /// The keys among them of which the owner must set one at least.
    fn required(&self) -> &'static [&'static str] {
        &[]
    }

    /// How many may wait; those beyond leave the line. By default as `on_conflict` and `queue_max` say.
    fn line_max(&self, sharing: &Sharing) -> u64 {
        Terms::of(sharing).queue_max
    }

    /// Does the rule look at past use, [`Claim::used`]? The ledger notes it only for rules that do.
    fn remembers_use(&self) -> bool {
        false
    }

    /// The treatment of a contender that policies permit and that holds nothing of this service yet. If it waits already, it
    /// is not in `situation.line`.
    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision;

    /// The order in which turns come, as indexes of `situation.line`, the next one first. By default the highest
    /// [precedence] goes first, and among equals whoever came first.
    fn order(&self, situation: &Situation<'_>) -> Vec<usize> {
        contest::order(situation)
    }
}

/// One who holds a service or wants it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// `Org1/Salma`.
    pub who: String,
    /// The priority; more is more.
    pub priority: i64,
    /// Since when it holds or wants the service (block time, microseconds).
    pub since: u64,
    /// The order of arrival in line: less came earlier. The contender that is decided about for the first time came last.
    pub ticket: u64,
    /// For how long it held the service within the last hour (microseconds of block time); 0 if the rule does not
    /// [remember](Rule::remembers_use) it.
    pub used: u64,
}

/// All that a rule looks at besides the contender.
#[derive(Clone, Copy, Debug)]
pub struct Situation<'a> {
    /// The settings of the service.
    pub sharing: &'a Sharing,
    /// Those who hold the service, oldest grant first.
    pub holders: &'a [Claim],
    /// Those who wait, in order of arrival.
    pub line: &'a [Claim],
    /// Block time, microseconds.
    pub now: u64,
}

/// The decision of a [`Rule`] about a contender.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Decision {
    /// The contender gets a grant. The grants of these holders, by their index, end first, in the same block.
    Grant {
        /// Indexes of [`Situation::holders`].
        ends: Vec<usize>,
    },
    /// The contender waits in line. At that time (block time, microseconds) the decision may be another one even if nobody
    /// comes or goes.
    Wait {
        /// When to decide again.
        again: Option<u64>,
    },
    /// The contender is refused.
    Refuse,
}

/// The rules of a node: those of this crate, then those that were installed.
#[derive(Clone)]
pub(crate) struct Table(Vec<Arc<dyn Rule>>);

/// The mode of a service whose owner names none.
pub(crate) fn default_mode(direction: Direction) -> Mode {
    match direction {
        Direction::Feed => Mode::OPEN,
        _ => Mode::EXCLUSIVE,
    }
}

impl Table {
    /// The rules of this crate.
    pub(crate) fn built_in() -> Self {
        Self(vec![Arc::new(open::Open), Arc::new(exclusive::Exclusive), Arc::new(limited::Limited)])
    }

    /// Adds a rule.
    ///
    /// # Errors
    /// [`Code::AlreadyExists`] if its mode has one.
    pub(crate) fn add(&mut self, rule: Arc<dyn Rule>) -> Result<(), Rejection> {
        if self.find(&rule.mode()).is_some() {
            return Err(Rejection::new(Code::AlreadyExists, format!("the mode {} already has a rule", rule.mode()))
                .wanted("a unique name for each rule"));
        }
        self.0.push(rule);
        Ok(())
    }

    fn find(&self, mode: &Mode) -> Option<&dyn Rule> {
        self.0.iter().find(|rule| rule.mode() == *mode).map(|rule| &**rule)
    }

    /// The rule of a mode that an owner chooses.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if no rule has that name.
    pub(crate) fn chosen(&self, mode: &Mode) -> Result<&dyn Rule, Rejection> {
        self.find(mode).ok_or_else(|| {
            let modes: Vec<Mode> = self.0.iter().map(|rule| rule.mode()).collect();
            let names: Vec<&str> = modes.iter().map(Mode::name).collect();
            Rejection::new(Code::BadArgument, "there is no rule with this mode")
                .found(crate::arguments::shown(mode.name()))
                .wanted(format!("mode {}", names.join(" or ")))
                .next(did_you_mean(mode.name(), names, "ledgerctl robot set ROBOT/TOPIC mode=NAME"))
        })
    }

    /// The consequences of a service's rule.
    ///
    /// # Errors
    /// As [`Table::of`].
    pub(crate) fn capabilities(&self, target: &Target) -> Result<Capabilities, Rejection> {
        Ok(self.of(target)?.capabilities(&target.service.sharing))
    }

    /// The rule of a service.
    ///
    /// # Errors
    /// [`Code::UnknownMode`] if this node has none of its mode.
    pub(crate) fn of(&self, target: &Target) -> Result<&dyn Rule, Rejection> {
        let mode = &target.service.mode;
        self.find(mode).ok_or_else(|| {
            Rejection::new(Code::UnknownMode, format!("the mode {mode} of {} has no rule here", target.id))
                .next("start every node of the network with the same rules")
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Fencing, Sequence};

    #[test]
    fn every_mode_has_one_rule() {
        let mut table = Table::built_in();
        let modes: Vec<Mode> = table.0.iter().map(|rule| rule.mode()).collect();
        assert_eq!(modes, [Mode::OPEN, Mode::EXCLUSIVE, Mode::LIMITED]);
        assert_eq!(table.add(Arc::new(open::Open)).unwrap_err().code, Code::AlreadyExists);
    }

    #[test]
    fn the_modes_that_every_program_knows_by_name_have_the_capabilities_of_their_rules() {
        for mode in [Mode::OPEN, Mode::EXCLUSIVE] {
            let rule = Table::built_in();
            assert_eq!(
                Capabilities::of_mode(&mode).unwrap(),
                rule.chosen(&mode).unwrap().capabilities(&Sharing::default()),
                "{mode}"
            );
        }
    }

    /// Only one holder at a time can share a key with nobody: see `records::last`.
    #[test]
    fn sequences_count_by_epoch_only_where_the_newest_epoch_alone_may_publish() {
        for rule in Table::built_in().0 {
            let Capabilities { fencing, sequence, .. } = rule.capabilities(&Sharing::default());
            assert!(sequence != Sequence::PerEpoch || fencing == Fencing::Newest, "{}", rule.mode());
        }
    }

    #[test]
    fn a_rule_reads_keys_that_exist_and_requires_those_that_it_reads() {
        for rule in Table::built_in().0 {
            assert!(rule.keys().iter().all(|key| Sharing::keys().any(|known| known == *key)), "{}", rule.mode());
            assert!(rule.required().iter().all(|key| rule.keys().contains(key)), "{}", rule.mode());
        }
    }
}
