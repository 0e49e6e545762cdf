//! Answered is seen: what anybody was told is committed, every later call anywhere sees. No node refuses because of a state,
//! or answers from one, that is older than the newest height that any node had told anybody when the call was made.

use super::{Check, Violation};

const NAME: &str = "answered is seen";

/// The newest height that anybody was told.
#[derive(Default)]
pub struct AnsweredIsSeen {
    told: u64,
}

impl AnsweredIsSeen {
    /// A node tells a client of this height.
    pub fn tells(&mut self, height: u64) {
        self.told = self.told.max(height);
    }

    /// The answers that had been given by now; for a call that is made now.
    pub fn told(&self) -> u64 {
        self.told
    }

    /// A node has decided on a call by the state of a height.
    ///
    /// # Errors
    /// More had been told when the call was made.
    pub fn decided(&self, node: u64, height: u64, told: u64) -> Check {
        if height >= told {
            return Ok(());
        }
        let what = format!("node {node} decides by the state of block {height}; before the call block {told} was told");
        Err(Violation::new(NAME, what))
    }
}
