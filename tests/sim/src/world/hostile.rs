//! Transactions that no honest gateway would let through, ordered by a member that does.

use super::World;
use crate::client::{Call, SERVICES, sign};
use crate::clock::{EPOCH, SECOND};
use crate::invariant::Check;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_raft::{Input, Lane};

impl World {
    /// A member that hears of a transaction has a copy of it ordered first, signed by somebody else. The id is the
    /// same, and the verdict says nothing about the transaction.
    pub(super) fn order_forged(&mut self, id: u64, transaction: &Transaction) -> Check {
        let other = self.people.all.iter().find(|person| person.fingerprint() != transaction.creator());
        let Some(other) = other else { return Ok(()) };
        let mut forged = Transaction::sign(transaction.body(), &other.key).unwrap();
        if let Some(certificate) = transaction.certificate() {
            forged = forged.with_certificate(certificate.clone()).unwrap();
        }
        assert_eq!(forged.id(), transaction.id(), "the id does not cover the signature");
        self.note(format_args!("n{id} orders a forged copy of {}", transaction.id()));
        self.input(id, Input::Submit { lane: Lane::Control, transaction: forged.encoded().clone() })
    }

    /// One of the things that execution must refuse, or ignore, on every node alike.
    pub(super) fn forge(&mut self) -> Option<Bytes> {
        let random = &mut self.random.faults;
        let service = random.pick(&SERVICES)?.to_string();
        let person = random.pick(self.people.persons())?;
        let now = EPOCH + self.now;
        let call = match random.below(4) {
            0 => Call::Release { service },
            1 => Call::Acquire { service, lease_ms: None },
            _ => Call::Set { service, epoch: random.below(4), seq: random.below(50) },
        };
        let nonce = random.number();
        let sign = |network, not_after, introduce| {
            sign(person, network, nonce, not_after, call.transaction(), introduce).encoded().clone()
        };
        let good = sign(self.network, now + 30 * SECOND, true);
        Some(match random.below(8) {
            0 => Bytes::from(nonce.to_be_bytes().to_vec()),
            1 => sign(Hash::of(&[b"another network"]), now + 30 * SECOND, true),
            2 => sign(self.network, now.saturating_sub(30 * SECOND), true),
            3 => sign(self.network, now + 7_200 * SECOND, true),
            4 => {
                // The signature is 64 bytes somewhere behind the body; the last byte of it is changed.
                let mut forged = sign(self.network, now + 30 * SECOND, false).to_vec();
                if let Some(last) = forged.last_mut() {
                    *last ^= 1;
                }
                forged.into()
            }
            5 => {
                // What was executed long ago, once more.
                let block = random.pick(&self.blocks)?;
                random.pick(&block.outcome.transactions)?.clone()
            }
            _ => good,
        })
    }
}
