//! A robot's bridge (`crates/ros-bridge/src/routes/delivery.rs`): the real guard decides, virtual time passes.

mod question;
mod stream;
mod untruth;

pub use untruth::Untruth;

use super::{Event, World};
use crate::client::{BRIDGE, Client};
use crate::clock::SECOND;
use crate::confidential::{SERVICE, pair};
use crate::invariant::{Check, Passed, Violation};
use crate::robot::{ANSWER_MAX, CONFIDENTIAL, Delivery, IDENTITY, QUIET_MAX, ROBOTS, Robot, Step};
use ledger::network::Genesis;
use ledger::transaction::Transaction;
use ledger_base::rejection::Rejection;
use ledger_confidential::Keyring;
use ledger_gate::gate::Refused;
use ledger_gate::guard::{Act, Block, Told};
use ledger_light::Proof;
use testkit::Random;

/// For how long a gate believes a block time that its node has made up, microseconds.
const WRONG_TIME_MAX: u64 = 10 * SECOND;

/// After so long without faults no delay of before counts any more, microseconds.
const CALM: u64 = 5 * SECOND;

/// Something that happens to a robot, or at a node for it.
pub(crate) enum Happening {
    /// The robot looks after itself.
    Wake,
    /// Its bridge dies, and starts again.
    Restart,
    /// A node looks whether there is something to deliver.
    Look { stream: u64 },
    /// A delivery arrives.
    Delivered { stream: u64, delivery: Delivery },
    /// A stream is lost.
    Lost { stream: u64 },
    /// A node is asked for the proof of an answer.
    Prove { question: u64, height: u64, index: u32, until: u64 },
    /// The proof of an answer arrives, with the way to it.
    Proved { question: u64, proof: Proof, way: Vec<Step> },
}

impl World {
    /// Some networks have a robot that is looked at.
    pub(super) fn build_robot(&mut self, seed: u64) {
        let mut random = Random::new(seed, "robot");
        if random.percent(80) {
            let governance = Genesis::governance(&self.genesis).unwrap();
            let robot = random.pick(&ROBOTS).copied().unwrap_or(ROBOTS[0]);
            let robot = if self.plan.confidential { CONFIDENTIAL } else { robot };
            let client = self.clients.len();
            self.clients.push(Client::for_robot(IDENTITY));
            let offset = random.below(2 * SECOND) as i64 - SECOND as i64;
            let mut robot = Robot::new(robot, client, offset, governance);
            robot.liar = random.percent(70).then(|| 1 + random.below(self.plan.voters + self.plan.learners));
            self.robot = Some(Box::new(robot));
            self.happens(random.between(SECOND, 3 * SECOND), Happening::Wake);
            if random.percent(60) {
                self.happens(random.between(5 * SECOND, 20 * SECOND), Happening::Restart);
            }
        }
        self.random.robot = random;
    }

    /// Schedules something for the robot.
    fn happens(&mut self, delay: u64, happening: Happening) {
        self.schedule(delay, Event::Robot(happening));
    }

    /// Something happens to the robot, or at a node for it.
    pub(super) fn robot_event(&mut self, happening: Happening) -> Check {
        let Some(mut robot) = self.robot.take() else { return Ok(()) };
        let done = self.robot_goes_on(&mut robot, happening).and_then(|()| self.look_after(&mut robot));
        self.robot = Some(robot);
        done
    }

    fn robot_goes_on(&mut self, robot: &mut Robot, happening: Happening) -> Check {
        // By the clock, before anything else is looked at.
        self.stop_what_is_overdue(robot);
        match happening {
            Happening::Wake => robot.wakes_at = u64::MAX,
            Happening::Restart => self.restart(robot),
            Happening::Look { stream } => self.look_for(robot, stream),
            Happening::Delivered { stream, delivery } => return self.delivered(robot, stream, &delivery),
            Happening::Lost { stream } => self.lost(robot, stream),
            Happening::Prove { question, height, index, until } => self.prove(robot, question, (height, index), until),
            Happening::Proved { question, proof, way } => return self.proved(robot, question, proof, way),
        }
        Ok(())
    }

    /// A bridge looks after everything that is due, and waits for the next thing.
    fn look_after(&mut self, robot: &mut Robot) -> Check {
        for watched in &robot.watched {
            if let Some(fault) = watched.guard.gate().fault() {
                return Err(Violation::new("gate", fault));
            }
            if watched.guard.gate().is_moving() {
                self.invariants.gate.moves(watched.id, self.now)?;
            }
        }
        let silent = robot.stream.as_ref().is_some_and(|stream| self.now >= stream.heard + QUIET_MAX);
        if silent || robot.stream.is_none() {
            self.connect(robot);
        }
        if robot.question.as_ref().is_some_and(|question| self.now >= question.asked + ANSWER_MAX) {
            self.unanswered(robot, None)?;
            // Another node may answer.
            self.connect(robot);
        }
        self.ask_what_is_due(robot)?;
        let due = robot.due(self.now).max(self.now + 1);
        if due < robot.wakes_at {
            robot.wakes_at = due;
            self.schedule_at(due, Event::Robot(Happening::Wake));
        }
        Ok(())
    }

