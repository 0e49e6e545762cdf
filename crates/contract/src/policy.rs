//! Policies: how they are listed and changed, the numbered sets that they form, and proposals of sets.

use crate::grant::Released;
use serde::{Deserialize, Serialize};

/// A policy, as `policies` lists it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyEntry {
    /// The organisation about whose robots it decides; empty for the built-in one, which decides about the robots
    /// of every organisation that has no policy of its own.
    pub organisation: String,
    /// Its id within the organisation.
    pub id: String,
    /// Cedar.
    pub text: String,
}

/// Answer of `policy` for whatever changes the policies in force, and payload of the event `policy`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyChange {
    /// The organisation whose policies changed.
    pub organisation: String,
    /// The policy that changed; empty if the whole set was replaced.
    pub id: String,
    /// `put`, `removed`, or of a whole set `applied` or `restored`.
    pub change: String,
    /// Is the built-in policy in force now, because the organisation has none of its own?
    pub default_in_force: bool,
    /// The grants that the change ended. If they are very many, the rest ends with the next blocks.
    pub ended: Vec<Released>,
    /// The number of the set that is in force now; 0 from nodes that do not number sets.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub version: u64,
    /// The author of the change.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
    /// Their words about it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub message: String,
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

/// A policy that is not on the ledger yet, or a copy of one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyText {
    /// Its name.
    pub id: String,
    /// Cedar.
    pub text: String,
}

/// Argument of `policy apply` and `policy propose`: a set that is to take the place of the one in force.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyDraft {
    /// Its policies; none of them stands for the built-in one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<Vec<PolicyText>>,
    /// Or the number of an earlier set, whose policies and rule come back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restores: Option<u64>,
    /// Why, in the author's words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub message: String,
    /// The number of the set that it was made from; if another one is in force, nothing is changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<u64>,
    /// The rule of the organisation from then on: a quorum such as `admins = 2`, or `none`. Without, it stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approvals: Option<String>,
    /// Is it meant, even if nobody may publish to some robot then?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub means_it: bool,
}

/// A policy of a numbered set.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct PolicyDigest {
    /// Its id within the organisation.
    pub id: String,
    /// SHA-256 of its text, in hexadecimal digits.
    pub sha256: String,
    /// Length of its text.
    pub bytes: u64,
}

/// A set of policies that is, or was, in force: an element of `policy_history`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicySet {
    /// The organisation about whose robots it decides.
    pub organisation: String,
    /// Its number: 1 is the first set of the organisation, and each change makes the next one.
    pub version: u64,
    /// SHA-256 over its policies, in hexadecimal digits.
    pub hash: String,
    /// The author; empty for a set from before sets were numbered.
    pub by: String,
    /// Their words about it.
    pub message: String,
    /// Since when it is in force (block time, microseconds).
    pub time: u64,
    /// Height of the block that put it in force.
    pub height: u64,
    /// The admins that approved it, the author among them, if it was proposed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub approved_by: Vec<String>,
    /// Was it put in force without the approvals that the organisation asks for?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub break_glass: bool,
    /// The set whose policies came back with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restores: Option<u64>,
    /// The rule of the organisation while it is in force: how many must agree to another set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approvals: Option<String>,
    /// Its policies in order of their ids; none if the built-in one decides.
    pub policies: Vec<PolicyDigest>,
}

/// Answer of `policy_set`: a set with its texts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicySetTexts {
    /// The set.
    pub set: PolicySet,
    /// Its policies in order of their ids.
    pub policies: Vec<PolicyText>,
}

/// A set that waits for approvals, or to be applied.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyProposal {
    /// Names it, and its content.
    pub id: String,
    /// The organisation whose policies they are to be.
    pub organisation: String,
    /// The number of the set that it replaces. If another one is in force, it can only be withdrawn.
    pub base: u64,
    /// The admin who proposed it.
    pub by: String,
    /// Their words about it.
    pub message: String,
    /// When (block time, microseconds).
    pub created: u64,
    /// Height of the block.
    pub height: u64,
    /// The set whose policies come back with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restores: Option<u64>,
    /// The rule of the organisation that comes with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub approvals: Option<String>,
    /// Is it meant, even if nobody may publish to some robot then?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub means_it: bool,
    /// SHA-256 over its policies, in hexadecimal digits.
    pub hash: String,
    /// Its policies in order of their ids.
    pub policies: Vec<PolicyDigest>,
    /// The approvals that count.
    pub approved: Vec<PolicyApproval>,
    /// The rules that decide whether it can be applied.
    pub needs: Vec<PolicyNeed>,
    /// From when on an admin of the organisation can apply it without the organisation's own rule (block time,
    /// microseconds).
    pub break_glass_from: u64,
}

/// An approval of a proposed set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyApproval {
    /// The admin.
    pub who: String,
    /// Until when it counts (block time, microseconds).
    pub until: u64,
}

/// A rule that says how many must agree, and how many are missing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyNeed {
    /// `network`, or the name of the organisation.
    pub of: String,
    /// The rule, e.g. `admins = 2`.
    pub quorum: String,
    /// How many approvals are missing.
    pub missing: u64,
}

/// Answer of `policy_proposal`: a proposal with its texts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyProposalTexts {
    /// The proposal.
    pub proposal: PolicyProposal,
    /// Its policies in order of their ids.
    pub policies: Vec<PolicyText>,
}

/// Answer of `policy_approvals`: who must agree to a set of an organisation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyApprovals {
    /// The organisation.
    pub organisation: String,
    /// The rule of the network for all organisations, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// The rule of the organisation itself, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own: Option<String>,
}
