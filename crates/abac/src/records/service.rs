//! Services: the right to publish or subscribe on one topic of a robot.

use ledger_base::mutation::{Mutation, active};
use ledger_contract::{Attributes, Direction, Mode, Sharing};
use serde::{Deserialize, Serialize};

/// A registered service: a [`ServiceSpec`] with every default filled in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Service {
    pub(crate) topic: String,
    #[serde(rename = "type")]
    pub(crate) type_name: String,
    pub(crate) mode: Mode,
    pub(crate) direction: Direction,
    pub(crate) max_age_ms: u64,
    pub(crate) lease_ms: u64,
    pub(crate) lease_ms_max: u64,
    pub(crate) stop_hex: Option<String>,
    /// The settings of its rule.
    #[serde(default, skip_serializing_if = "Sharing::is_default")]
    pub(crate) sharing: Sharing,
    /// Facts for policies besides those of the robot.
    #[serde(default, skip_serializing_if = "Attributes::is_empty")]
    pub(crate) attributes: Attributes,
}

impl Service {
    /// The terms of the places of its subscribers, if it limits them. A subscriber sends nothing, so it is never idle.
    pub(super) fn for_readers(&self) -> Option<Self> {
        let publishers = Some(self.sharing.subscribers? + u64::from(active(Mutation::OnePlaceTooMany)));
        let sharing = Sharing { publishers, subscribers: None, idle_release_ms: None, ..self.sharing.clone() };
        Some(Self { sharing, ..self.clone() })
    }
}
