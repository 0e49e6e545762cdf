//! The answer to a confirmation of a contender.

use crate::line::{Acquired, Pending};
use serde::{Deserialize, Serialize};

/// Answer of `confirm`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confirmation {
    /// The contender, with this confirmation.
    pub pending: Pending,
    /// The contender's grant, or its place in line, if this was the last confirmation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquired: Option<Acquired>,
    /// Why it cannot have the service though it is confirmed; it may acquire it until the confirmations end.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub refused: String,
}
