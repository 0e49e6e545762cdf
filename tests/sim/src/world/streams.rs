//! Streams of submissions to a node (`src/clients/gateway/submit.rs`): the replica's desk and turns decide, virtual time passes.

use super::{Timer, World};
use crate::invariant::{Call as Seen, Check};
use crate::node::{Answer, Asking, Client, Looking, Refused, Request, Running, Stream, What};
use ledger::transaction::Transaction;
use ledger::{Ground, Refusal};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Lane};
use ledger_replica::gateway::{Admitting, Arrived, Call, Decision, Desk, Entrance, Item, Looked, Turned};
use ledger_replica::{Executed, Known, WAIT_FOR_HEIGHT};
use std::sync::Arc;

/// Transactions in flight at a node.
pub(super) const PLACES: usize = 64;
/// Workers of a node: one looks at data, one at control.
pub(super) const WORKERS: usize = 2;
/// Bytes of a transaction at most.
const PAYLOAD_BYTES_MAX: u64 = 1 << 20;
/// Transactions that are looked at in one turn while others wait.
const LOOKS_MAX: usize = 4;
/// Time that a look takes, microseconds.
const LOOK_TIME: u64 = 50;

impl World {
    /// A submission comes over its stream.
    pub(super) fn arrive(&mut self, id: u64, request: Request) -> Check {
        let (now, reply, told) = (self.now, request.reply, request.told);
        let who = self.clients[reply.client].person.clone();
        let What::Submit { transaction: encoded, first_attempt } = request.what else { return Ok(()) };
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let share = running.shares.of(who);
        let entrance = Entrance { ledger: &running.ledger, payload_bytes_max: PAYLOAD_BYTES_MAX, elapsed: now };
        let call = Call { encoded, min_height: request.min_height, first_attempt };
        let number = self.invariants.in_order.arrives();
        let answers = running.answers.0.clone();
        let space = &running.space;
        let entered = entrance.enter(
            call,
            &share,
            |ends| space.check(ends),
            |place| Client { reply, told, place, number, answers },
        );
        match entered {
            Ok(arrived) => {
                let lane = arrived.ticket.lane;
                self.invariants.fair_share.takes(id, share.name(), share.in_flight_of_organisation(lane), PLACES)?;
                let new = || Stream { desk: Desk::default(), share, turn: None, reaching: None };
                running.streams.entry(request.stream).or_insert_with(new).desk.take_in(arrived);
                self.tend(id, request.stream)
            }
            Err(Turned { reason, .. }) => {
                *self.coverage.refusals.entry(reason.code).or_default() += 1;
                self.reply(id, reply, Answer::Refused(Refused::unordered(reason.code)));
                Ok(())
            }
        }
    }

    /// A stream does its next job, and waits for a height or a turn if it must.
    pub(super) fn tend(&mut self, id: u64, number: u64) -> Check {
        let now = self.now;
        let Some(Running { streams, turns, ledger, .. }) = self.running(id) else { return Ok(()) };
        let Some(stream) = streams.get_mut(&number) else { return Ok(()) };
        let Some(job) = stream.desk.next() else {
            if stream.desk.is_empty() && stream.turn.is_none() {
                streams.remove(&number);
            }
            return Ok(());
        };
        let lane = job.lane();
        let mut next = None;
        if let Some(looking) = stream.turn {
            if looking.has || looking.job.lane() == Lane::Control || lane == Lane::Data {
                return Ok(());
            }
            // Something urgent came, which goes first.
            next = turns.leave(&looking.turn);
            stream.turn = None;
        }
        if stream.desk.min_height(job) > ledger.tip().height {
            let reaching = stream.reaching.filter(|(of, _)| *of == lane);
            let (_, until) = *stream.reaching.insert(reaching.unwrap_or((lane, now + WAIT_FOR_HEIGHT)));
            if now < until {
                if reaching.is_none() {
                    self.schedule_timer(id, WAIT_FOR_HEIGHT, Timer::Stream(number));
                }
                return self.has_turn(id, next);
            }
            stream.reaching = None;
            if let Some(Arrived { client, .. }) = stream.desk.give_up(lane) {
                self.reply(id, client.reply, Answer::Refused(Refused::unordered(Code::Behind)));
            }
            self.has_turn(id, next)?;
            return self.tend(id, number);
        }
        stream.reaching = None;
        let who = stream.share.applicant();
        let share = Arc::clone(&stream.share);
        let others = streams
            .values()
            .any(|other| Arc::ptr_eq(&other.share, &share) && other.turn.is_some_and(|turn| turn.job.lane() == lane));
        let taken = turns.take(lane, who);
        let has = taken.is_some();
        let turn = taken.unwrap_or_else(|| turns.wait(lane, who, number));
        if let Some(stream) = streams.get_mut(&number) {
            stream.turn = Some(Looking { turn, job, has, alone: !others, passed: 0 });
        }
        self.has_turn(id, next)?;
        if has { self.look(id, number) } else { Ok(()) }
    }

