//! The JSON that the chaincode `abac` and its clients share: what is asked for, answered, and told in events.
//!
//! Data only: what a field means stands here, what follows from it is decided in `crates/abac`. So a client such as
//! `ledgerctl` reads the answers without linking the engine of the policies.
//!
//! A request must use known words. An answer may come from a newer node. Its words are kept as [`Told`], so that they
//! can be shown, and a program that acts on them sees that it does not know them.
//!
//! ```
//! let text = r#"{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"}"#;
//! let service: ledger_contract::ServiceSpec = serde_json::from_str(text)?;
//! assert_eq!(service.mode, Some(ledger_contract::Mode::OPEN));
//! # Ok::<(), serde_json::Error>(())
//! ```

mod attribute;
mod can;
mod capability;
mod confidential;
mod confirmation;
mod delegation;
mod emergency;
mod grant;
mod limits;
mod line;
mod message;
mod plan;
mod policy;
mod robot;
mod service;
mod settings;
mod share;
mod sharing;
mod side_door;
mod task;
mod word;

pub use attribute::{Attribute, AttributeChanges, Attributes};
pub use can::{
    Ask, Can, Condition, Could, LimitChange, PolicyCheck, PolicyDiff, PolicyFault, PolicyMeaning, Right, RightOf,
    UnknownName, WouldEnd,
};
pub use capability::{Capabilities, Fencing, Publishing, Sequence, ToldCapabilities, UnknownRule};
pub use confidential::{
    Envelope, KeyPlace, Keyed, NONCE_BYTES, READERS_MAX, READING_KEY_BYTES, Reader, ReaderTold, Readers, Share,
    WRAPPED_BYTES, Wrapped,
};
pub use confirmation::Confirmation;
pub use delegation::{Delegated, PassOptions};
pub use emergency::{Emergency, EmergencyAnswer, Stopped};
pub use grant::{Grant, POLICIES_TOLD_MAX, Reason, Released};
pub use limits::Limits;
pub use line::{AcquireOptions, Acquired, Left, LeftReason, LineState, LineTold, Pending, Place};
pub use message::{Latest, MessageEvent, Permitted, Published};
pub use plan::{FleetChange, FleetPlan, RemovedRobot};
pub use policy::{
    PolicyApproval, PolicyApprovals, PolicyChange, PolicyDigest, PolicyDraft, PolicyEntry, PolicyNeed, PolicyProposal,
    PolicyProposalTexts, PolicySet, PolicySetTexts, PolicyText,
};
pub use robot::{Declaration, RobotAsset, RobotEvent, RobotSpec};
pub use service::{Direction, ServiceSpec, ServiceState, is_called, replies};
pub use settings::{RobotChange, RobotSettings, SettingChange};
pub use share::{Access, AskAccess, ShareEntry, SharePreview, ShareTerms, UnsharePreview};
pub use sharing::{Mode, OnConflict, Sharing, read_from, readers};
pub use side_door::SideDoor;
pub use task::{
    COORDINATE_UM_MAX, FRAME_DEFAULT, NEXT_MAX, POINTS_MAX, Point, RunningTask, Submitted, Task, TaskSpec, TaskState,
    TaskTold, YAW_URAD_MAX,
};
pub use word::{Told, Word};
