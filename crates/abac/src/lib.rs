//! Access control for ROS 2 services, as a chaincode: who may use a robot, and who wins when several may.
//!
//! This is the contract of the paper ("setup, acquire, release, authorize, set") as a deterministic
//! [`Chaincode`](ledger::Chaincode): no IO, no clock, no randomness; everything it knows is in the call's context. Two
//! questions are kept apart. *May this identity do this?* is answered by Cedar policies that the robot's owner keeps on
//! the ledger (`policy`). The rule of the service's mode (`rules`) answers *which of several callers that may gets the
//! service?* The answer to both is a [`Grant`]: a lease with an epoch that fences off every earlier holder.
//!
//! It is not the gate: the robot's bridge checks signature, epoch, sequence and age of every message for itself.
//!
//! ```
//! use bytes::Bytes;
//! use ledger::{Environment, Meter, Registry, Rules};
//! use ledger_base::hash::Hash;
//! use ledger_storage::state::{MemoryState, Overlay};
//! use std::sync::Arc;
//!
//! let mut registry = Registry::new();
//! registry.install(Arc::new(ledger_abac::AccessControl::new()?))?;
//! let environment = Environment {
//!     registry: &registry, submitter: None, network: Hash::ZERO, rules: Rules::NEWEST, height: 1, time: 0,
//!     transaction: Hash::ZERO, executed: &|_, _| false, meter: &Meter::of_query(),
//! };
//! let mut overlay = Overlay::new(Arc::new(MemoryState::default()));
//! let robots = Registry::invoke(environment, &mut overlay, &mut Vec::new(), "abac", "robots", &[])?;
//! assert_eq!(robots, Bytes::from("[]"));
//! # Ok::<(), ledger_base::rejection::Rejection>(())
//! ```
//!
//! Layers, each of which knows only those below it:
//!
//! | layer | what is there |
//! |---|---|
//! | `contract` | the function table and the hooks |
//! | `calls` | a file for each function: parse, check, answer |
//! | `lifecycle` | changes of the state: grants, queue, tasks, confirmation, delegation, ends; one loop settles what follows |
//! | `policy` | who may: Cedar, the policies on the ledger, decisions that are remembered |
//! | `rules` | who wins when several may: a file for each rule, and the table of them |
//! | `records` | what the state holds: robots, services, grants, keys and indexes |
//! | `arguments` | argument parsing |

mod arguments;
mod calls;
mod contract;
#[cfg(test)]
mod fixture;
mod lifecycle;
mod policy;
mod records;
mod rules;

pub use calls::authorize::Authorization;
pub use calls::caller::Caller;
pub use calls::set::MESSAGES_PER_CALL_MAX;
pub use contract::AccessControl;
pub use ledger_contract::{
    Access, AcquireOptions, Acquired, Ask, AskAccess, Attribute, AttributeChanges, Attributes, Can, Capabilities,
    Condition, Confirmation, Could, Declaration, Delegated, Direction, Emergency, EmergencyAnswer, Fencing,
    FleetChange, FleetPlan, Grant, Keyed, Latest, Left, LeftReason, LimitChange, Limits, LineState, LineTold,
    MessageEvent, Mode, OnConflict, PassOptions, Pending, Permitted, Place, Point, PolicyApproval, PolicyApprovals,
    PolicyChange, PolicyCheck, PolicyDiff, PolicyDigest, PolicyDraft, PolicyEntry, PolicyFault, PolicyMeaning,
    PolicyNeed, PolicyProposal, PolicyProposalTexts, PolicySet, PolicySetTexts, PolicyText, Published, Publishing,
    Reader, ReaderTold, Readers, Reason, Released, RemovedRobot, Right, RightOf, RobotAsset, RobotChange, RobotEvent,
    RobotSettings, RobotSpec, Sequence, ServiceSpec, ServiceState, SettingChange, Share, ShareEntry, SharePreview,
    ShareTerms, Sharing, SideDoor, Stopped, Submitted, Task, TaskSpec, TaskState, TaskTold, Told, UnsharePreview,
    Wrapped,
};
pub use policy::analysis::{Analysis, terms};
pub use policy::defaults::{DEFAULT_POLICY, SCHEMA};
pub use policy::limits::POLICY_BYTES_MAX;
pub use rules::{Claim, Decision, Rule, Situation, contend, precedence};
