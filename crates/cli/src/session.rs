//! A connection as the selected context.

use crate::cli::Global;
use ledger::{Bytes, Hash, Rejection};
use ledger_api::{Client, Committed, Context};
use std::time::Duration;

/// The chaincode that keeps robots, grants and policies.
pub(crate) const ABAC: &str = "abac";
/// How long a connection may take before the node counts as unreachable.
pub(crate) const CONNECT_MAX: Duration = Duration::from_secs(3);
