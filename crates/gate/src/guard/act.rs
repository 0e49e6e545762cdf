//! Acts that the gate asks of its driver.

use crate::gate::{Passed, Refused};

/// The action that is to be taken.
#[derive(Debug, PartialEq, Eq)]
pub enum Act {
    /// Publish its samples, in order.
    Publish(Passed),
    /// Publish the stop message, for this reason.
    Stop(&'static str),
    /// The gate did not let a message of this block pass. If the refusal [stops](Refused::stops) the robot, publish the stop message,
    /// too.
    Refused {
        /// The rule that it broke.
        refused: Refused,
        /// The block.
        height: u64,
    },
}