    /// Streams go on that waited for a height.
    pub(super) fn tend_all(&mut self, id: u64) -> Check {
        let Some(running) = self.running(id) else { return Ok(()) };
        let waiting = running.streams.iter().filter(|(_, stream)| stream.reaching.is_some());
        let waiting: Vec<u64> = waiting.map(|(number, _)| *number).collect();
        waiting.into_iter().try_for_each(|number| self.tend(id, number))
    }

    /// It is known whether the state is current.
    pub(super) fn current(&mut self, id: u64, number: u64, known: Known) -> Check {
        if let Some(stream) = self.running(id).and_then(|running| running.streams.get_mut(&number)) {
            stream.desk.answered(known);
        }
        self.tend(id, number)
    }

    /// The turn of a stream is over.
    pub(super) fn turn_over(&mut self, id: u64, number: u64) -> Check {
        let Some(Running { streams, turns, .. }) = self.running(id) else { return Ok(()) };
        let Some(looking) = streams.get_mut(&number).and_then(|stream| stream.turn.take()) else { return Ok(()) };
        let next = turns.leave(&looking.turn);
        self.has_turn(id, next)?;
        self.tend(id, number)
    }

    fn has_turn(&mut self, id: u64, number: Option<u64>) -> Check {
        let Some(number) = number else { return Ok(()) };
        let Some(stream) = self.running(id).and_then(|running| running.streams.get_mut(&number)) else { return Ok(()) };
        if let Some(looking) = &mut stream.turn {
            looking.has = true;
        }
        self.look(id, number)
    }

    /// A stream has a turn: it looks at some of what waits.
    fn look(&mut self, id: u64, number: u64) -> Check {
        let (now, wait_max) = (self.clocks(id), self.plan.timing.data_wait);
        let Some(Running { streams, ledger, waiters, retries, executor, space, judged: held, .. }) = self.running(id)
        else {
            return Ok(());
        };
        let tip = ledger.tip();
        let judged = (tip.height, now.clock.max(tip.time));
        let Some(stream) = streams.get_mut(&number) else { return Ok(()) };
        let Some(Looking { job, alone, passed, .. }) = stream.turn else { return Ok(()) };
        let who = stream.share.name().to_owned();
        let (budgets, organisation_bytes) = (executor.budgets(), space.organisation_bytes());
        let node = Admitting { ledger, waiters, retries, budgets, organisation_bytes, now, wait_max };
        let (mut decisions, mut looks) = (Vec::new(), 0);
        stream.desk.begin(job, &node, |decision| decisions.push(decision));
        stream.desk.work(job, &node, |looked| {
            match looked {
                Looked::Decided(decision) => decisions.push(decision),
                // One that only waits behind another is judged later.
                Looked::Held(Item { refusal: None, .. }) => {}
                Looked::Held(Item { arrived, .. }) => drop(held.insert(arrived.client.reply, judged)),
            }
            looks += 1;
            looks < LOOKS_MAX
        });
        let asks = stream.desk.asks();
        for other in streams.values_mut().filter_map(|stream| stream.turn.as_mut()) {
            other.passed += usize::from(!other.has && other.job.lane() == job.lane());
        }
        self.invariants.fair_share.looks(id, &who, alone.then_some(passed), self.people.turns_of_others(&who))?;
        self.schedule_timer(id, 1 + looks as u64 * LOOK_TIME, Timer::TurnOver(number));
        decisions.into_iter().try_for_each(|decision| self.decided(id, number, decision, judged))?;
        if asks {
            self.reads(id, |reads, now, out| reads.ask(now, Asking::Stream(number), out))?;
        }
        Ok(())
    }

