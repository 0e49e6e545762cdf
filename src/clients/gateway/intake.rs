//! The way of a transaction from its arrival to the orderer: it is taken in, looked at, and ordered or answered.

use crate::clients::rejections::Rejections;
use crate::ordering::orderer_slot::OrdererSlot;
use crate::ordering::waiters::{Answers, Client, Waiters, refused};
use crate::peers::early_stop::EarlyStops;
use crate::process::clock::Clock;
use crate::process::idle_control::IdleControl;
use crate::process::memory;
use crate::process::meters::observe;
use crate::storage::space::Space;
use ledger::{Ledger, Refusal};
use ledger_api::v1::{SubmitRequest, SubmitResponse};
use ledger_raft::Input;
use ledger_replica::gateway::{Admitting, Arrived, Call, Decision, Entrance, Item, Share, Ticket, Turned, id_of};
use ledger_replica::{Answer, Executed, Retries, Waiter};
use ledger_traces::{Step, Tracer, wall};
use prometheus_client::metrics::histogram::Histogram;
use std::sync::Arc;
use std::time::Instant;

/// Takes transactions in, and has them ordered.
pub(crate) struct Intake {
    /// Looks at it.
    pub ledger: Arc<Ledger>,
    /// The node's clock.
    pub clock: Clock,
    /// Their limits.
    pub bounds: Bounds,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: Retries,
    /// Clients that wait.
    pub waiters: Arc<Waiters>,
    /// Where ordering is, when it is.
    pub slot: Arc<OrdererSlot>,
    /// Keeps the processors awake.
    pub awake: Arc<IdleControl>,
    /// Calls that were refused.
    pub denials: Arc<Rejections>,
    /// Tells robots of stops.
    pub early: Arc<EarlyStops>,
    /// Takes down how long it takes until ordering has a transaction.
    pub handed_over: Histogram,
    /// Takes down how long verdicts take.
    pub committed: Histogram,
    /// Where the steps of messages are told.
    pub tracer: Tracer,
}

/// The limits of what comes in.
pub(crate) struct Bounds {
    /// Bytes that a transaction may have at most.
    pub payload_bytes_max: u64,
    /// The room that the disk still has.
    pub space: Arc<Space>,
    /// Longest time that data waits until it is looked at, microseconds.
    pub wait_max: u64,
}

impl Intake {
    /// The height that is executed.
    pub(super) fn height(&self) -> u64 {
        self.ledger.tip().height
    }

    /// Takes a request in, or answers it.
    pub(super) fn arrived(
        &self,
        request: SubmitRequest,
        share: &Arc<Share>,
        answers: &Answers,
    ) -> Result<Arrived<Client>, Box<SubmitResponse>> {
        let SubmitRequest { transaction: encoded, min_height, first_attempt } = request;
        let Bounds { payload_bytes_max, ref space, .. } = self.bounds;
        let elapsed = self.clock.elapsed();
        memory::has_carried(encoded.len());
        let entrance = Entrance { ledger: &self.ledger, payload_bytes_max, elapsed };
        let (since, committed) = (Instant::now(), self.committed.clone());
        let client = |place| Client { answers: answers.clone(), place, since, committed };
        let call = Call { encoded, min_height, first_attempt };
        entrance.enter(call, share, |ends| space.check(ends), client).map_err(|Turned { refusal, reason }| {
            self.denials.record(self.clock.now(), &refusal);
            Box::new(refused(id_of(&refusal).as_ref(), &reason))
        })
    }

    /// The circumstances of a look at a transaction. Everything that can be refused before ordering is refused by it.
    pub(super) fn admitting(&self) -> Admitting<'_, Client> {
        Admitting {
            ledger: &self.ledger,
            waiters: &self.waiters,
            retries: &self.retries,
            now: self.clock.both(),
            wait_max: self.bounds.wait_max,
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
                self.denials.record(self.clock.now(), &refusal);
                let _gone = client.answers.send(Ok(refused(id_of(&refusal).as_ref(), &reason)));
            }
        }
        None
    }

    /// Hands a transaction to the orderer. It is answered when it has a verdict.
    fn order(&self, arrived: Arrived<Client>) {
        self.awake.keep();
        let (foreseen, transaction_id) = (self.early.foresee(&arrived.transaction), arrived.transaction.id());
        let Arrived { transaction, ticket: Ticket { lane, .. }, client } = arrived;
        let since = client.since;
        self.waiters.add(self.clock.elapsed(), &transaction, lane, client);
        let input = Input::Submit { lane, transaction: transaction.encoded().clone() };
        if let Err(rejection) = self.slot.input(input) {
            let who = self.waiters.refuse(&transaction.id(), &rejection);
            self.denials.record(self.clock.now(), &Refusal::of_node(who, Some(transaction), rejection));
        }
        observe(&self.handed_over, since);
        self.tracer.tell(&transaction_id, || Step::since("gateway", wall(since)));
        // Also if nobody can order it.
        if let Some(foreseen) = foreseen {
            self.early.announce(foreseen);
        }
    }
}
