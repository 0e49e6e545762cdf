//! An identity that floods a node keeps nobody out. It holds at most as many places as it leaves to others. A call of
//! another one is looked at after a bounded number of turns, however many streams the flood comes over.

use super::{Check, Violation};

const NAME: &str = "nobody is kept out";

/// Nothing is remembered: one event says it all.
#[derive(Default)]
pub struct FairShare;

impl FairShare {
    /// An identity has taken a place of a node, and has so many of all in one lane now.
    ///
    /// # Errors
    /// It leaves less to others than it has.
    pub fn takes(&self, node: u64, who: &str, has: usize, places: usize) -> Check {
        if has <= places / 2 {
            return Ok(());
        }
        Err(Violation::new(NAME, format!("{who} has {has} of {places} places at node {node}")))
    }

    /// A stream of an identity looks at what it brings. `passed`: turns that others had while it waited, if it was the
    /// identity's only one.
    ///
    /// # Errors
    /// It waited for more turns than there are identities.
    pub fn looks(&self, node: u64, who: &str, passed: Option<usize>, identities: usize) -> Check {
        match passed {
            Some(passed) if passed > identities => Err(Violation::new(
                NAME,
                format!("{who} waited for {passed} turns at node {node}, and there are {identities} identities"),
            )),
            _ => Ok(()),
        }
    }
}
