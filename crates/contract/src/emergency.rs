//! Emergency: a robot that is stopped stays so until somebody who may resumes it.

use crate::grant::Released;
use serde::{Deserialize, Serialize};

/// A stop that lasts: part of [`crate::RobotAsset`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopped {
    /// The one who stopped the robot, e.g. `Org2/admin`.
    pub by: String,
    /// Why, in their words; may be empty.
    pub reason: String,
    /// Since when (block time, microseconds).
    pub since: u64,
}

/// Payload of the events `stopped` and `resumed`, whose subject is the robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Emergency {
    /// The robot.
    pub robot: String,
    /// The one who stopped or resumed it.
    pub by: String,
    /// Why, in their words; may be empty.
    pub reason: String,
}

/// Answer of `stop` and `resume`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmergencyAnswer {
    /// The robots that were stopped or resumed by it.
    pub robots: Vec<String>,
    /// Those that were so before.
    pub unchanged: Vec<String>,
    /// The grants that ended. If they are very many, the rest ends with the next blocks.
    pub ended: Vec<Released>,
}