    fn stop_what_is_overdue(&mut self, robot: &mut Robot) {
        let now = robot.clocks(self.now);
        for at in 0..robot.watched.len() {
            if let Some(reason) = robot.watched[at].guard.overdue(now) {
                self.stopped(robot.watched[at].id, reason);
            }
        }
    }

    fn stopped(&mut self, service: &str, reason: &'static str) {
        *self.coverage.stops.entry(reason).or_default() += 1;
        self.note(format_args!("robot: {service} is stopped: {reason}"));
    }

    fn restart(&mut self, robot: &mut Robot) {
        if !self.chaos {
            return;
        }
        self.coverage.reopened += 1;
        self.note(format_args!("robot: its bridge starts anew"));
        let services: Vec<_> = robot.watched.iter().map(|watched| watched.id).collect();
        let founded = Genesis::governance(&self.genesis).unwrap();
        robot.open(&services, &founded, self.now);
        let next = self.random.robot.between(5 * SECOND, 30 * SECOND);
        self.happens(next, Happening::Restart);
    }

    /// The robot's node delivers a block.
    fn delivered(&mut self, robot: &mut Robot, stream: u64, delivery: &Delivery) -> Check {
        let Some(open) = robot.stream.as_mut().filter(|open| open.number == stream) else { return Ok(()) };
        open.heard = self.now;
        if !delivery.early {
            robot.next = robot.next.max(delivery.height.saturating_add(1));
        }
        let now = robot.clocks(self.now);
        if !delivery.heads.is_empty() {
            let (from, to) = (delivery.height + 1 - delivery.heads.len() as u64 / 8, delivery.height);
            let before = robot.heads.filter(|(_, last)| from <= last + 1);
            robot.heads = Some(before.map_or((from, to), |(first, last)| (first, last.max(to))));
        }
        if !self.chaos {
            robot.calm_since.get_or_insert(self.now);
        }
        for event in &delivery.events {
            // Whatever passes is one of these.
            if let Ok(transaction) = Transaction::decode(event.transaction.clone())
                && let Some(payload) = transaction.body().args.get(3)
            {
                let message = self.sealed.get(payload).unwrap_or(payload).clone();
                robot.told.insert(message, transaction);
            }
        }
        if delivery.early {
            self.coverage.early_stops += 1;
            let stops = delivery.events.iter().filter_map(|event| Transaction::decode(event.transaction.clone()).ok());
            self.invariants.gate.notified(robot.openings, stops.map(|stop| stop.call_ref()));
        }
        for at in 0..robot.watched.len() {
            let mut acts = Vec::new();
            let watched = &mut robot.watched[at];
            if !delivery.early {
                watched.guard.heard(delivery.time, now);
                watched.guard.heads(delivery.height, &delivery.heads, now);
            }
            let mut block = Block::new(delivery.height, delivery.time);
            let wanted = delivery
                .events
                .iter()
                .filter(|event| event.chaincode == "msp" || event.subject == watched.id || event.subject == robot.name);
            for event in wanted {
                let told = Told {
                    index: event.index,
                    chaincode: &event.chaincode,
                    name: &event.name,
                    payload: &event.payload,
                    transaction: &event.transaction,
                    certificate: &event.certificate,
                };
                let act = watched.guard.told(&mut block, &told, now);
                if let Some(Act::Refused { refused, .. }) = &act
                    && let Ok(transaction) = Transaction::decode(event.transaction.clone())
                    && robot.calm_since.is_some_and(|calm| self.now >= calm + CALM)
                    && is_by_block(robot.heads, &transaction)
                {
                    self.invariants.gate.refused(watched.id, &transaction, *refused, self.now)?;
                }
                acts.extend(act);
            }
            self.act(robot, at, acts)?;
        }
        Ok(())
    }

