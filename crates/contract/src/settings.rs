//! Changing a robot: what is asked for, and what changed and ended.

use crate::attribute::{AttributeChanges, named};
use crate::grant::Released;
use crate::robot::RobotAsset;
use crate::service::Direction;
use crate::sharing::{Mode, Sharing};
use serde::{Deserialize, Serialize};

/// The settings that `configure` changes. Settings that are not named stay unchanged. The first two belong to the
/// robot, the others to a service.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSettings {
    /// The attribute a user's certificate must carry: `KEY=VALUE`, or `KEY` for `KEY=true`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attribute_required: Option<String>,
    /// Organisations whose attributes count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trusted: Option<Vec<String>>,
    /// The ROS 2 type.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub type_name: Option<String>,
    /// How many may use the service at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<Mode>,
    /// Which way messages go.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<Direction>,
    /// Age (milliseconds) beyond which the robot drops a message.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_age_ms: Option<u64>,
    /// Lease (milliseconds) of a grant that asks for none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease_ms: Option<u64>,
    /// Longest lease (milliseconds) that may be asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease_ms_max: Option<u64>,
    /// The message that stops the robot, in hexadecimal digits; empty = the bridge's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop_hex: Option<String>,
    /// Settings of the service's rule.
    #[serde(default, skip_serializing_if = "Sharing::is_default")]
    pub sharing: Sharing,
    /// Keys of [`Sharing`] that get their defaults again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clear: Vec<String>,
    /// Facts for policies: of the robot, or of the service if one is named.
    #[serde(default, deserialize_with = "named", skip_serializing_if = "Option::is_none")]
    pub attributes: Option<AttributeChanges>,
}

/// Answer of `configure` and, for each robot, of `replace`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotChange {
    /// The robot as it is now.
    pub robot: RobotAsset,
    /// Settings that have another value now; empty if the robot is as it was, or is new.
    pub changed: Vec<SettingChange>,
    /// Grants that ended by it.
    pub ended: Vec<Released>,
}

/// One setting that has another value now.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettingChange {
    /// The topic of the service; empty for a setting of the robot.
    pub topic: String,
    /// Its name as in [`RobotSettings`], `service` for a whole one, or `attribute NAME`.
    pub setting: String,
    /// The value before; empty if there was none.
    pub before: String,
    /// The value now; empty if there is none.
    pub after: String,
}
