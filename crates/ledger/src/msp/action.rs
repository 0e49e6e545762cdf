//! The content of a proposal: a call. Four calls have names of their own, from when there were no others.

use super::arguments::{ActivateRules, InviteOrganisation, RemoveOrganisation, SetNodeRole};
use super::nodes::NodeRole;
use super::store::json;
use super::{ACTIVATE_RULES, INVITE_ORGANISATION, NAME, REMOVE_ORGANISATION, SET_NODE_ROLE};
use crate::chaincode::Call;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use serde::{Deserialize, Serialize};

/// A call that needs approval, as a proposal names it. It never gets another variant: every new one is a
/// [`Action::Call`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case")]
pub enum Action {
    /// `msp set_node_role`: a node shall be something else.
    SetNodeRole {
        /// Its number.
        id: u64,
        /// Its organisation and name, for people.
        node: String,
        /// Its wanted role.
        role: NodeRole,
    },
    /// `msp invite_organisation`: an organisation may join.
    InviteOrganisation {
        /// Its name.
        name: String,
        /// The public half of the invitation's Ed25519 key.
        key: Hash,
        /// Until when, in block time (microseconds).
        expires: u64,
    },
    /// `msp remove_organisation`: an organisation leaves with everything it has.
    RemoveOrganisation {
        /// Its name.
        name: String,
    },
    /// `msp activate_rules`: blocks are executed by newer rules.
    ActivateRules {
        /// Number of the rules.
        number: u32,
        /// They hold from this block on at the earliest.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        height: Option<u64>,
    },
    /// Any other call, since rules 3.
    Call(Call),
}

impl Action {
    /// The call that is executed once enough have approved.
    pub(super) fn call(&self) -> Result<Call, Rejection> {
        let (function, argument) = match self {
            Self::SetNodeRole { id, role, .. } => {
                let set = SetNodeRole { id: Some(*id), organisation: None, name: None, role: *role };
                (SET_NODE_ROLE, json(&set)?)
            }
            Self::InviteOrganisation { name, key, expires } => {
                let invite = InviteOrganisation { name: name.clone(), key: *key, expires: *expires };
                (INVITE_ORGANISATION, json(&invite)?)
            }
            Self::RemoveOrganisation { name } => {
                (REMOVE_ORGANISATION, json(&RemoveOrganisation { name: name.clone() })?)
            }
            Self::ActivateRules { number, height } => {
                (ACTIVATE_RULES, json(&ActivateRules { number: *number, height: *height })?)
            }
            Self::Call(call) => return Ok(call.clone()),
        };
        Ok(Call { chaincode: NAME.to_owned(), function: function.to_owned(), args: vec![argument] })
    }
}
