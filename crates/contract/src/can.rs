//! May somebody do something, and why: the question `can`, and its answer.

use crate::limits::Limits;
use crate::policy::PolicyText;
use serde::{Deserialize, Serialize};

/// The argument of `can` and `could`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ask {
    /// The person, `Org1/Farhad`; the caller without. `could` asks about everybody of the caller's organisation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// `acquire`, `publish`, `subscribe`, `override`, `confirm`; of a robot `stop` or `resume`.
    pub action: String,
    /// The service, or the robot.
    pub service: String,
    /// When (microseconds since the UNIX epoch); now without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<u64>,
    /// Policies to decide by instead of those in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<Vec<PolicyText>>,
}

/// The answer of `can`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Can {
    /// The person.
    pub who: String,
    /// The action.
    pub action: String,
    /// The service, or the robot.
    pub service: String,
    /// May they?
    pub allowed: bool,
    /// The stable code of the refusal, e.g. `LGR-3001`; `LGR-0000` if allowed.
    pub code: String,
    /// Its name, e.g. `MISSING_ATTRIBUTE`.
    pub name: String,
    /// The refusal in words; empty if allowed, as the next three are.
    pub reason: String,
    /// The facts that were found.
    pub found: String,
    /// The facts that are wanted.
    pub wanted: String,
    /// A next step for the caller.
    pub next: String,
    /// The policies that decided; none if none permits it, or if it is permitted by rule.
    pub policies: Vec<String>,
    /// The reason why it is permitted without a policy: `an admin of the owner`, `the robot itself`; empty if policies decided.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub rule: String,
    /// For a denial, what the nearest policies miss, or what makes policies forbid it.
    pub conditions: Vec<Condition>,
    /// The number of the set in force that was asked; 0 for policies of the question, and for an owner who has never had any.
    #[serde(default)]
    pub policy_version: u64,
}

/// A condition of a policy, with the values that decided it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Condition {
    /// The policy.
    pub policy: String,
    /// The condition, in Cedar.
    pub condition: String,
    /// The values found.
    pub found: String,
    /// The values with which it would hold.
    pub wanted: String,
}

/// An element of the answer of `could`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Could {
    /// The person.
    pub who: String,
    /// May they?
    pub allowed: bool,
    /// The policies that decided, as in [`Can::policies`].
    pub policies: Vec<String>,
}

/// A fault of a policy, as `check` tells it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyFault {
    /// The fault.
    pub message: String,
    /// How to correct it, if Cedar has an idea.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub help: String,
    /// The line, from 1 on; 0 if the fault has no place, as the three fields behind it.
    pub line: u64,
    /// The character in the line, from 1 on.
    pub column: u64,
    /// How many characters are meant.
    pub length: u64,
    /// The text of the line.
    pub text: String,
}

/// The answer of `check`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyCheck {
    /// The faults of the text; none if it is acceptable.
    pub faults: Vec<PolicyFault>,
    /// The meaning of each policy, in the order of the text; none if there are faults.
    pub policies: Vec<PolicyMeaning>,
    /// The names in it that the network does not know today; none if there are faults.
    pub unknown: Vec<UnknownName>,
}

/// A name in a policy that the network does not know today. It may come later.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnknownName {
    /// The line at which its policy begins, from 1 on.
    pub line: u64,
    /// `User`, `Organisation`, `Robot` or `Service`.
    pub kind: String,
    /// The name: `Org1/Farhad`.
    pub name: String,
    /// The name that was probably meant, in words; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub near: String,
}

/// The meaning of a policy in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyMeaning {
    /// The line at which it begins, from 1 on.
    pub line: u64,
    /// `permit` or `forbid`.
    pub effect: String,
    /// The people, the actions and the services: `any user of Org1 may acquire Husky/cmd_vel`.
    pub meaning: String,
    /// The conditions, each of which must hold.
    pub when: Vec<String>,
    /// The limits that go with a permission.
    pub limits: Vec<String>,
    /// The rights of their own that it does not give, or leaves to those who have them by rule.
    pub except: Vec<String>,
    /// It applies to nobody of today on the robots of the caller's organisation, as far as the ledger knows people.
    #[serde(default)]
    pub unmatched: bool,
}

/// The answer of `diff`: how a set of policies differs from the one in force.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyDiff {
    /// The organisation whose policies they are to be.
    pub organisation: String,
    /// Policies that it does not have yet.
    pub added: Vec<String>,
    /// Policies that have another text.
    pub changed: Vec<String>,
    /// Policies that it has and the set has not.
    pub removed: Vec<String>,
    /// How many grants of its robots were decided about.
    pub grants: u64,
    /// Those of them that the set would end. Beyond 256 only their number is told.
    pub ends: Vec<WouldEnd>,
    /// How many it would end.
    pub ended: u64,
    /// Robots to which nobody whom the ledger knows could publish any more.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unreachable: Vec<String>,
    /// Rights that people have with the set, and do not have now.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gained: Vec<RightOf>,
    /// Rights that people have now, and do not have with the set.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lost: Vec<RightOf>,
    /// Rights that stay, with other limits.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub limited: Vec<LimitChange>,
    /// There are more people and services than it asks about: rights and limits of some are not compared.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub incomplete: bool,
}

/// A right of a person.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Right {
    /// The service; for stop and resume the robot.
    pub of: String,
    /// The action. `acquire` is the right to acquire and to publish.
    pub action: String,
    /// The policies that give it.
    pub policies: Vec<String>,
    /// The reason why they have it without a policy; empty if policies give it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub rule: String,
    /// The limits that go with it.
    #[serde(default, skip_serializing_if = "Limits::is_none")]
    pub limits: Limits,
    /// The windows of time outside of which it is not theirs, if all of them are closed now.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub closed: Vec<String>,
}

/// A right, and who has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RightOf {
    /// The person.
    pub who: String,
    /// The right.
    #[serde(flatten)]
    pub right: Right,
}

/// A right that comes with other limits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LimitChange {
    /// The person.
    pub who: String,
    /// The service.
    pub of: String,
    /// The action.
    pub action: String,
    /// The limits now.
    pub before: Limits,
    /// The limits with the set.
    pub after: Limits,
}

/// A grant that a set of policies would end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WouldEnd {
    /// The service.
    pub service: String,
    /// Its holder.
    pub holder: String,
    /// Its epoch.
    pub epoch: u64,
    /// The refusal: of the holder, or of one who passed the grant on.
    pub reason: String,
    /// The facts that were found.
    pub found: String,
    /// The facts that are wanted.
    pub wanted: String,
}
