//! The gateway of a node: admission, queries, waiting for heights (`src/gateway/`).

use super::{Event, World};
use crate::invariant::Check;
use crate::node::{Answer, Read, Refused, Reply, Request, WAIT_FOR_HEIGHT, Waiter, Waiting, What};
use ledger::{Admission, Bytes, Code};
use ledger_raft::{Input, Lane};

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
        let now = self.now;
        match &request.what {
            What::Submit(transaction) => self.submit(id, request.reply, transaction.clone()),
            What::Read { linearizable: false, .. } => {
                self.answer_read(id, &request);
                Ok(())
            }
            What::Read { linearizable: true, .. } => {
                let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
                running.next_context += 1;
                let context = running.next_context;
                running.reads.insert(context, Read { request, index: None, until: now + WAIT_FOR_HEIGHT });
                self.input(id, Input::ReadIndex { context })
            }
        }
    }

    fn submit(&mut self, id: u64, reply: Reply, transaction: Bytes) -> Check {
        let now = self.now;
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        let clock = node.clock.now(now);
        let Some(running) = node.up.as_mut() else { return Ok(()) };
        if running.disk_full {
            self.reply(id, reply, Answer::Refused(Refused::unordered(Code::DiskFull)));
            return Ok(());
        }
        let tip = running.ledger.tip();
        match running.ledger.admit(transaction, clock) {
            Ok(Admission::New(transaction)) => {
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
            Ok(Admission::Known(transaction, record)) => {
                self.acknowledge(id, &transaction, record.height)?;
                let (height, index, code) = (record.height, record.index, record.result.code());
                self.reply(id, reply, Answer::Verdict { height, index, code, response: record.result.response });
                Ok(())
            }
            Err(refusal) => {
                let code = refusal.rejection.code;
                *self.coverage.refusals.entry(code).or_default() += 1;
                let judged = Some((tip.height, clock.max(tip.time)));
                self.note(format_args!("n{id} refuses {reply:?}: {code}"));
                self.reply(id, reply, Answer::Refused(Refused { code, judged }));
                Ok(())
            }
        }
    }

    fn answer_read(&mut self, id: u64, request: &Request) {
        let What::Read { person, service, .. } = &request.what else { return };
        let Some(node) = self.nodes.get(&id) else { return };
        let Some(running) = &node.up else { return };
        let clock = node.clock.now(self.now);
        let tip = running.ledger.tip();
        let caller = &self.people.all[*person].identity;
        let answer = running.ledger.query(caller, clock, "abac", "service", &[Bytes::from(service.clone())]);
        let (code, response) = match answer {
            Ok((response, _)) => (Code::Ok, response),
            Err(fault) => (fault.code, Bytes::new()),
        };
        let judged_at = clock.max(tip.time);
        self.reply(id, request.reply, Answer::Value { height: tip.height, judged_at, code, response });
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
                confirmed.push(read.request.clone());
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
        for request in confirmed {
            self.answer_read(id, &request);
        }
        ready.into_iter().try_for_each(|request| self.serve(id, request))
    }

    /// A read cannot be confirmed.
    pub(super) fn read_refused(&mut self, id: u64, context: u64, code: Code) {
        let running = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut());
        if let Some(read) = running.and_then(|running| running.reads.remove(&context)) {
            self.reply(id, read.request.reply, Answer::Refused(Refused::unordered(code)));
        }
    }

    /// Sends an answer on its way.
    pub(super) fn reply(&mut self, id: u64, reply: Reply, answer: Answer) {
        let Some(node) = self.nodes.get(&id) else { return };
        let clock = node.clock.now(self.now);
        if let Some(at) = self.links.client(self.now, &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Event::Answer { reply, clock, answer });
        }
    }
}
