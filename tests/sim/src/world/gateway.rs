//! The gateway of a node: admission, queries, waiting for heights (`src/gateway/`). The replica makes the decisions.

use super::{Event, Timer, World};
use crate::invariant::Check;
use crate::node::{Answer, Asking, Client, Refused, Reply, Request, What};
use bytes::Bytes;
use ledger::Ground;
use ledger::transaction::Transaction;
use ledger_raft::{Input, Lane};
use ledger_rejection::{Code, Rejection};
use ledger_replica::admission::{Admitting, Decision};
use ledger_replica::{Event as ReplicaEvent, Executed, Known, ReadEffect, Reads, WAIT_FOR_HEIGHT};
use std::collections::VecDeque;

impl World {
    /// A request arrives.
    pub(super) fn request(&mut self, id: u64, request: Request) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        if request.min_height > running.ledger.tip().height {
            running.behind.push((now + WAIT_FOR_HEIGHT, request));
            return Ok(());
        }
        self.serve(id, request)
    }

    fn serve(&mut self, id: u64, request: Request) -> Check {
        match request.what {
            What::Submit { .. } => self.submit(id, request, None),
            What::Read { may_be_stale: true, .. } => self.answer_read(id, &request),
            What::Read { may_be_stale: false, .. } => {
                let asking = Asking { request, refusal: None, judged: (0, 0) };
                self.reads(id, |reads, now, out| reads.ask(now, asking, out))
            }
        }
    }

    /// Tells who waits for the state to be current what happened, and does what follows.
    pub(super) fn reads(
        &mut self,
        id: u64,
        happened: impl FnOnce(&mut Reads<Asking>, u64, &mut Vec<ReadEffect<Asking>>),
    ) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        let mut effects = Vec::new();
        happened(&mut running.reads, now, &mut effects);
        let mut told = VecDeque::new();
        while let Some(effect) = effects.pop() {
            match effect {
                ReadEffect::Tell { asker, known } => told.push_front((asker, known)),
                ReadEffect::Ask { context } if running.replica.is_some() => {
                    running.inbox.push_back(ReplicaEvent::Input(Input::ReadIndex { context }));
                }
                ReadEffect::Ask { context } => {
                    let behind = Rejection::new(Code::Behind, "this node fetches blocks that it missed");
                    running.reads.answered(now, context, Err(behind), &mut effects);
                }
            }
        }
        let (asked, due) = (!running.inbox.is_empty(), running.reads.wakes_at());
        if let Some(due) = due.filter(|due| *due != running.reads_at) {
            running.reads_at = due;
            self.schedule_timer(id, due.saturating_sub(now), Timer::Reads);
        }
        if asked {
            self.schedule_timer(id, 0, Timer::Turn);
        }
        told.into_iter().try_for_each(|(asking, known)| self.known(id, asking, &known))
    }

    /// It is known whether the state is current.
    fn known(&mut self, id: u64, asking: Asking, known: &Known) -> Check {
        match (&asking.request.what, known) {
            (What::Submit { .. }, _) => self.submit(id, asking.request.clone(), Some((asking, known))),
            (What::Read { .. }, Ok(_)) => self.answer_read(id, &asking.request),
            (What::Read { .. }, Err(reason)) => {
                self.reply(id, asking.request.reply, Answer::Refused(Refused::unordered(reason.code)));
                Ok(())
            }
        }
    }

    /// A transaction: admitted, or refused as far as that can be said. `held`: it was held, until what is known now.
    fn submit(&mut self, id: u64, request: Request, held: Option<(Asking, &Known)>) -> Check {
        let (clock, reply) = (self.clocks(id).clock, request.reply);
        let What::Submit { transaction, first_attempt } = &request.what else { return Ok(()) };
        let who = self.clients[reply.client].person.clone();
        let Some(running) = self.running(id) else { return Ok(()) };
        if running.disk_full {
            self.reply(id, reply, Answer::Refused(Refused::unordered(Code::DiskFull)));
            return Ok(());
        }
        let transaction = Transaction::decode(transaction.clone()).unwrap();
        let tip = running.ledger.tip();
        let mut judged = (tip.height, clock.max(tip.time));
        let admitting = Admitting {
            ledger: &running.ledger,
            waiters: &running.waiters,
            retries: &running.retries,
            clock,
            who: &who,
            first_attempt: *first_attempt,
        };
        let before = held.as_ref().and_then(|(asking, _)| Some((asking.refusal.clone()?, asking.judged)));
        let decision = match held {
            None => admitting.look(transaction),
            Some((asking, known)) => admitting.look_again(transaction, asking.refusal, known),
        };
        match decision {
            Decision::Order { transaction, .. } => self.order(id, reply, &transaction),
            Decision::Known(transaction, record) => {
                self.acknowledge(id, &transaction, record.height)?;
                let Executed { height, index, result, .. } = Executed::recorded(transaction, &record);
                let (code, response) = (result.code(), result.response.clone());
                self.reply(id, reply, Answer::Verdict { height, index, code, response });
                Ok(())
            }
            Decision::Hold(_, refusal) => {
                let asking = Asking { request, refusal: Some(refusal), judged };
                self.reads(id, |reads, now, out| reads.ask(now, asking, out))
            }
            Decision::Refuse { refusal, reason } => {
                if let Some((earlier, then)) = before
                    && earlier == refusal
                {
                    judged = then;
                }
                let code = reason.code;
                *self.coverage.refusals.entry(code).or_default() += 1;
                self.note(format_args!("n{id} refuses {reply:?}: {code}"));
                if code.is_final() && !matches!(refusal.ground, Ground::Bytes | Ground::Past) {
                    self.invariants.answered_is_seen.decided(id, judged.0, request.told)?;
                }
                let judged = (code == refusal.rejection.code).then_some(judged);
                self.reply(id, reply, Answer::Refused(Refused { code, judged }));
                Ok(())
            }
        }
    }

    /// Hands a transaction to the replica; its submitter waits for its verdict.
    fn order(&mut self, id: u64, reply: Reply, transaction: &Transaction) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        let body = transaction.body();
        let chaincode = running.ledger.registry().find(&body.chaincode);
        let urgent = chaincode.is_ok_and(|chaincode| chaincode.urgent(&body.function));
        let lane = if urgent { Lane::Control } else { Lane::Data };
        running.waiting.insert(reply, now);
        running.waiters.add(now, transaction, lane, Client { reply, answers: running.answers.0.clone() });
        if running.replica.is_none() {
            let behind = Rejection::new(Code::Behind, "this node fetches blocks that it missed");
            running.waiters.refuse(&transaction.id(), &behind);
            return self.tell(id);
        }
        if std::mem::take(&mut self.forges_next) {
            self.order_forged(id, transaction)?;
        }
        self.input(id, Input::Submit { lane, transaction: transaction.encoded().clone() })
    }

    fn answer_read(&mut self, id: u64, request: &Request) -> Check {
        let What::Read { person, service, may_be_stale } = &request.what else { return Ok(()) };
        let Some(node) = self.nodes.get(&id) else { return Ok(()) };
        let Some(running) = &node.up else { return Ok(()) };
        let clock = node.clock.now(self.now);
        let tip = running.ledger.tip();
        let caller = &self.people.all[*person].identity;
        let answer = running.ledger.query(caller, clock, "abac", "service", &[Bytes::from(service.clone())]);
        let (code, response) = match answer {
            Ok((response, _)) => (Code::Ok, response),
            Err(fault) => (fault.code, Bytes::new()),
        };
        let judged_at = clock.max(tip.time);
        if !may_be_stale {
            self.invariants.answered_is_seen.decided(id, tip.height, request.told)?;
        }
        self.reply(id, request.reply, Answer::Value { height: tip.height, judged_at, code, response });
        Ok(())
    }

    /// Serves who has waited for the height that is reached now, and tells who has waited too long.
    pub(super) fn catch_up(&mut self, id: u64) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        let height = running.ledger.tip().height;
        let (mut ready, mut late) = (Vec::new(), Vec::new());
        running.behind.retain(|(until, request)| {
            if request.min_height <= height {
                ready.push(request.clone());
            } else if now > *until {
                late.push(request.reply);
            } else {
                return true;
            }
            false
        });
        for reply in late {
            self.reply(id, reply, Answer::Refused(Refused::unordered(Code::Behind)));
        }
        ready.into_iter().try_for_each(|request| self.serve(id, request))
    }

    /// Sends an answer on its way.
    pub(super) fn reply(&mut self, id: u64, reply: Reply, answer: Answer) {
        let Some(node) = self.nodes.get(&id) else { return };
        let clock = node.clock.now(self.now);
        if let Answer::Verdict { height, .. } | Answer::Value { height, .. } = &answer {
            self.invariants.answered_is_seen.tells(*height);
        }
        if let Some(at) = self.links.client(self.now, &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Event::Answer { reply, clock, answer });
        }
    }
}
