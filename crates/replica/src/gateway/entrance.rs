//! Taking a call in: what can be refused without looking closer is refused here.

use super::admission::answer_to;
use super::line::{Arrived, Ticket};
use super::share::{InFlight, Share};
use crate::withheld::URGENT_BYTES_MAX;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Ground, Ledger, Refusal};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Lane;
use std::sync::Arc;

/// The node's circumstances when a call comes.
pub struct Entrance<'a> {
    /// The ledger.
    pub ledger: &'a Ledger,
    /// Bytes that a transaction may have at most (`limits.payload_bytes_max`).
    pub payload_bytes_max: u64,
    /// Time since the node started, microseconds.
    pub elapsed: u64,
}

/// A call as it comes.
pub struct Call {
    /// The bytes of a transaction.
    pub encoded: Bytes,
    /// Height at which it is to be looked at.
    pub min_height: u64,
    /// The client says that it gave it to no node before.
    pub first_attempt: bool,
}

/// A call that is not even looked at.
pub struct Turned {
    /// The finding of the node; to be counted.
    pub refusal: Box<Refusal>,
    /// The answer to the client.
    pub reason: Rejection,
}

impl Entrance<'_> {
    /// Takes a call of an identity in. `room` says why the node has no room for it now, if it has none: its disk is full,
    /// or its clock is wrong. Whether the call ends control it can ask. `client` is who gets the answer, with the place that it has until then.
    ///
    /// # Errors
    /// Why it is not looked at.
    pub fn enter<C>(
        &self,
        call: Call,
        share: &Arc<Share>,
        room: impl FnOnce(&dyn Fn() -> bool) -> Result<(), Rejection>,
        client: impl FnOnce(InFlight) -> C,
    ) -> Result<Arrived<C>, Turned> {
        let Call { encoded, min_height, first_attempt } = call;
        let turned = |refusal: Box<Refusal>| Turned { reason: answer_to(&refusal, first_attempt), refusal };
        if encoded.len() as u64 > self.payload_bytes_max {
            let rejection = Rejection::new(Code::TooLarge, "the transaction exceeds the limit of this node")
                .found(format!("{} bytes", encoded.len()))
                .wanted(format!("at most {} bytes (limits.payload_bytes_max)", self.payload_bytes_max))
                .next("send less at once, or raise the limit in the node's configuration");
            // Not even looked at, but named: by the id a client on a stream knows which of its transactions is meant.
            let transaction = Transaction::decode(encoded).ok();
            return Err(turned(Box::new(Refusal::of_node(None, transaction, rejection))));
        }
        let transaction = Transaction::decode(encoded).map_err(|rejection| {
            turned(Box::new(Refusal { who: None, transaction: None, rejection, ground: Ground::Bytes }))
        })?;
        let body = transaction.body();
        let chaincode = self.ledger.registry().find(&body.chaincode).ok();
        if let Err(rejection) = room(&|| chaincode.is_some_and(|called| called.ends(&body.function))) {
            return Err(turned(Box::new(Refusal::of_node(None, Some(transaction), rejection))));
        }
        let urgent = chaincode.is_some_and(|called| called.urgent(&body.function));
        let lane = lane(urgent, transaction.encoded().len(), share, self.elapsed);
        match share.place(lane, transaction.encoded().len()) {
            Ok(place) => {
                let ticket = Ticket { min_height, first_attempt, lane, since: self.elapsed };
                Ok(Arrived { transaction, ticket, client: client(place) })
            }
            Err(rejection) => {
                let who = Some(share.name().to_owned());
                Err(turned(Box::new(Refusal::of_node(who, Some(transaction), rejection))))
            }
        }
    }
}

/// The lane of a call: what is urgent overtakes data while it is small and few.
fn lane(urgent: bool, bytes: usize, share: &Share, elapsed: u64) -> Lane {
    match urgent && bytes <= URGENT_BYTES_MAX && share.hurries(elapsed) {
        true => Lane::Control,
        false => Lane::Data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway::Shares;

    #[test]
    fn nobody_puts_bulk_where_control_goes_first() {
        let shares = Shares::new(120);
        let share = shares.of("Org1/Farhad".into());
        assert_eq!(lane(true, 300, &share, 0), Lane::Control);
        assert_eq!(lane(false, 300, &share, 0), Lane::Data);
        assert_eq!(lane(true, URGENT_BYTES_MAX + 1, &share, 0), Lane::Data, "large");
        let control = (0..100_000).filter(|_| lane(true, 300, &share, 0) == Lane::Control).count();
        assert!((500..2000).contains(&control), "{control} of them are many");
        assert_eq!(lane(true, 300, &shares.of("Org1/Salma".into()), 0), Lane::Control, "another one's release");
    }
}
