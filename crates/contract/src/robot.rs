//! Robots: how their owner describes them, and how everybody sees them.

use crate::attribute::{Attributes, named};
use crate::emergency::Stopped;
use crate::grant::Grant;
use crate::service::{ServiceSpec, ServiceState};
use crate::task::RunningTask;
use serde::{Deserialize, Serialize};

/// A robot as its owner describes it in `setup`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSpec {
    /// Letters, digits, `_`, `-` and `.`.
    pub name: String,
    /// The attribute a user's certificate must carry: `KEY=VALUE`, or `KEY` for `KEY=true`.
    pub attribute_required: String,
    /// Organisations whose attributes count. By default the owner alone, so that no other organisation grants itself access.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trusted: Option<Vec<String>>,
    /// Its services.
    pub services: Vec<ServiceSpec>,
    /// Facts for policies; none by default.
    #[serde(default, deserialize_with = "named", skip_serializing_if = "Option::is_none")]
    pub attributes: Option<Attributes>,
    /// The version of the robot that this was made from, empty if it is new; if another one is registered, nothing is changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<String>,
}

/// The asset of the paper, with its field names, and what we know beyond it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotAsset {
    /// The robot's name.
    #[serde(rename = "Name")]
    pub name: String,
    /// The topics it subscribes to (command services), separated by commas.
    #[serde(rename = "SubTopic")]
    pub sub_topic: String,
    /// The topics it publishes (feeds), separated by commas.
    #[serde(rename = "PubTopic")]
    pub pub_topic: String,
    /// Its operator, e.g. `Org1/Salma`: the oldest holder of a command service; empty if there is none.
    #[serde(rename = "owner")]
    pub operator: String,
    /// Is it under operation?
    #[serde(rename = "UnderOp")]
    pub under_operation: bool,
    /// The organisation that owns it.
    pub organisation: String,
    /// The attribute a user's certificate must carry, `KEY=VALUE`.
    pub attribute_required: String,
    /// Organisations whose attributes count.
    pub trusted: Vec<String>,
    /// Its services and their holders.
    pub services: Vec<ServiceState>,
    /// Facts for policies.
    #[serde(default, skip_serializing_if = "Attributes::is_empty")]
    pub attributes: Attributes,
    /// The stop that holds, if the robot is stopped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped: Option<Stopped>,
    /// Names its settings, in hexadecimal digits: with other settings it has another version.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub version: String,
}

/// Answer of `declare`: all that a robot's gate needs to know, at one height.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Declaration {
    /// The robot with its services.
    pub robot: RobotAsset,
    /// The live grants of its services.
    pub grants: Vec<Grant>,
    /// The tasks that these grants serve.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tasks: Vec<RunningTask>,
    /// Those of the named stops that keep the robot stopped no longer by themselves: they have a verdict, a `resume` has cancelled
    /// them, or block time has passed their `not_after`. Ids in hexadecimal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub settled: Vec<String>,
}

/// Payload of the event `robot`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotEvent {
    /// The robot's name.
    pub robot: String,
    /// The organisation that owns it.
    pub organisation: String,
    /// `registered`, `updated` or `removed`.
    pub change: String,
}
