//! The defaults where an organisation has said nothing: the default policy, and the schema of all policies.
//!
//! Both texts belong to the [rules](ledger::Rules) of execution: a change of one needs the next number.

use ledger_base::hash::Hash;
use std::sync::LazyLock;

/// The rule of the paper: the policy in force for an organisation that has none of its own.
pub const DEFAULT_POLICY: &str = include_str!("../default.cedar");

/// The Cedar schema that every policy is checked against.
pub const SCHEMA: &str = include_str!("../schema.cedarschema");

/// Names the default policy among the sets of policies.
pub(super) static DEFAULT_VERSION: LazyLock<Hash> =
    LazyLock::new(|| Hash::of(&[b"default policy\0", DEFAULT_POLICY.as_bytes()]));
