//! Floods: a client sends much at once, over many streams of one node, and waits for no answer.

use super::{Event, World};
use crate::client::{Call, SERVICES, sign};
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::coverage::Fault;
use crate::node::{Reply, Request, What};

/// Streams of one flood: more than there are identities.
const STREAMS: u64 = 24;
/// Calls over each of them.
const CALLS_MAX: u64 = 8;
/// Floods are rare, as every call of them is verified.
const PAUSE: u64 = 3 * SECOND;
/// Numbers of their streams are beyond those of all clients.
const FIRST_STREAM: u64 = 1 << 32;

impl World {
    /// A client floods a node.
    pub(super) fn flood(&mut self, node: u64) {
        if self.now < self.flooded + PAUSE {
            return;
        }
        self.flooded = self.now;
        let client = self.random.faults.below(self.clients.len() as u64) as usize;
        let nth = self.clients[client].nth;
        let Some(person) = self.people.index(&self.clients[client].person, nth) else { return };
        self.coverage.fault(Fault::Flood);
        let told = self.invariants.answered_is_seen.told();
        let seen = self.clients[client].seen;
        let (calls, time) = (self.random.faults.between(2, CALLS_MAX), self.random.faults.between(1, 20) * MILLISECOND);
        for stream in 0..STREAMS {
            let service = self.random.faults.pick(&SERVICES).copied().unwrap_or(SERVICES[0]).to_owned();
            let mut at = self.now + self.random.faults.below(time);
            let grant = self.clients[client].grants.get(&service).map(|(epoch, _)| *epoch);
            for nth in 0..calls {
                self.floods += 1;
                let random = &mut self.random.faults;
                let (service, epoch) = (service.clone(), random.below(3));
                let call = match (random.below(10), grant) {
                    // Of what it holds: messages, and control among them, that the state does not refuse.
                    (0..=2, Some(_)) => Call::Renew { service },
                    (3..=8, Some(epoch)) => Call::Set { service, epoch, seq: 1000 * self.floods + nth },
                    (0, None) => Call::Acquire { service, lease_ms: None },
                    (1, None) => Call::Release { service },
                    // Sometimes one that the state refuses.
                    _ => {
                        Call::Set { service, epoch, seq: if random.percent(20) { 0 } else { 1000 * self.floods + nth } }
                    }
                };
                let (nonce, first_attempt) = (random.number(), random.percent(60));
                // Over some streams everything comes in one packet, and so waits at once.
                at += if stream.is_multiple_of(3) { 0 } else { random.below(MILLISECOND) };
                let whose = &self.people.all[person];
                let signed = call.transaction();
                let not_after = EPOCH + self.now + self.valid(signed.1, 30 * SECOND);
                let transaction = sign(whose, self.network, nonce, not_after, signed, true);
                let what = What::Submit { transaction: transaction.encoded().clone(), first_attempt };
                // Nobody waits for an answer to these attempts.
                let reply = Reply { client, attempt: u64::MAX - self.floods };
                let stream = FIRST_STREAM + self.flooded + stream;
                self.schedule_at(
                    at,
                    Event::Request { node, request: Request { reply, min_height: seen, told, stream, what } },
                );
            }
        }
    }
}
