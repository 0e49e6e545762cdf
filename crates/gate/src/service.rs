//! The ledger's answers and events, as far as a robot reads them: the parts of their JSON that it uses.

use crate::speed::Speeds;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Capabilities, Direction, Publishing, ServiceState};
use serde::{Deserialize, de::DeserializeOwned};

/// Longest payload of an event that is read, in bytes.
const EVENT_BYTES_MAX: usize = 64 * 1024;

/// A service, as `abac service` describes it, if this version knows all that it must respect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Service {
    /// Its id, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The robot that offers it.
    pub robot: String,
    /// The organisation that owns the robot.
    pub organisation: String,
    /// The ROS 2 topic.
    pub topic: String,
    /// The ROS 2 type.
    pub type_name: String,
    /// The consequences of its rule.
    pub capabilities: Capabilities,
    /// Which way messages go.
    pub direction: Direction,
    /// Age (milliseconds) beyond which the robot drops a message.
    pub max_age_ms: u64,
    /// Lease (milliseconds) of a grant that asks for none.
    pub lease_ms: u64,
    /// The message that stops the robot, if the owner gave one.
    pub stop_hex: Option<String>,
    /// The newest epoch ever given.
    pub epoch: u64,
    /// Are its messages encrypted for those who may read them?
    pub confidential: bool,
    /// The largest speeds of the robot itself, which no policy raises.
    pub speeds: Speeds,
}

/// Payload of the event `released`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Released {
    /// The service.
    pub service: String,
    /// The former holder.
    pub holder: String,
    /// The epoch that ended.
    pub epoch: u64,
    /// Why.
    pub reason: String,
    /// Does the next one hold the service in the same block, so that the robot need not stop between?
    #[serde(default)]
    pub goes_on: bool,
}

/// A revoked certificate, as `msp revocations` and the event `revoked` tell it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Revoked {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal.
    pub serial: String,
}

/// The certificates that a revocation list of an authority has revoked, as the event `revocation_list` tells them.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Listed {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial numbers in hexadecimal.
    pub serials: Vec<String>,
}

impl Listed {
    /// Each of them.
    pub fn each(self) -> impl Iterator<Item = Revoked> {
        let Self { issuer, serials } = self;
        serials.into_iter().map(move |serial| Revoked { issuer, serial })
    }
}

impl Revoked {
    /// The key of the certificate, as [`Identity::revocation_key`](ledger_identity::Identity::revocation_key) has it; none if the
    /// serial number is none.
    pub fn key(&self) -> Option<Vec<u8>> {
        let serial = hex::decode(&self.serial).ok()?;
        Some([&self.issuer.0[..], &serial].concat())
    }
}

impl Service {
    /// Does publishing need a grant?
    pub fn needs_grant(&self) -> bool {
        self.capabilities.publishing != Publishing::Policy
    }

    /// Do users publish and the robot listens?
    pub fn is_command(&self) -> bool {
        self.direction != Direction::Feed
    }
}

impl TryFrom<ServiceState> for Service {
    type Error = Rejection;

    /// # Errors
    /// [`Code::UnknownMode`] if the service has a rule or a direction that came after this version: to drive a robot by what
    /// is known of it would be a guess.
    fn try_from(state: ServiceState) -> Result<Self, Rejection> {
        let capabilities = state.capabilities().map_err(|unknown| not_known(&state, unknown.to_string()))?;
        let direction = state.direction.known();
        let direction =
            direction.ok_or_else(|| not_known(&state, format!("direction {:?}", state.direction.word())))?;
        let ServiceState { service, robot, organisation, topic, type_name, .. } = state;
        let ServiceState { max_age_ms, lease_ms, stop_hex, epoch, sharing, .. } = state;
        Ok(Self {
            service,
            robot,
            organisation,
            topic,
            type_name,
            capabilities,
            direction,
            max_age_ms,
            lease_ms,
            stop_hex,
            epoch,
            confidential: sharing.is_confidential(),
            speeds: Speeds { linear_mm_s: sharing.max_linear_mm_s, angular_mrad_s: sharing.max_angular_mrad_s },
        })
    }
}

fn not_known(state: &ServiceState, found: String) -> Rejection {
    let (service, mode) = (&state.service, &state.mode);
    Rejection::new(Code::UnknownMode, format!("{service} is in mode {mode}, which this bridge does not support"))
        .found(found)
        .wanted("a mode that this version supports")
}

/// Reads the payload of an event; none if it is not what this version knows.
pub fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    if payload.len() > EVENT_BYTES_MAX { None } else { serde_json::from_slice(payload).ok() }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn described(mode: &str, more: &str) -> Result<Service, Rejection> {
        let text = format!(
            r#"{{"service":"T/cmd_vel","robot":"T","organisation":"Org2","topic":"/cmd_vel","type":"a/msg/B",
                "mode":"{mode}","direction":"command","max_age_ms":1,"lease_ms":1,"lease_ms_max":1,"stop_hex":null,
                "holder":"","holders":[],"epoch":0,"expires":0{more}}}"#
        );
        Service::try_from(serde_json::from_str::<ServiceState>(&text).unwrap())
    }

    #[test]
    fn the_capabilities_say_whether_a_grant_is_needed() {
        let told = |publishing: &str| {
            format!(r#","capabilities":{{"fencing":"newest","publishing":"{publishing}","sequence":"per_epoch"}}"#)
        };
        for (publishing, needs_grant) in [("grant", true), ("policy", false)] {
            assert_eq!(described("exclusive", &told(publishing)).unwrap().needs_grant(), needs_grant);
        }
    }

    #[test]
    fn a_mode_of_a_newer_node_is_driven_by_capabilities_that_are_all_known_and_else_refused() {
        let told = r#","capabilities":{"fencing":"per_holder","publishing":"grant","sequence":"per_publisher"}"#;
        assert!(described("limited", told).unwrap().needs_grant());
        for (more, found) in [
            (r#","capabilities":{}"#.to_owned(), "no capability \"publishing\""),
            (told.replace("per_holder", "by_place"), "capability \"fencing\" with the value \"by_place\""),
            (told.replace("fencing", "clamp"), "capability \"clamp\" with the value \"per_holder\""),
        ] {
            let refused = described("limited", &more).unwrap_err();
            assert_eq!((refused.code, refused.found.as_str()), (Code::UnknownMode, found));
        }
        assert_eq!(described("open", &told.replace("fencing", "clamp")).unwrap_err().code, Code::UnknownMode);
    }
}
