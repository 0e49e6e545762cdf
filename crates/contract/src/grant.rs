//! Grants: who holds a service until when, and how that ends.

use crate::limits::Limits;
use crate::sharing::Mode;
use crate::word::{Told, words};
use serde::{Deserialize, Serialize};

/// The right to use a service for a while.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grant {
    /// The service, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The holder, e.g. `Org1/Salma`.
    pub holder: String,
    /// The fencing token: grows by one with every grant of the service and never comes again.
    pub epoch: u64,
    /// When it ends unless renewed or used (block time, microseconds).
    pub expires: u64,
    /// How many may hold the service at once.
    pub mode: Mode,
    /// When it began (block time, microseconds).
    pub acquired_at: u64,
    /// By how much a renewal extends it, in milliseconds.
    pub lease_ms: u64,
    /// The smallest sequence number that `set` accepts from the holder; a restarted bridge goes on from here.
    pub next_seq: u64,
    /// Why it was taken whatever the rule says, if it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taken: Option<String>,
    /// The limits that policies bind its use to.
    #[serde(default, skip_serializing_if = "Limits::is_none")]
    pub limits: Limits,
    /// Those who passed it on, the first one first, if it was delegated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub givers: Vec<String>,
    /// May its holder pass it on, though it was delegated itself?
    #[serde(default, skip_serializing_if = "is_false")]
    pub may_delegate: bool,
    /// The epoch that it follows without a stop between, if it was passed on or taken back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follows: Option<u64>,
    /// The task that it serves, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<u64>,
    /// The number of the owner's set of policies under which it was given or renewed; 0 if the owner has never had any.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub policy_version: u64,
    /// The policies that permitted it then, by their ids in order, at most [`POLICIES_TOLD_MAX`]. None if an admin took it whatever
    /// policies say, or under rules that do not tell them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub policies: Vec<String>,
}

/// Most policies that a grant names.
pub const POLICIES_TOLD_MAX: usize = 8;

fn is_zero(number: &u64) -> bool {
    *number == 0
}

fn is_false(value: &bool) -> bool {
    !value
}

words! {
    /// Why a grant ended.
    pub enum Reason {
        /// Its holder gave it back.
        Released = "released",
        /// Its lease ran out.
        Expired = "expired",
        /// Its holder's certificate was revoked.
        Revoked = "revoked",
        /// The owner took the service back, or its mode no longer admits this holder.
        Taken = "taken",
        /// The robot or the service was taken out of service.
        RobotRemoved = "robot_removed",
        /// The owner's policies or the robot's requirements no longer permit it.
        Policy = "policy",
        /// Another contender with a higher priority took its place.
        Preempted = "preempted",
        /// Its holder published nothing for as long as the service allows.
        Idle = "idle",
        /// The robot was stopped.
        Stopped = "stopped",
        /// Somebody who may override the rule took the service.
        Overridden = "overridden",
        /// Its holder passed it on for a while, or for good.
        Delegated = "delegated",
        /// One who had passed it on took it back.
        Recalled = "recalled",
        /// The task that it served has ended.
        TaskEnded = "task_ended",
    }
}

/// Payload of the event `released`: the robot's bridge publishes the stop message on every one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Released {
    /// The service.
    pub service: String,
    /// The former holder.
    pub holder: String,
    /// The epoch that ended.
    pub epoch: u64,
    /// Why.
    pub reason: Told<Reason>,
    /// The one who took its place, if somebody did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Does the next one hold the service in the same block, so that the robot need not stop between?
    #[serde(default, skip_serializing_if = "is_false")]
    pub goes_on: bool,
}
