//! The way of a transaction from its arrival to the orderer: it is taken in, looked at, and ordered or answered.

use crate::clients::rejections::Rejections;
use crate::ordering::Ordering;
use crate::ordering::waiters::{Answers, Client, refused};
use crate::peers::Peers;
use crate::process::memory;
use crate::process::meters::observe;
use ledger::Refusal;
use ledger_api::v1::{SubmitRequest, SubmitResponse};
use ledger_raft::Input;
use ledger_replica::gateway::{Admitting, Arrived, Call, Decision, Entrance, Item, Share, Ticket, Turned, id_of};
use ledger_replica::{Answer, Executed, Retries, Waiter};
use ledger_traces::{Step, Tracer, wall};
use std::sync::Arc;
use std::time::Instant;

/// Takes transactions in, and has them ordered.
pub(crate) struct Intake {
    /// The ledger, clients that wait, and the orderer.
    pub ordering: Arc<Ordering>,
    /// Robots are notified of stops ahead of ordering.
    pub peers: Arc<Peers>,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: Retries,
    /// Bytes that a transaction may have at most.
    pub payload_bytes_max: u64,
    /// Longest time that data waits until it is looked at, microseconds.
    pub wait_max: u64,
    /// Where the steps of messages are told.
    pub tracer: Tracer,
}

impl Intake {
    /// The height that is executed.
    pub(super) fn height(&self) -> u64 {
        self.ordering.storage.ledger.tip().height
    }

    /// Takes a request in, or answers it.
    pub(super) fn arrived(
        &self,
        request: SubmitRequest,
        share: &Arc<Share>,
        answers: &Answers,
    ) -> Result<Arrived<Client>, Box<SubmitResponse>> {
        let SubmitRequest { transaction: encoded, min_height, first_attempt } = request;
        let (payload_bytes_max, space) = (self.payload_bytes_max, &self.ordering.storage.space);
        let clock = self.peers.monitor.check_clock();
        let elapsed = self.ordering.clock.elapsed();
        memory::has_carried(encoded.len());
        let entrance = Entrance { ledger: &self.ordering.storage.ledger, payload_bytes_max, elapsed };
        let (since, committed) = (Instant::now(), self.ordering.meters.commit.clone());
        let client = |place| Client { answers: answers.clone(), place, since, committed };
        let call = Call { encoded, min_height, first_attempt };
        let room = |ends: &dyn Fn() -> bool| match clock {
            Err(wrong) if !ends() => Err(wrong),
            _ => space.check(ends),
        };
        entrance.enter(call, share, room, client).map_err(|Turned { refusal, reason }| {
            self.rejections.record(self.ordering.clock.now(), &refusal);
            Box::new(refused(id_of(&refusal).as_ref(), &reason))
        })
    }

    /// The circumstances of a look at a transaction. Everything that can be refused before ordering is refused by it.
    pub(super) fn admitting(&self) -> Admitting<'_, Client> {
        Admitting {
            ledger: &self.ordering.storage.ledger,
            waiters: &self.ordering.waiters,
            retries: &self.retries,
            budgets: &self.ordering.budgets,
            organisation_bytes: self.ordering.storage.space.organisation_bytes(),
            now: self.ordering.clock.both(),
            wait_max: self.wait_max,
        }
    }

    /// Carries a decision out. A call that the state refuses is given back until it is known whether the state is current.
    pub(super) fn carry_out(&self, decision: Decision<Client>) -> Option<Item<Client>> {
        match decision {
            Decision::Order(arrived) => self.order(arrived),
            Decision::Known { client, id, record } => {
                client.answer(&Answer::Executed(Executed::recorded(id, &record)));
            }
            Decision::Hold(item) => return Some(item),
            Decision::Refuse { client, refusal, reason } => {
                self.rejections.record(self.ordering.clock.now(), &refusal);
                let _gone = client.answers.send(Ok(refused(id_of(&refusal).as_ref(), &reason)));
            }
        }
        None
    }

    /// Hands a transaction to the orderer. It is answered when it has a verdict.
    fn order(&self, arrived: Arrived<Client>) {
        self.ordering.idle_control.keep();
        let (foreseen, transaction_id) =
            (self.peers.early_stops.foresee(&arrived.transaction), arrived.transaction.id());
        let Arrived { transaction, ticket: Ticket { lane, .. }, client } = arrived;
        let since = client.since;
        self.ordering.waiters.add(self.ordering.clock.elapsed(), &transaction, lane, client);
        let input = Input::Submit { lane, transaction: transaction.encoded().clone() };
        if let Err(rejection) = self.ordering.slot.input(input) {
            let who = self.ordering.waiters.refuse(&transaction.id(), &rejection);
            self.rejections.record(self.ordering.clock.now(), &Refusal::of_node(who, Some(transaction), rejection));
        }
        observe(&self.ordering.meters.gateway, since);
        self.tracer.tell(&transaction_id, || Step::since("gateway", wall(since)));
        // Also if nobody can order it.
        if let Some(foreseen) = foreseen {
            self.peers.early_stops.announce(foreseen);
        }
    }
}
