//! The verdicts of calls about control. They stay provable for as long as their block is kept: the certificate of that block is kept
//! with them.

use ledger::Ledger;
use ledger_base::rejection::Rejection;
use ledger_light::fact::Fact;
use ledger_light::proof::FACTS_MAX;
use ledger_light::{Certificate, Proof};

/// Chaincode and name of the event of a message. It is no call about control.
const MESSAGE: (&str, &str) = ("abac", "message");

/// Proofs of a certified block that show the verdicts of its calls about control: those that caused an event other than that of a
/// message. Several if one has no room for all; none if there are no such calls, or if the block was executed too long ago.
///
/// # Errors
/// A fault of the store.
pub(super) fn proofs(ledger: &Ledger, certificate: &Certificate) -> Result<Vec<Proof>, Rejection> {
    let height = certificate.statement.height;
    let Some(result) = ledger.result(height)? else { return Ok(Vec::new()) };
    let about_control =
        result.events.iter().filter(|emitted| (&*emitted.event.chaincode, &*emitted.event.name) != MESSAGE);
    let mut calls: Vec<u32> = about_control.filter_map(|emitted| emitted.index).collect();
    calls.dedup();
    let mut proofs = Vec::new();
    // The ground is a fact of each.
    for calls in calls.chunks(FACTS_MAX - 1) {
        let wanted = |fact: &Fact<'_>| matches!(fact, Fact::Verdict { index, .. } if calls.contains(index));
        let facts = ledger.shown(height, wanted)?;
        proofs.extend(facts.map(|facts| Proof { certificate: certificate.clone(), facts }));
    }
    Ok(proofs)
}

/// Does it show the verdict of the call at this position?
pub(super) fn shows(proof: &Proof, call: u32) -> bool {
    let facts = proof.others().unwrap_or_default();
    facts.iter().any(|fact| matches!(fact, Fact::Verdict { index, .. } if *index == call))
}
