//! Nodes attest what they have computed, by transactions as everybody else.

use super::{Timer, World};
use crate::client::sign;
use crate::clock::SECOND;
use crate::invariant::Check;
use bytes::Bytes;
use ledger::Admission;
use ledger::msp::{Attest, NAME};
use ledger_raft::{Input, Lane};

impl World {
    /// A node attests its newest snapshot, and the newest block.
    pub(super) fn attest(&mut self, id: u64) -> Check {
        let pause = self.random.nodes.between(SECOND / 2, 4 * SECOND);
        self.schedule_timer(id, pause, Timer::Attest);
        let Some(running) = self.running(id) else { return Ok(()) };
        if running.replica.is_none() {
            return Ok(());
        }
        let snapshot = running.said.snapshot_due(&running.ledger, &running.snapshots).unwrap();
        let block = running.said.block_due(&running.ledger.tip(), running.ordinary, running.store.durable_index());
        snapshot.into_iter().chain(block).try_for_each(|attest| self.submit_attestation(id, &attest))
    }

    fn submit_attestation(&mut self, id: u64, attest: &Attest) -> Check {
        let clock = self.clocks(id).clock;
        let nonce = self.random.nodes.number();
        let call = (NAME, "attest", vec![Bytes::from(serde_json::to_vec(attest).unwrap())]);
        let node = self.people.node(id, self.plan.organisations);
        let signed = sign(node, self.network, nonce, clock + 30 * SECOND, call, true);
        let Some(running) = self.running(id) else { return Ok(()) };
        match running.ledger.admit(signed.encoded().clone(), clock) {
            Ok(Admission::New(transaction)) => {
                self.coverage.attestations += 1;
                self.input(id, Input::Submit { lane: Lane::Data, transaction: transaction.encoded().clone() })
            }
            Ok(Admission::Known(..)) | Err(_) => Ok(()),
        }
    }
}