    /// Carries out what the guard of a service says.
    fn act(&mut self, robot: &mut Robot, at: usize, acts: Vec<Act>) -> Check {
        let (service, wall) = (robot.watched[at].id, robot.clocks(self.now).wall);
        for act in acts {
            match act {
                Act::Stop(reason) => self.stopped(service, reason),
                Act::Refused { refused, .. } => {
                    *self.coverage.gate.entry(refused.name()).or_default() += 1;
                    let opened = robot.stream.as_ref().map_or(u64::MAX, |stream| stream.opened);
                    if refused == Refused::UnknownCreator && self.now >= opened.saturating_add(SECOND) {
                        // A new stream shows the certificates again.
                        robot.stream = None;
                    }
                    if refused == Refused::NoKey {
                        self.fetch_content_keys(robot);
                    }
                    self.note(format_args!("robot: {service} lets a message not pass: {}", refused.name()));
                }
                Act::Publish(passed) => {
                    for sample in passed.samples {
                        let Some(transaction) = robot.told.get(sample.wire()) else {
                            return Err(Violation::new("gate", format!("{service}: nobody told of {sample:?}")));
                        };
                        *self.coverage.gate.entry("passed").or_default() += 1;
                        if service == SERVICE {
                            self.coverage.confides("sealed message passed a gate");
                        }
                        let creator = self.people.by_fingerprint(&transaction.creator());
                        let who = creator.map(crate::people::Person::id).unwrap_or_default();
                        let id = transaction.id();
                        self.trace.note(self.now, format_args!("robot: {service} lets {id} of {who} pass"));
                        let (opening, now) = (robot.openings, self.now);
                        let by_block = is_by_block(robot.heads, transaction);
                        self.invariants.gate.passed(&Passed { opening, service, transaction, now, wall, by_block })?;
                        if !self.chaos {
                            robot.passed.insert((service.to_owned(), who));
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// The robot reads the content keys of before from the blocks of its node (`crates/ros-bridge/src/routes/delivery/reader_keys.rs`).
    fn fetch_content_keys(&mut self, robot: &mut Robot) {
        let Some(watched) = robot.watched.iter_mut().find(|watched| watched.id == SERVICE) else { return };
        let tip = robot.stream.as_ref().and_then(|stream| self.tip(stream.node)).map_or(0, |tip| tip.0);
        let mut keyring = Keyring::new(self.network, BRIDGE.to_owned(), pair(BRIDGE, 0));
        for block in self.blocks.iter().take(tip as usize) {
            let outcome = &block.outcome;
            for emitted in outcome.events.iter().filter(|emitted| emitted.event.name == "keyed") {
                let transaction = emitted.index.and_then(|index| outcome.transactions.get(index as usize));
                let transaction = transaction.and_then(|bytes| Transaction::decode(bytes.clone()).ok());
                let Some((transaction, share)) = transaction.and_then(|signed| {
                    serde_json::from_slice(signed.body().args.get(2)?).ok().map(|share| (signed, share))
                }) else {
                    continue;
                };
                let publisher = self.people.by_fingerprint(&transaction.creator()).map(crate::people::Person::id);
                keyring.learn(SERVICE, &publisher.unwrap_or_default(), outcome.header.height, &share);
            }
        }
        watched.guard.read_with(keyring);
    }

    /// Nobody says how the robot stands. `gone`: because there is no such robot.
    fn unanswered(&mut self, robot: &mut Robot, gone: Option<&Rejection>) -> Check {
        let Some(question) = robot.question.take() else { return Ok(()) };
        self.note(format_args!("robot: question {} is not answered", question.number));
        for (at, _) in waited(robot, question.asked) {
            robot.watched[at].guard.unanswered(None);
            if gone.is_some() {
                self.no_service(robot, at)?;
            }
        }
        Ok(())
    }

    fn no_service(&mut self, robot: &mut Robot, at: usize) -> Check {
        let now = robot.clocks(self.now);
        let acts = robot.watched[at].guard.gone(now);
        self.act(robot, at, acts)?;
        if robot.watched[at].guard.gate().is_moving() {
            robot.watched[at].guard.stopped(now);
            self.stopped(robot.watched[at].id, "no_service");
        }
        Ok(())
    }

    /// Is it over what lies of the storm may do to a robot? No question of then waits for an answer, and a wrong block time is
    /// forgotten.
    pub fn robot_is_free(&self) -> bool {
        let Some(robot) = &self.robot else { return true };
        let waits = robot.question.as_ref().is_some_and(|question| question.asked < self.plan.chaos);
        !waits && (robot.liar.is_none() || self.now > self.plan.chaos + WRONG_TIME_MAX)
    }

    /// Has the robot let a message of this person pass through every service, since everything was healed? One that began with the
    /// genesis, and finds no node any more that shows it the way from there, needs a checkpoint.
    pub fn robot_obeys(&self, who: &str) -> bool {
        self.robot.as_ref().is_none_or(|robot| {
            // Of a service for everybody numbers count over all epochs, also those that its publisher has signed for a liar.
            let mut exclusive = robot.watched.iter().filter(|watched| watched.id.ends_with("/cmd_vel"));
            robot.lost || exclusive.all(|watched| robot.passed.contains(&(watched.id.to_owned(), who.to_owned())))
        })
    }
}

/// Takes the services out that wait for an answer as old as this.
fn waited(robot: &mut Robot, asked: u64) -> Vec<(usize, u64)> {
    let (served, waiting) = std::mem::take(&mut robot.waiting).into_iter().partition(|(_, since)| *since <= asked);
    robot.waiting = waiting;
    served
}

/// Does the gate measure the age of the message by the block that it names? `heads`: the blocks of which it was told.
fn is_by_block(heads: Option<(u64, u64)>, transaction: &Transaction) -> bool {
    let named = transaction.body().known_block.as_ref();
    heads.zip(named).is_some_and(|((first, _), named)| named.height >= first)
}
