//! Rules by height (docs/format.md, "Rules"): every node executes a block by the rules that its height has.

use super::{Check, Violation};
use ledger::{Activation, Outcome, Rules};

const NAME: &str = "rules by height";
/// The rules that every network is founded with.
const FOUNDED: u32 = Rules::NEWEST.number();

/// The activations that were decided so far.
#[derive(Default)]
pub struct RulesByHeight {
    activations: Vec<Activation>,
}

impl RulesByHeight {
    /// The rules of a height, by what was decided below it.
    pub fn number_at(&self, height: u64) -> u32 {
        let reached = self.activations.iter().rfind(|activation| activation.height <= height);
        reached.map_or(FOUNDED, |activation| activation.number)
    }

    /// The newest rules that were decided.
    pub fn newest(&self) -> u32 {
        self.activations.last().map_or(FOUNDED, |activation| activation.number)
    }

    /// The first height of the newest rules.
    pub fn newest_from(&self) -> u64 {
        self.activations.last().map_or(0, |activation| activation.height)
    }

    /// A block was executed for the first time, and may decide about those that follow. Answers whether it has.
    pub fn decided(&mut self, outcome: &Outcome) -> bool {
        let events = outcome.events.iter().map(|emitted| &emitted.event);
        let activated = events.filter(|event| event.chaincode == "msp" && event.name == "rules_activated");
        let before = self.activations.len();
        self.activations.extend(activated.map(|event| serde_json::from_slice::<Activation>(&event.payload).unwrap()));
        self.activations.len() > before
    }

    /// A node has executed a block by the rules of this number.
    ///
    /// # Errors
    /// Its height has others.
    pub fn executed(&self, node: u64, height: u64, number: Option<u32>) -> Check {
        let wanted = self.number_at(height);
        if number == Some(wanted) {
            return Ok(());
        }
        let what = format!("node {node} executes block {height} by rules {number:?}, wanted {wanted}");
        Err(Violation::new(NAME, what))
    }

    /// A node stops because it does not speak the rules of a block.
    ///
    /// # Errors
    /// It speaks them.
    pub fn stopped(&self, node: u64, height: u64, speaks: u32) -> Check {
        let wanted = self.number_at(height);
        if speaks < wanted {
            return Ok(());
        }
        let what = format!("node {node} stops before block {height} of rules {wanted}, although it speaks {speaks}");
        Err(Violation::new(NAME, what))
    }
}
