//! The gateway of a node: admission, queries, waiting for heights (`src/gateway/`).

use super::{Event, World};
use crate::invariant::Check;
use crate::node::{Answer, Read, Refused, Reply, Request, WAIT_FOR_HEIGHT, Waiter, Waiting, What};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Admission, Ground, Refusal, Step};
use ledger_raft::{Input, Lane};
use ledger_rejection::{Code, Rejection};

impl World {
    /// A request arrives.
    pub(super) fn request(&mut self, id: u64, request: Request) -> Check {
        let now = self.now;
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
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
            What::Read { may_be_stale: false, .. } => self.reach(id, request, None),
        }
    }

    /// Serves a request when this node has everything that was committed when it came.
    fn reach(&mut self, id: u64, request: Request, refusal: Option<Box<Refusal>>) -> Check {
        let until = self.now + WAIT_FOR_HEIGHT;
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        running.next_context += 1;
        let context = running.next_context;
        running.reads.insert(context, Read { request, refusal, index: None, until });
        self.input(id, Input::ReadIndex { context })
    }

    /// A transaction: admitted, or refused as far as that can be said. `reached` is a height that was committed when it came.
    fn submit(&mut self, id: u64, request: Request, reached: Option<u64>) -> Check {
        let (now, reply) = (self.now, request.reply);
        let What::Submit { transaction, first_attempt } = request.what.clone() else { return Ok(()) };
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        let clock = node.clock.now(now);
        let Some(running) = node.up.as_mut() else { return Ok(()) };
        if running.disk_full {
            self.reply(id, reply, Answer::Refused(Refused::unordered(Code::DiskFull)));
            return Ok(());
        }
        let decoded = Transaction::decode(transaction.clone()).unwrap();
        let waits = running.waiters.get(&decoded.id());
        if waits.is_some_and(|waiting| waiting.encoded == transaction) {
            return self.order(id, reply, &decoded);
        }
        let tip = running.ledger.tip();
        match running.ledger.admit(transaction, clock) {
            Ok(Admission::New(transaction)) => self.order(id, reply, &transaction),
            Ok(Admission::Known(transaction, record)) => {
                self.acknowledge(id, &transaction, record.height)?;
                let (height, index, code) = (record.height, record.index, record.result.code());
                self.reply(id, reply, Answer::Verdict { height, index, code, response: record.result.response });
                Ok(())
            }
            Err(refusal) => match refusal.step(first_attempt, reached.map(Ok).as_ref()) {
                Step::Reach => self.reach(id, request, Some(refusal)),
                Step::Order => self.order(id, reply, &decoded),
                Step::Answer(reason) => {
                    let code = reason.code;
                    *self.coverage.refusals.entry(code).or_default() += 1;
                    self.note(format_args!("n{id} refuses {reply:?}: {code}"));
                    if code.is_final() && !matches!(refusal.ground, Ground::Bytes | Ground::Past) {
                        self.invariants.answered_is_seen.decided(id, tip.height, request.told)?;
                    }
                    let judged = (code == refusal.rejection.code).then_some((tip.height, clock.max(tip.time)));
                    self.reply(id, reply, Answer::Refused(Refused { code, judged }));
                    Ok(())
                }
            },
        }
    }

    /// Hands a transaction to the engine; who submitted it waits for its verdict.
    fn order(&mut self, id: u64, reply: Reply, transaction: &Transaction) -> Check {
        let now = self.now;
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let body = transaction.body();
        let chaincode = running.ledger.registry().find(&body.chaincode);
        let urgent = chaincode.is_ok_and(|chaincode| chaincode.urgent(&body.function));
        let lane = if urgent { Lane::Control } else { Lane::Data };
        running.next_waiting += 1;
        let (number, encoded) = (running.next_waiting, transaction.encoded().clone());
        let waiting = Waiting { number, lane, encoded, waiters: Vec::new() };
        let waiting = running.waiters.entry(transaction.id()).or_insert(waiting);
        waiting.waiters.push(Waiter { reply, since: now });
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
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let height = running.ledger.tip().height;
        let (mut ready, mut late, mut confirmed) = (Vec::new(), Vec::new(), Vec::new());
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
        running.reads.retain(|_, read| {
            if read.index.is_some_and(|index| index <= height) {
                confirmed.push((read.request.clone(), read.index));
            } else if now > read.until {
                late.push(read.request.reply);
            } else {
                return true;
            }
            false
        });
        for reply in late {
            self.reply(id, reply, Answer::Refused(Refused::unordered(Code::Behind)));
        }
        for (request, index) in confirmed {
            match request.what {
                What::Submit { .. } => self.submit(id, request, index)?,
                What::Read { .. } => self.answer_read(id, &request)?,
            }
        }
        ready.into_iter().try_for_each(|request| self.serve(id, request))
    }

    /// What was committed cannot be known.
    pub(super) fn read_refused(&mut self, id: u64, context: u64, reason: Rejection) {
        let running = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut());
        let Some(Read { request, refusal, .. }) = running.and_then(|running| running.reads.remove(&context)) else {
            return;
        };
        let first_attempt = matches!(request.what, What::Submit { first_attempt: true, .. });
        let code = match refusal.map(|refusal| refusal.step(first_attempt, Some(&Err(reason.clone())))) {
            Some(Step::Answer(answer)) => answer.code,
            _ => reason.code,
        };
        self.reply(id, request.reply, Answer::Refused(Refused::unordered(code)));
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
