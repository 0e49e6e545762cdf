//! The arguments of the calls that proposals name.

use super::nodes::NodeRole;
use ledger_base::hash::Hash;
use serde::{Deserialize, Serialize};

/// Argument of `activate_rules`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActivateRules {
    /// Number of the rules.
    pub number: u32,
    /// They hold from this block on at the earliest; the next one if it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u64>,
}

/// Argument of `invite_organisation`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InviteOrganisation {
    /// Its name.
    pub name: String,
    /// The public half of an Ed25519 key, 64 hex digits.
    pub key: Hash,
    /// Last block time at which it can be answered, microseconds.
    pub expires: u64,
}

/// Argument of `remove_organisation`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoveOrganisation {
    /// Its name.
    pub name: String,
}

/// Argument of `set_node_role`: the node by id, or by organisation and name. A proposal names all three.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetNodeRole {
    /// Its number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// Its organisation, together with `name`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub organisation: Option<String>,
    /// Its name, together with `organisation`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its wanted role.
    pub role: NodeRole,
    /// The proof that the node has lied, in hexadecimal ([`Misbehaviour`](ledger_light::Misbehaviour)): its organisation need
    /// not approve that it votes no more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proof: Option<String>,
}
