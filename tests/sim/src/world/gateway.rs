//! The gateway of a node: queries, waiting for heights (`src/clients/gateway/`). The replica makes the decisions.

use super::{Event, Timer, World};
use crate::history::Asks;
use crate::invariant::Check;
use crate::node::{Answer, Asking, Refused, Reply, Request, What};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Input;
use ledger_replica::{Event as ReplicaEvent, Known, ReadEffect, Reads, WAIT_FOR_HEIGHT};
use std::collections::VecDeque;

impl World {
    /// A request arrives.
    pub(super) fn request(&mut self, id: u64, request: Request) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        // A submission waits on its stream.
        if request.min_height > running.ledger.tip().height && matches!(request.what, What::Read { .. }) {
            running.behind.push((now + WAIT_FOR_HEIGHT, request));
            return Ok(());
        }
        self.serve(id, request)
    }

    fn serve(&mut self, id: u64, request: Request) -> Check {
        match request.what {
            What::Submit { .. } => self.arrive(id, request),
            What::Read { may_be_stale: true, .. } => self.answer_read(id, &request),
            What::Read { may_be_stale: false, .. } => {
                self.reads(id, |reads, now, out| reads.ask(now, Asking::Read(request), out))
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
        match (asking, known) {
            (Asking::Stream(stream), _) => self.current(id, stream, known.clone()),
            (Asking::Read(request), Ok(_)) => self.answer_read(id, &request),
            (Asking::Read(request), Err(reason)) => {
                self.reply(id, request.reply, Answer::Refused(Refused::unordered(reason.code)));
                Ok(())
            }
        }
    }

    fn answer_read(&mut self, id: u64, request: &Request) -> Check {
        let What::Read { asks, person, service, may_be_stale } = &request.what else { return Ok(()) };
        let Some(node) = self.nodes.get(&id) else { return Ok(()) };
        let Some(running) = &node.up else { return Ok(()) };
        let clock = node.clock.now(self.now);
        let tip = running.ledger.tip();
        let caller = &self.people.all[*person].identity;
        let service = Bytes::from(service.clone());
        let answer = match asks {
            Asks::Holders => running.ledger.query(caller, clock, "abac", "service", &[service]),
            Asks::Readers => running.ledger.query(caller, clock, "abac", "readers", &[service]),
            Asks::MayRead => running.ledger.query(caller, clock, "abac", "authorize", &[service, "subscribe".into()]),
        };
        let (code, response) = match answer {
            Ok((response, _)) => (Code::Ok, response),
            Err(fault) => (fault.code, Bytes::new()),
        };
        let judged_at = running.ledger.judged_at(clock);
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
        ready.into_iter().try_for_each(|request| self.serve(id, request))?;
        self.tend_all(id)
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
