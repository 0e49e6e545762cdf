//! Rules of execution: their numbers, and which of them a block is executed by.
//!
//! Executing a block is a function of the rules, the state and the block. Rules are everything in it that may differ
//! between releases: execution itself, the functions of chaincodes, the default policy, the schema of policies, limits. A
//! number never changes its meaning once it is in a release; 3 is in none yet. A network is founded with a number; its
//! organisations may activate a newer one at a height (`msp activate_rules`). Older blocks keep their number for ever.
//!
//! | number | what is new |
//! |---|---|
//! | 1 | nothing; its code was given up before the first release |
//! | 2 | transactions with fields that a transaction does not have are refused; `abac setup` refuses a robot that exists |
//! | 3 | every call has a budget, and one that only reads is a query; a proposal is a call of any function that needs approval, its quorum is data; a chaincode never refuses with a code of a node's own trouble; no admin revokes the certificate that it signs with; new names are readable, and look like no other one; addresses of nodes are names or dialled ones; the network decides how many nodes an organisation has; organisations have quotas, and policies more bounds; what two organisations attest stays until they attest something newer; voters certify what executing a block gave, its events included; revocation lists count, rights end with the authority that vouched for them, organisations come in with words of their own for roles, and P-384 signs; admins name registrars, and other attributes revoke the certificates before; a long transaction may be signed by its id |
//!
//! ```
//! use ledger::Rules;
//!
//! assert_eq!(Rules::find(2), Some(Rules::FIRST));
//! assert_eq!(Rules::find(1), None);
//! ```

use serde::{Deserialize, Serialize};
use std::fmt;

/// Rules of execution that this release speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rules(u32);

impl Rules {
    /// The oldest that this release speaks.
    pub const FIRST: Self = Self(2);
    /// The newest that this release speaks. New networks are founded with them.
    pub const NEWEST: Self = Self(3);

    /// The rules of a number, if this release speaks them.
    pub const fn find(number: u32) -> Option<Self> {
        if number >= Self::FIRST.0 && number <= Self::NEWEST.0 { Some(Self(number)) } else { None }
    }

    /// All that this release speaks, in ascending order.
    pub fn all() -> impl Iterator<Item = Self> {
        (Self::FIRST.0..=Self::NEWEST.0).map(Self)
    }

    /// Their number, as the genesis and the ledger name them.
    pub const fn number(self) -> u32 {
        self.0
    }

    /// Has every call a budget, and is a call that only reads a query and no transaction?
    pub(crate) const fn has_budgets(self) -> bool {
        self.0 >= 3
    }

    /// Is a proposal any call that needs approval, by a quorum that stands on the ledger? Before, it is one of four
    /// actions, and more than half of the organisations must agree.
    pub(crate) const fn proposes_calls(self) -> bool {
        self.0 >= 3
    }

    /// Does a refusal by a chaincode always speak of the call? Before, it could have a code of a node's own trouble, with
    /// which clients try again.
    pub(crate) const fn refuses_calls_only(self) -> bool {
        self.0 >= 3
    }

    /// May an admin revoke the certificate that it signs with? Before, the last one could, and locked its organisation out.
    pub(crate) const fn admins_revoke_themselves(self) -> bool {
        self.0 < 3
    }

    /// Do hooks leave room for the events of their caller, and lose those beyond it? Before, the caller was refused.
    pub(crate) const fn hooks_leave_room(self) -> bool {
        self.0 >= 3
    }

    /// Must new names be such that people can tell them apart?
    pub(crate) const fn names_are_readable(self) -> bool {
        self.0 >= 3
    }

    /// Must the address of a node be a name, or one that nodes dial? Before, it only had to look like `HOST:PORT`.
    pub(crate) const fn addresses_are_checked(self) -> bool {
        self.0 >= 3
    }

    /// Does the network decide how many nodes an organisation has? Before, it was half of all that there may be.
    pub(crate) const fn nodes_are_allowed(self) -> bool {
        self.0 >= 3
    }

    /// Is it limited how many new nodes an organisation brings in within a time?
    pub(crate) const fn joins_are_limited(self) -> bool {
        self.0 >= 3
    }

    /// Does the ledger remember the newest snapshot that two organisations attest, when nodes go on to newer ones?
    pub(crate) const fn keeps_shared_snapshots(self) -> bool {
        self.0 >= 3
    }

    /// May an admin let somebody else register members of a department?
    pub(crate) const fn has_registrars(self) -> bool {
        self.0 >= 3
    }

    /// Does a certificate with other attributes revoke those that a name had before?
    pub(crate) const fn attributes_replace(self) -> bool {
        self.0 >= 3
    }

    /// Do the rights of people end in the block in which their authority is lost?
    pub(crate) const fn ends_rights_of_lost_authorities(self) -> bool {
        self.0 >= 3
    }

    /// May somebody sign with a key of P-384?
    pub(crate) const fn accepts_p384(self) -> bool {
        self.0 >= 3
    }

    /// May a long transaction be signed by its id?
    pub const fn signs_ids(self) -> bool {
        self.0 >= 3
    }

    /// Does it stay on the ledger that members were changed by force, or a CA was copied?
    pub const fn notes_emergencies(self) -> bool {
        self.0 >= 3
    }

    /// Microseconds of block time in which at least the first block is certified; none before blocks are.
    pub(crate) const fn certifies_every(self) -> Option<u64> {
        if self.0 >= 3 { Some(200_000) } else { None }
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
        for number in [0, 1, Rules::NEWEST.number() + 1, u32::MAX] {
            assert_eq!(Rules::find(number), None, "{number}");
        }
    }
}
