//! The events of a block, and their meaning to the gate.

use std::collections::HashMap;

use bytes::Bytes;
use ledger_base::mutation::{Mutation, active};
use ledger_contract::{Reason, Word};

use super::act::Act;
use super::held::Message;
use crate::{
    ABAC, MSP,
    gate::{Delivered, Gate, Now, Refused},
    service::{Listed, Released, Revoked, read},
};

/// An event, as a node tells it.
#[derive(Clone, Copy, Debug)]
pub struct Told<'a> {
    /// Position of the transaction in its block.
    pub index: u32,
    /// The chaincode that emitted it.
    pub chaincode: &'a str,
    /// Its name.
    pub name: &'a str,
    /// Its JSON.
    pub payload: &'a [u8],
    /// The encoded transaction; empty where an event before has carried it.
    pub transaction: &'a Bytes,
    /// The certificate of its creator, if the node shows it.
    pub certificate: &'a Bytes,
}

/// The block that a node delivers.
#[derive(Debug)]
pub struct Block {
    /// Its height.
    pub height: u64,
    /// Its time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Was it fetched for those who come late?
    is_latched: bool,
    /// Its transactions with the certificates of their creators, by position: the first event of each carries it.
    shown: HashMap<u32, (Bytes, Bytes)>,
}

impl Block {
    /// Before its first event.
    pub fn new(height: u64, time: u64) -> Self {
        Self { height, time, is_latched: false, shown: HashMap::new() }
    }

    /// A block of the past, of which only messages count: see [`Gate::pass_latched`].
    pub fn latched(height: u64, time: u64) -> Self {
        Self { is_latched: true, ..Self::new(height, time) }
    }

    /// The message at a position, to be judged later.
    pub(super) fn message(&self, index: u32) -> Message {
        let (transaction, certificate) = self.shown.get(&index).cloned().unwrap_or_default();
        let Self { height, time, is_latched, .. } = *self;
        Message { height, block_time: time, is_latched, transaction, certificate }
    }

    /// The meaning of an event to the gate.
    pub(super) fn judge(&mut self, gate: &mut Gate, event: &Told<'_>, now: Now) -> Result<Option<Act>, Refused> {
        if !event.certificate.is_empty() {
            gate.show(event.certificate);
        }
        if !event.transaction.is_empty() {
            self.shown.insert(event.index, (event.transaction.clone(), event.certificate.clone()));
        }
        let none = (Bytes::new(), Bytes::new());
        let (transaction, certificate) = self.shown.get(&event.index).unwrap_or(&none);
        let delivered = Delivered { block_time: self.time, transaction, certificate };
        Ok(match (event.chaincode, event.name) {
            (ABAC, "keyed") => {
                gate.keyed(self.height, delivered)?;
                None
            }
            (ABAC, "message") if self.is_latched => Some(Act::Publish(gate.pass_latched(delivered, now)?)),
            _ if self.is_latched => None,
            (ABAC, "message") => Some(Act::Publish(gate.pass(delivered, now)?)),
            (ABAC, "granted") => {
                if active(Mutation::BelieveAGrant) {
                    read(event.payload).iter().for_each(|grant| gate.believe(grant));
                }
                None
            }
            (ABAC, "released") => {
                let released: Released = read(event.payload).ok_or(Refused::Malformed)?;
                gate.released(&released, self.time, now).then(|| Act::Stop(reason(&released.reason)))
            }
            (ABAC, "stopped") => gate.halt(transaction, now).then_some(Act::Stop("stopped")),
            (ABAC, "robot") => {
                gate.close();
                None
            }
            (MSP, "revoked") => {
                let revoked: Revoked = read(event.payload).ok_or(Refused::Malformed)?;
                gate.revoked(&revoked, now).then_some(Act::Stop("revoked"))
            }
            (MSP, "revocation_list") => {
                let listed: Listed = read(event.payload).ok_or(Refused::Malformed)?;
                // The gate takes note of all of them, also behind the one that moved the robot.
                let moved_it = listed.each().filter(|revoked| gate.revoked(revoked, now)).count() > 0;
                moved_it.then_some(Act::Stop("revoked"))
            }
            _ => None,
        })
    }
}

/// Does an event say that the robot may stand otherwise than before?
pub(super) fn changes(event: &Told<'_>) -> bool {
    matches!(
        (event.chaincode, event.name),
        (ABAC, "granted" | "released" | "robot" | "stopped" | "resumed" | "task")
            | (MSP, "revoked" | "revocation_list")
    )
}

/// The reason of a release, as it is counted.
fn reason(text: &str) -> &'static str {
    Reason::of(text).map_or("other", Word::word)
}
