//! Rules of execution: their numbers, and which of them a block is executed by.
//!
//! Executing a block is a function of the rules, the state and the block. Rules are everything in it that may differ
//! between releases: execution itself, the functions of chaincodes, the default policy, the schema of policies, limits. A
//! number never changes its meaning once it is in a release. A network is founded with a number; its organisations may
//! activate the next one at a height (`msp activate_rules`). Older blocks keep their number permanently.
//!
//! There is one number so far, 1. A change of execution gets the next one, and asks [`Context::rules`] for it.
//!
//! ```
//! use ledger::Rules;
//!
//! assert_eq!(Rules::find(1), Some(Rules::FIRST));
//! assert_eq!(Rules::find(2), None);
//! ```
//!
//! [`Context::rules`]: crate::Context::rules

use serde::{Deserialize, Serialize};
use std::fmt;

/// Rules of execution that this release speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rules(u32);

impl Rules {
    /// The oldest that this release speaks.
    pub const FIRST: Self = Self(1);
    /// The newest that this release speaks. New networks are founded with them.
    pub const NEWEST: Self = Self(1);

    /// The number after [`Rules::NEWEST`], which no release speaks: a test has a network activate it
    /// ([`Registry::speak_up_to`](crate::Registry::speak_up_to)). No product may name it; a test of the repository checks that.
    #[doc(hidden)]
    pub const OF_TESTS: Self = Self(Self::NEWEST.0 + 1);

    /// The rules of a number, if this release speaks them.
    pub const fn find(number: u32) -> Option<Self> {
        Self::NEWEST.find_up_to(number)
    }

    /// The rules of a number, if they are these or older.
    pub(crate) const fn find_up_to(self, number: u32) -> Option<Self> {
        if number >= Self::FIRST.0 && number <= self.0 { Some(Self(number)) } else { None }
    }

    /// All that this release speaks, in ascending order.
    pub fn all() -> impl Iterator<Item = Self> {
        (Self::FIRST.0..=Self::NEWEST.0).map(Self)
    }

    /// Their number, as the genesis and the ledger name them.
    pub const fn number(self) -> u32 {
        self.0
    }

    /// These and all older ones that this release speaks, in words.
    pub fn and_older(self) -> String {
        match (Self::FIRST.0, self.0) {
            (first, newest) if first == newest => format!("rules {first}"),
            (first, newest) => format!("rules {first} to {newest}"),
        }
    }
}

impl fmt::Display for Rules {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// From which block on a network has newer rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Activation {
    /// Number of the rules.
    pub number: u32,
    /// The first block that is executed by them.
    pub height: u64,
}

/// Which rules a network has at which height.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Schedule {
    founded: u32,
    activations: Vec<Activation>,
}

impl Schedule {
    /// The number in the genesis, and what was activated since, in order of heights.
    pub(crate) fn new(founded: u32, activations: Vec<Activation>) -> Self {
        Self { founded, activations }
    }

    /// The number of the rules by which the block at that height is executed. This release may not speak them.
    pub(crate) fn number_at(&self, height: u64) -> u32 {
        let reached = self.activations.iter().rfind(|activation| activation.height <= height);
        reached.map_or(self.founded, |activation| activation.number)
    }

    /// The rules to be activated after that height.
    pub(crate) fn after(&self, height: u64) -> Option<Activation> {
        self.activations.iter().find(|activation| activation.height > height).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_has_the_newest_rules_that_were_activated_up_to_its_height() {
        let [three, five] = [Activation { number: 3, height: 10 }, Activation { number: 5, height: 20 }];
        let schedule = Schedule::new(2, vec![three, five]);
        for (height, number) in [(0, 2), (9, 2), (10, 3), (19, 3), (20, 5), (1000, 5)] {
            assert_eq!(schedule.number_at(height), number, "{height}");
        }
        assert_eq!([9, 10, 19, 20].map(|height| schedule.after(height)), [Some(three), Some(five), Some(five), None]);
    }

    #[test]
    fn rules_are_found_by_the_numbers_that_this_release_speaks_and_no_other() {
        for rules in Rules::all() {
            assert_eq!(Rules::find(rules.number()), Some(rules));
        }
        assert_eq!(Rules::OF_TESTS.find_up_to(Rules::OF_TESTS.number()), Some(Rules::OF_TESTS));
        for number in [0, Rules::NEWEST.number() + 1, u32::MAX] {
            assert_eq!(Rules::find(number), None, "{number}");
        }
    }
}
