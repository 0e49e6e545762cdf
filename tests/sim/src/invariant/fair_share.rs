//! An organisation that floods a node keeps no other out, with however many identities. It holds at most as many places as it
//! leaves to others. A call of another one is looked at after a bounded number of turns, however many streams the flood
//! comes over.

use super::{Check, Violation};

const NAME: &str = "nobody is kept out";

/// Nothing is remembered: one event says it all.
#[derive(Default)]
pub struct FairShare;

impl FairShare {
    /// An identity has taken a place of a node, and its organisation has so many of all in one lane now.
    ///
    /// # Errors
    /// The organisation leaves less to others than it has.
    pub fn takes(&self, node: u64, who: &str, has: usize, places: usize) -> Check {
        if has <= places / 2 {
            return Ok(());
        }
        Err(Violation::new(NAME, format!("the organisation of {who} has {has} of {places} places at node {node}")))
    }

    /// A stream of an identity looks at what it brings. `passed`: turns that others had while it waited, if it was the
    /// identity's only one.
    ///
    /// # Errors
    /// It waited for more than `most` turns of others.
    pub fn looks(&self, node: u64, who: &str, passed: Option<usize>, most: usize) -> Check {
        match passed {
            Some(passed) if passed > most => Err(Violation::new(
                NAME,
                format!(
                    "{who} waited for {passed} turns at node {node}, of which at most {most} may come before its own"
                ),
            )),
            _ => Ok(()),
        }
    }
}
