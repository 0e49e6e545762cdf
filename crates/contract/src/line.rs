//! The line of a service: what a contender asks for, how it is answered, and what is told about who waits.

use crate::grant::Grant;
use crate::word::{Told, words};
use serde::{Deserialize, Serialize};

/// Options of `acquire`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AcquireOptions {
    /// The lease (milliseconds); by default that of the service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease_ms: Option<u64>,
    /// How long (milliseconds) to wait in line at most; 0 to be refused instead. As long as the service allows by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wait_ms: Option<u64>,
    /// The priority, if it is to be lower than the one that the caller has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<i64>,
}

/// Answer of `acquire`. A grant is told as it always was.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Acquired {
    /// The caller waits in line.
    Queued {
        /// Where.
        queued: Place,
    },
    /// Others must confirm the caller first.
    Pending {
        /// How far that is.
        pending: Pending,
    },
    /// The caller holds the service.
    Granted(Box<Grant>),
}

/// A place in the line of a service; also the payload of the event `queued`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// The service, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The contender, e.g. `Org1/Salma`.
    pub contender: String,
    /// 1 is the next one.
    pub position: u64,
    /// The priority, without what waiting adds to it.
    pub priority: i64,
    /// Since when it waits (block time, microseconds).
    pub since: u64,
    /// When it drops out (block time, microseconds).
    pub until: u64,
    /// When its turn comes at the latest if leases are not renewed (block time, microseconds); absent if nothing is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<u64>,
    /// The task that waits there, if it is one; a contender may have several places then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<u64>,
}

/// A contender that waits to be confirmed; also the payload of the events `pending` and `confirmed`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pending {
    /// The service.
    pub service: String,
    /// The contender, e.g. `Org1/Salma`.
    pub contender: String,
    /// Those who have confirmed it.
    pub confirmed: Vec<String>,
    /// How many must.
    pub wanted: u64,
    /// The organisation whose policies say who may: its admins, and whom they permit `confirm`.
    pub owner: String,
    /// Until when confirmations are waited for, and count (block time, microseconds).
    pub until: u64,
}

words! {
    /// Why a contender is no longer in line.
    pub enum LeftReason {
        /// It left.
        Left = "left",
        /// It waited as long as it wanted, or as the service allows.
        TimedOut = "timed_out",
        /// Policies no longer permit what it waits for.
        Policy = "policy",
        /// Its certificate was revoked, or its organisation left.
        Revoked = "revoked",
        /// Its certificate has run out.
        Expired = "expired",
        /// An admin of the owner sent it away.
        Removed = "removed",
        /// The robot or the service was taken out of service.
        RobotRemoved = "robot_removed",
        /// Too few confirmed it in time.
        Unconfirmed = "unconfirmed",
        /// The service has no line any more, or a shorter one.
        Rule = "rule",
    }
}

/// Payload of the event `left`: a contender is no longer in line, and was not granted the service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Left {
    /// The service.
    pub service: String,
    /// The contender.
    pub contender: String,
    /// Why.
    pub reason: Told<LeftReason>,
}

/// Payload of the event `line`: the line of a service has changed, and with it positions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LineTold {
    /// The service.
    pub service: String,
    /// How many wait.
    pub waiting: u64,
    /// The next ones, at most 16.
    pub next: Vec<String>,
}

/// Answer of `line`: who holds a service, and who waits for it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LineState {
    /// The service.
    pub service: String,
    /// Those who hold it, oldest grant first.
    pub holders: Vec<Grant>,
    /// Those who wait, the next one first.
    pub line: Vec<Place>,
    /// Those who wait to be confirmed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pending: Vec<Pending>,
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_grant_is_answered_as_it_always_was() {
        let grant = r#"{"service":"Husky/cmd_vel","holder":"Org1/Salma","epoch":1,"expires":9,"mode":"exclusive","acquired_at":0,"lease_ms":1,"next_seq":0}"#;
        let answer: Acquired = serde_json::from_str(grant).unwrap();
        assert!(matches!(&answer, Acquired::Granted(grant) if grant.epoch == 1));
        assert_eq!(serde_json::to_string(&answer).unwrap(), grant);
        let place = r#"{"queued":{"service":"Husky/cmd_vel","contender":"Org1/Salma","position":1,"priority":0,"since":1,"until":2}}"#;
        let answer: Acquired = serde_json::from_str(place).unwrap();
        assert!(matches!(&answer, Acquired::Queued { queued } if queued.position == 1));
        assert_eq!(serde_json::to_string(&answer).unwrap(), place);
    }
}
