//! Several robots and the policies of their owner, changed in one step.

use crate::can::PolicyDiff;
use crate::grant::Released;
use crate::policy::{PolicyChange, PolicyDraft};
use crate::robot::RobotSpec;
use crate::settings::RobotChange;
use serde::{Deserialize, Serialize};

/// Argument of `reconcile`: all of it comes in force, or nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetPlan {
    /// Robots that are new, or take the place of what they were.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<RobotSpec>,
    /// Robots that are taken out of service.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub removed: Vec<RemovedRobot>,
    /// The next set of policies; none leaves them as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<PolicyDraft>,
}

/// A robot that is taken out of service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemovedRobot {
    /// Its name.
    pub name: String,
    /// Its version; if another one is registered, nothing is changed.
    pub base: String,
}

/// Answer of `reconcile`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FleetChange {
    /// The changes of robots, in the order of the plan.
    pub robots: Vec<RobotChange>,
    /// The grants that ended with robots that are out of service.
    pub removed: Vec<Released>,
    /// The change of policies, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<PolicyChange>,
    /// The rights that people gain, lose or keep with other limits; only in the answer to a question.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diff: Option<PolicyDiff>,
}
