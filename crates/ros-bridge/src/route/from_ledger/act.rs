//! The meaning of events of the ledger to the gate, and what then is to be done; without IO.

use std::collections::HashMap;

use bytes::Bytes;
use ledger_api::v1::EventRecord;
use ledger_contract::{Reason, Word};

use crate::{
    gate::{Delivered, Gate, Now, Refused},
    gateway::{ABAC, MSP},
    sample::Sample,
    service::{Released, Revoked, read},
};

/// The action that an event asks for.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Act {
    Nothing,
    /// Publish these, in order.
    Publish(Vec<Sample>),
    /// Publish the stop message, for this reason, and ask whether it is true.
    Stop(&'static str),
    /// The route may know something wrong: ask.
    Ask,
    /// The gate did not let it pass.
    Refused(Refused),
}

/// Transactions of one block by their position: the first event of each carries it.
pub(super) type Shown = HashMap<u32, (Bytes, Bytes)>;

/// The meaning of an event to the gate.
pub(super) fn judge(gate: &mut Gate, block_time: u64, event: &EventRecord, shown: &mut Shown, now: Now) -> Act {
    if !event.certificate.is_empty() {
        gate.show(&event.certificate);
    }
    if !event.transaction.is_empty() {
        shown.insert(event.index, (event.transaction.clone(), event.certificate.clone()));
    }
    let none = (Bytes::new(), Bytes::new());
    let (transaction, certificate) = shown.get(&event.index).unwrap_or(&none);
    let delivered = Delivered { block_time, transaction, certificate };
    let outcome = match (event.chaincode.as_str(), event.name.as_str()) {
        (ABAC, "message") => gate.pass(delivered, now).map(Act::Publish),
        (ABAC, "granted") => Ok(Act::Ask),
        (ABAC, "released") => match read::<Released>(&event.payload) {
            Some(released) if gate.released(&released, block_time, now) => Ok(Act::Stop(reason(&released.reason))),
            Some(_) => Ok(Act::Ask),
            None => Err(Refused::Malformed),
        },
        (ABAC, "robot") => {
            gate.close();
            Ok(Act::Ask)
        }
        (MSP, "revoked") => match read::<Revoked>(&event.payload) {
            Some(revoked) if gate.revoked(&revoked, now) => Ok(Act::Stop("revoked")),
            Some(_) => Ok(Act::Ask),
            None => Err(Refused::Malformed),
        },
        _ => Ok(Act::Nothing),
    };
    outcome.unwrap_or_else(Act::Refused)
}

/// The reason of a release, as it is counted.
fn reason(text: &str) -> &'static str {
    Reason::of(text).map_or("other", Word::word)
}