    /// Carries a decision about a transaction out. `judged`: height and time of the state.
    fn decided(&mut self, id: u64, stream: u64, decision: Decision<Client>, judged: (u64, u64)) -> Check {
        match decision {
            Decision::Order(arrived) => self.order(id, stream, arrived),
            Decision::Known { client, id: transaction, record } => {
                self.acknowledge(id, &transaction, record.height)?;
                let Executed { height, index, block, result, .. } = Executed::recorded(transaction, &record);
                let (code, response) = (result.code(), result.response.clone());
                self.reply(id, client.reply, Answer::Verdict { height, index, block, code, response });
                Ok(())
            }
            Decision::Hold(_) => Ok(()),
            Decision::Refuse { client, refusal, reason } => self.refuse(id, &client, &refusal, &reason, judged),
        }
    }

    fn refuse(
        &mut self,
        id: u64,
        client: &Client,
        refusal: &Refusal,
        reason: &Rejection,
        mut judged: (u64, u64),
    ) -> Check {
        let (code, reply) = (reason.code, client.reply);
        *self.coverage.refusals.entry(code).or_default() += 1;
        self.note(format_args!("n{id} refuses {reply:?}: {code}"));
        let earlier = self.running(id).and_then(|running| running.judged.remove(&reply));
        if let (Some(then), Ground::Judged { height } | Ground::State { height }) = (earlier, refusal.ground)
            && then.0 == height
        {
            judged = then;
        }
        if code.is_final() && !matches!(refusal.ground, Ground::Bytes | Ground::Past) {
            self.invariants.answered_is_seen.decided(id, judged.0, client.told)?;
        }
        let judged = (code == refusal.rejection.code).then_some(judged);
        self.reply(id, reply, Answer::Refused(Refused { code, judged }));
        Ok(())
    }

    /// Hands a transaction to the replica; its client waits for the verdict.
    fn order(&mut self, id: u64, stream: u64, arrived: Arrived<Client>) -> Check {
        let now = self.now;
        let Arrived { transaction, ticket, client } = arrived;
        let body = transaction.body();
        let subject = Hash::of(&[body.chaincode.as_bytes(), body.args.first().map_or(&[], |arg| arg)]);
        let start = self.nodes.get(&id).map_or(0, |node| node.start);
        let call = Seen { stream: (id, start, stream), subject, lane: ticket.lane, number: client.number };
        self.invariants.in_order.ordered(call)?;
        if self.notify_robot(id, &transaction) && self.chaos && is_lost(&transaction, client.reply.attempt) {
            self.coverage.lost_stops += 1;
            self.note(format_args!("n{id} loses {} after it has notified the robot", transaction.id()));
            return Ok(());
        }
        let Some(running) = self.running(id) else { return Ok(()) };
        running.waiting.insert(client.reply, now);
        running.waiters.add(now, &transaction, ticket.lane, client);
        if running.replica.is_none() {
            let behind = Rejection::new(Code::Behind, "this node fetches blocks that it missed");
            running.waiters.refuse(&transaction.id(), &behind);
            return self.tell(id);
        }
        if std::mem::take(&mut self.forges_next) {
            self.order_forged(id, &transaction)?;
        }
        self.input(id, Input::Submit { lane: ticket.lane, transaction: transaction.encoded().clone() })
    }
}

/// Does a gateway lose this try of a stop after it has notified robots? One try in four, without a random number, so that other
/// events of a seed stay the same.
fn is_lost(stop: &Transaction, attempt: u64) -> bool {
    let [first, ..] = stop.id().0;
    u64::from(first).wrapping_add(attempt).is_multiple_of(4)
}
