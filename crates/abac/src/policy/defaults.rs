//! The defaults of the rules where an organisation has said nothing: the default policy, and the schema of all
//! policies.
//!
//! Both texts belong to a rules number. A change of one is a file of its own and a line of its own in [`TABLE`], from
//! the number on that brings it. The texts of released numbers stay, because their blocks are executed again.

use crate::records::sharing;
use ledger::Rules;
use ledger_base::hash::Hash;
use std::sync::LazyLock;

/// The rule of the paper: the default policy of the newest rules.
pub const DEFAULT_POLICY: &str = include_str!("../default-3.cedar");

/// The texts that hold from a rules number on.
pub(crate) struct Defaults {
    since: Rules,
    pub(crate) policy: &'static str,
    pub(crate) schema: &'static str,
    /// Names the default policy among the sets of policies.
    pub(crate) version: Hash,
}

impl Defaults {
    fn new(since: Rules, policy: &'static str, schema: &'static str) -> Self {
        Self { since, policy, schema, version: Hash::of(&[b"default policy\0", policy.as_bytes()]) }
    }

    /// Those that hold under these rules.
    pub(crate) fn of(rules: Rules) -> &'static Self {
        let [first, later @ ..] = &*TABLE;
        later.iter().rfind(|texts| texts.since <= rules).unwrap_or(first)
    }
}

/// The schemas of all rules.
pub(crate) fn schemas() -> impl Iterator<Item = &'static str> {
    TABLE.iter().map(|texts| texts.schema)
}

/// In ascending order of numbers.
static TABLE: LazyLock<[Defaults; 2]> = LazyLock::new(|| {
    [
        Defaults::new(Rules::FIRST, include_str!("../default.cedar"), include_str!("../schema.cedarschema")),
        Defaults::new(sharing::RULES, DEFAULT_POLICY, include_str!("../schema-3.cedarschema")),
    ]
});

/// The policy in force for an organisation that has put none of its own, under these rules.
pub fn default_policy(rules: Rules) -> &'static str {
    Defaults::of(rules).policy
}

/// The Cedar schema that every policy is checked against, under these rules.
pub fn schema(rules: Rules) -> &'static str {
    Defaults::of(rules).schema
}
