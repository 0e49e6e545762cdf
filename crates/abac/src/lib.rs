//! Access control for ROS 2 services, as a chaincode: who may use a robot, and who wins when several may.
//!
//! This is the contract of the paper ("setup, acquire, release, authorize, set") as a deterministic
//! [`Chaincode`](ledger::Chaincode): no IO, no clock, no randomness; everything it knows is in the call's context.
//! Two questions are kept apart. *May this identity do this?* is answered by Cedar policies that the robot's owner
//! keeps on the ledger (`policy`, `authorize`). *Who wins when several may?* is answered by the service's mode
//! (`conflict`). The answer to both is a [`Grant`]: a lease with an epoch that fences off every earlier holder.
//!
//! It is not the gate: the robot's bridge checks signature, epoch, sequence and age of every message for itself.
//!
//! ```
//! use bytes::Bytes;
//! use ledger::{Environment, Registry};
//! use ledger_hash::Hash;
//! use ledger_storage::state::{MemoryState, Overlay};
//! use std::sync::Arc;
//!
//! let mut registry = Registry::new();
//! registry.install(Arc::new(ledger_abac::AccessControl::new()?))?;
//! let environment = Environment {
//!     registry: &registry, submitter: None, network: Hash::ZERO, height: 1, time: 0, transaction: Hash::ZERO,
//! };
//! let mut overlay = Overlay::new(Arc::new(MemoryState::default()));
//! let robots = Registry::invoke(environment, &mut overlay, &mut Vec::new(), "abac", "robots", &[])?;
//! assert_eq!(robots, Bytes::from("[]"));
//! # Ok::<(), ledger_rejection::Rejection>(())
//! ```
//!
//! | module | what is there |
//! |---|---|
//! | `contract` | the function table and the hooks |
//! | `robot`, `service`, `settings` | what is registered; the paper's asset; changing it |
//! | `grant`, `conflict` | who holds what, and who wins |
//! | `authorize`, `publish` | who may, and `set` |
//! | `policy`, `policies` | Cedar: limits, parsing, evaluation; the policies on the ledger |
//! | `revoke` | how rights end: expiry, revocation, change of policy |
//! | `store`, `records` | keys and JSON; values that were parsed before |
//! | `arguments`, `nearest`, `timestamp` | argument parsing, "did you mean", RFC 3339 |

mod arguments;
mod authorize;
mod conflict;
mod contract;
mod grant;
mod nearest;
mod policies;
mod policy;
mod publish;
mod records;
mod revoke;
mod robot;
mod service;
mod settings;
mod store;
mod timestamp;

pub use authorize::{Authorization, Caller};
pub use contract::AccessControl;
pub use ledger_contract::{
    Direction, Grant, MessageEvent, Mode, PolicyChange, PolicyEntry, Published, Reason, Released, RobotAsset,
    RobotChange, RobotEvent, RobotSettings, RobotSpec, ServiceSpec, ServiceState, SettingChange,
};
pub use policy::{DEFAULT_POLICY, POLICY_BYTES_MAX, SCHEMA};
pub use publish::MESSAGES_PER_CALL_MAX;
