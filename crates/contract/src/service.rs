//! Services: the right to publish or subscribe on one topic of a robot.

use crate::attribute::{Attributes, named};
use crate::capability::{Capabilities, ToldCapabilities, UnknownRule};
use crate::sharing::{Mode, Sharing};
use crate::side_door::SideDoor;
use crate::word::{Told, words};
use serde::{Deserialize, Serialize};

words! {
    /// Which way messages go.
    #[derive(Default)]
    pub enum Direction {
        /// Users publish, the robot subscribes, e.g. `/cmd_vel`.
        #[default]
        Command = "command",
        /// The robot publishes, users subscribe, e.g. the poses of a motion capture system.
        Feed = "feed",
    }
}

/// A service as its owner describes it in `setup`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServiceSpec {
    /// The ROS 2 topic with its leading slash.
    pub topic: String,
    /// The ROS 2 type, e.g. `geometry_msgs/msg/Twist`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// How many may use it at once; by default `exclusive` for commands and `open` for feeds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<Mode>,
    /// Which way messages go.
    #[serde(default)]
    pub direction: Direction,
    /// Age (milliseconds) beyond which the robot drops a message; 1000 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_age_ms: Option<u64>,
    /// Lease (milliseconds) of a grant that asks for none; 10000 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease_ms: Option<u64>,
    /// Longest lease (milliseconds) that may be asked for; ten minutes, or `lease_ms` if that is longer.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "lease_max")]
    pub lease_ms_max: Option<u64>,
    /// The message, CDR with its encapsulation header, in hexadecimal digits, that stops the robot; the bridge
    /// knows those of common types.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop_hex: Option<String>,
    /// The settings of its rule.
    #[serde(default, skip_serializing_if = "Sharing::is_default")]
    pub sharing: Sharing,
    /// Facts for policies besides those of the robot, which they take the place of; none by default.
    #[serde(default, deserialize_with = "named", skip_serializing_if = "Option::is_none")]
    pub attributes: Option<Attributes>,
}

/// The last part of the topic on which a robot replies to calls.
const REPLY: &str = "/_reply";

/// The id, or the topic, of the service on which the replies to the calls of another one are published:
/// `Turtlebot4/reset/_reply` for `Turtlebot4/reset`.
pub fn replies(service: &str) -> String {
    format!("{service}{REPLY}")
}

/// Is that a type of calls, to which the robot replies: a ROS 2 service or action?
///
/// ```
/// assert!(ledger_contract::is_called("std_srvs/srv/Trigger"));
/// assert!(ledger_contract::is_called("nav2_msgs/action/NavigateToPose"));
/// assert!(!ledger_contract::is_called("geometry_msgs/msg/Twist"));
/// ```
pub fn is_called(type_name: &str) -> bool {
    matches!(type_name.split('/').nth(1), Some("srv" | "action"))
}

impl ServiceSpec {
    /// The service for the replies, if users call this one. Everybody reads it whom policies permit.
    #[must_use]
    pub fn for_replies(&self) -> Option<Self> {
        let is_called = self.direction == Direction::Command && is_called(&self.type_name);
        is_called.then(|| Self {
            topic: replies(&self.topic),
            type_name: self.type_name.clone(),
            mode: None,
            direction: Direction::Feed,
            max_age_ms: self.max_age_ms,
            lease_ms: None,
            lease_ms_max: None,
            stop_hex: None,
            sharing: Sharing::default(),
            attributes: None,
        })
    }
}

/// A service and who holds it: the answer of `service`, and part of [`crate::RobotAsset`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServiceState {
    /// Its id, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The robot that offers it.
    pub robot: String,
    /// The organisation that owns the robot.
    pub organisation: String,
    /// The ROS 2 topic.
    pub topic: String,
    /// The ROS 2 type.
    #[serde(rename = "type")]
    pub type_name: String,
    /// How many may use it at once.
    pub mode: Mode,
    /// Which way messages go.
    pub direction: Told<Direction>,
    /// Age (milliseconds) beyond which the robot drops a message.
    pub max_age_ms: u64,
    /// Lease (milliseconds) of a grant that asks for none.
    pub lease_ms: u64,
    /// Longest lease (milliseconds) that may be asked for.
    pub lease_ms_max: u64,
    /// The message that stops the robot, if the owner gave one.
    pub stop_hex: Option<String>,
    /// The settings of its rule.
    #[serde(default, skip_serializing_if = "Sharing::is_default")]
    pub sharing: Sharing,
    /// Facts for policies besides those of the robot.
    #[serde(default, skip_serializing_if = "Attributes::is_empty")]
    pub attributes: Attributes,
    /// The oldest holder, e.g. `Org1/Salma`; empty if there is none.
    pub holder: String,
    /// All holders, oldest grant first.
    pub holders: Vec<String>,
    /// The newest epoch ever given; 0 before the first grant.
    pub epoch: u64,
    /// When the grant of `holder` expires (block time, microseconds); 0 if there is none.
    pub expires: u64,
    /// How many wait for it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub waiting: u64,
    /// All that hold a place of a subscriber, if their number is limited.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub readers: Vec<String>,
    /// The last report that somebody publishes on the robot's own topic, around the ledger.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub side_door: Option<SideDoor>,
    /// The consequences of its rule; [`ServiceState::capabilities`] reads them.
    pub capabilities: ToldCapabilities,
}

impl ServiceState {
    /// The consequences of the service's rule.
    ///
    /// # Errors
    /// The part of the rule that this program does not know: it can show the service, and must not drive it.
    pub fn capabilities(&self) -> Result<Capabilities, UnknownRule> {
        self.capabilities.read()
    }
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}
