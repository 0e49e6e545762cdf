//! The local server of a robot's action: goals go to the ledger, and what the robot says of them comes back.
//!
//! ROS 2 knows the answer no to a goal and to a cancelling. So whoever may not set a goal hears that at once.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::{
    gate::Passed,
    sample::{CDR_LE, Sample},
};
use tokio::time::{interval, sleep_until};

use super::{
    Stop, actions,
    actions::{
        CANCEL_REFUSED, FEEDBACK, GOAL_REFUSED, GoalId, Goals, LOST, Part, RESULT_KEY, RESULT_PATIENCE, STATUS,
        aborted, cancel_of, goal_of, goals_in, ids_in, is_accepted, is_of_no_goal, is_over, is_unknown_or_over,
        request_of, result_patience,
    },
    calls::{Account, CALLS_MAX, Handed, PATIENCE, TOO_MANY, Told, Waiting, Ways, answers_of, patience, split},
    kind::{Beside, Kind, Opened, Opening, Plan},
    silence::{self, Cause, Facts, Silence, pause},
    stopped,
};
use crate::{
    dds::{Caller, Exchange, Request, Role, Server, Writer},
    names::Interface,
    queue::Incoming,
};

/// The setting of how long a reply is waited for.
const KEY: &str = "reply_timeout_ms";
/// A sign of life is given so often within a lease, while goals run.
const ALIVE_IN_LEASE: u32 = 3;
/// Longest time between two signs of life.
const ALIVE_EVERY_MAX: Duration = Duration::from_secs(1);
/// Shortest time between two signs of life.
const ALIVE_EVERY_MIN: Duration = Duration::from_millis(100);

/// The local server of a robot's action.
pub(super) static KIND: Kind = Kind {
    name: "action_server",
    carries: Interface::Action,
    right: "publish",
    other_end: Role::Publisher,
    keys: &[KEY, RESULT_KEY],
    read: |section: &mut Section<'_, '_>, _| {
        Arc::new(Settings { patience: patience(section, KEY), results: result_patience(section) })
    },
    discovered: Some(|_terms| Arc::new(Settings { patience: PATIENCE, results: RESULT_PATIENCE })),
    silence,
    beside,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long a reply is waited for.
    patience: Duration,
    /// How long a result is waited for.
    results: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<Opened, Rejection> {
        let answers = answers_of(&opening, "action").await?;
        let Opening { route, local, service, topic, mark, counters, stop, .. } = &opening;
        let participant = local.participant();
        let server = |exchange: Exchange| participant.server(&exchange, *mark, route.sample_bytes_max);
        let servers = Servers {
            goals: server(Exchange::of_goals(topic, &route.message)?)?,
            cancels: server(Exchange::of_cancels(topic)?)?,
            results: server(Exchange::of_results(topic, &route.message)?)?,
        };
        let writer = |told: actions::Told| participant.marked_writer(&told.topic, &told.message, &told.qos, *mark);
        let feedback = writer(actions::feedback(topic, &route.message)?)?;
        let status = writer(actions::status(topic)?)?;
        let (ways, carry) = Ways::open(&opening, answers, servers.goals.matched()).await?;
        let lease = Duration::from_millis(service.lease_ms);
        let desk = Desk {
            robot: service.robot.clone(),
            servers,
            feedback,
            status,
            ways,
            waiting: Waiting::new(self.patience),
            results: Waiting::new(self.results),
            ids: BTreeMap::new(),
            goals: Goals::new(None),
            callers: BTreeMap::new(),
            alive_every: (lease / ALIVE_IN_LEASE).clamp(ALIVE_EVERY_MIN, ALIVE_EVERY_MAX),
            last: 0,
            account: Account::new(&route.service, counters.clone()),
        };
        let running = futures::future::join(carry(stop.clone()), desk.run(stop.clone()));
        Ok(Opened { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let topic = facts.topic;
    let alone = pause("no_publisher", format!("nobody is there who sets goals on {topic}"));
    let nothing = format!("nobody has set a goal on {topic} yet");
    silence::of_sending(facts, cause, (alone, "the last request has failed", nothing))
}

/// The warning about another server.
fn beside(Beside { topic, .. }: &Beside<'_>) -> Option<String> {
    Some(format!("another node serves {topic} beside this bridge: a client hears both"))
}

/// The servers of the three services.
struct Servers {
    goals: Server,
    cancels: Server,
    results: Server,
}

impl Servers {
    /// The next request. None if the middleware ended. Cancelling it loses nothing.
    async fn next(&mut self) -> Option<(Part, Request)> {
        let Self { goals, cancels, results } = self;
        let (part, request) = tokio::select! {
            request = goals.next() => (Part::Goal, request),
            request = cancels.next() => (Part::Cancel, request),
            request = results.next() => (Part::Result, request),
        };
        request.map(|request| (part, request))
    }
}

/// A request of somebody in the local graph.
struct Call {
    part: Part,
    goal: GoalId,
    caller: Caller,
    /// The transaction in which it goes to the ledger.
    id: Option<Hash>,
}

/// Knows who has set which goal.
struct Desk {
    robot: String,
    servers: Servers,
    feedback: Writer,
    status: Writer,
    ways: Ways,
    waiting: Waiting<u64, Call>,
    results: Waiting<u64, Call>,
    /// The numbers of the requests by the ids of their transactions.
    ids: BTreeMap<Hash, u64>,
    goals: Goals,
    /// The clients of the goals, as far as they are there.
    callers: BTreeMap<GoalId, Caller>,
    alive_every: Duration,
    /// The number of the last request.
    last: u64,
    account: Account,
}

impl Desk {
    /// Runs until it is told to end, or the middleware ends.
    async fn run(mut self, mut stop: Stop) {
        let mut alive = interval(self.alive_every);
        loop {
            let due = [self.waiting.due(), self.results.due()].into_iter().flatten().min();
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break,
                // Before replies: the id of a request is known before its reply can come.
                Some(told) = self.ways.told.recv() => self.hear(told),
                Some(Handed::Passed(passed)) = self.ways.handed.recv() => self.take(&passed),
                () = sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => self.expire(),
                _ = alive.tick() => self.live(),
                request = self.servers.next() => match request {
                    Some((part, request)) => self.request(part, request),
                    None => break,
                },
            }
        }
        self.ways.requests.close();
    }

    fn request(&mut self, part: Part, Request { message, caller }: Request) {
        let Some(goal) = goal_of(&message) else {
            return self.account.refuse("bad_payload", "a request of an action names a goal");
        };
        let call = Call { part, goal, caller, id: None };
        let waiting = if part == Part::Result { &self.results } else { &self.waiting };
        if waiting.is_full() || (part == Part::Goal && self.goals.is_full()) {
            self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} goals or requests have not ended"));
            return self.say_no(&call);
        }
        if part == Part::Goal && !self.goals.has(&goal) {
            self.goals.ask(goal);
            self.callers.insert(goal, call.caller.clone());
        }
        let sequence = self.submit(part, &message);
        let waiting = if part == Part::Result { &mut self.results } else { &mut self.waiting };
        waiting.insert(sequence, call, Instant::now());
    }

    /// A request goes to the ledger. Answers with its number.
    fn submit(&mut self, part: Part, message: &[u8]) -> u64 {
        let sequence = self.last.saturating_add(1);
        self.last = sequence;
        if let Ok(sample) = request_of(part, message) {
            self.ways.requests.push(Incoming::own(sample, sequence));
        }
        sequence
    }

    /// While a goal runs whose client is there, the grant is used. A goal whose client has left is cancelled, and again while the grant
    /// is used for others. It does not keep the grant itself: when the lease ends, the robot's bridge cancels it.
    fn live(&mut self) {
        self.callers.retain(|goal, _| self.goals.has(goal));
        if self.goals.is_empty() || !self.account.may_call() {
            return;
        }
        let (now, before) = (Instant::now(), self.callers.len());
        self.callers.retain(|goal, caller| {
            let is_there = self.servers.goals.is_there(caller);
            if !is_there {
                tracing::warn!(
                    robot = self.robot,
                    goal = hex::encode(goal),
                    "the client of a goal has left: it is cancelled"
                );
                self.goals.give_up(goal, now);
            }
            is_there
        });
        let is_used = !self.callers.is_empty();
        if is_used {
            let goals = self.goals.accepted().concat();
            self.submit(Part::Alive, &goals);
        }
        if is_used || self.callers.len() < before {
            for goal in self.goals.overdue(now) {
                self.submit(Part::Cancel, &cancel_of(goal));
            }
        }
    }

    fn take_call(&mut self, number: u64) -> Option<Call> {
        let call = self.waiting.take(&number).or_else(|| self.results.take(&number))?;
        if let Some(id) = call.id {
            self.ids.remove(&id);
        }
        Some(call)
    }

    fn hear(&mut self, told: Told) {
        match told {
            Told::Submitted(number, id) => {
                let call = self.waiting.get_mut(&number).or_else(|| self.results.get_mut(&number));
                if let Some(call) = call {
                    call.id = Some(id);
                    self.ids.insert(id, number);
                }
            }
            Told::Refused(number) => {
                if let Some(call) = self.take_call(number) {
                    self.say_no(&call);
                }
            }
        }
    }

    /// Tells a caller that the ledger does not let its request pass, as far as ROS 2 has words for that.
    fn say_no(&mut self, call: &Call) {
        match call.part {
            Part::Goal => {
                self.goals.answered(&call.goal, false, Instant::now());
                self.reply(call, &GOAL_REFUSED);
            }
            Part::Cancel => self.reply(call, &CANCEL_REFUSED),
            Part::Result | Part::Alive => {}
        }
    }

    fn reply(&mut self, Call { part, caller, .. }: &Call, message: &[u8]) {
        let server = match part {
            Part::Goal => &self.servers.goals,
            Part::Cancel | Part::Alive => &self.servers.cancels,
            Part::Result => &self.servers.results,
        };
        match server.reply(caller, message) {
            Ok(()) => self.account.published(),
            Err(error) => self.account.unpublished("a reply", &error),
        }
    }

    /// Takes what the robot says.
    fn take(&mut self, Passed { creator, samples, .. }: &Passed) {
        if self.account.refuses(creator, &self.robot) {
            return;
        }
        for (id, message) in samples.iter().filter_map(split) {
            match id {
                FEEDBACK => {
                    if goal_of(&message).is_some_and(|goal| self.goals.has(&goal)) {
                        self.tell(&message, |desk| &desk.feedback);
                    }
                }
                STATUS => {
                    for stated in goals_in(&message).iter().filter(|stated| stated.is_over()) {
                        self.goals.ended(&stated.goal);
                    }
                    self.tell(&message, |desk| &desk.status);
                }
                LOST => ids_in(&message).for_each(|goal| self.lose(&goal)),
                id => {
                    // Replies to others are for other bridges.
                    let Some(call) = self.ids.get(&id).copied().and_then(|number| self.take_call(number)) else {
                        continue;
                    };
                    self.learn(&call, &message);
                    self.reply(&call, &message);
                }
            }
        }
    }

    /// Publishes what the robot says to all.
    fn tell(&mut self, message: &Bytes, to: impl Fn(&Self) -> &Writer) {
        let written = Sample::new(CDR_LE, message).map_err(crate::error::Error::sample);
        match written.and_then(|sample| to(self).write(&sample)) {
            Ok(()) => self.account.published(),
            Err(error) => self.account.unpublished("feedback or a state", &error),
        }
    }

    /// A reply tells how a goal stands.
    fn learn(&mut self, call: &Call, message: &[u8]) {
        match call.part {
            Part::Goal => {
                if self.goals.answered(&call.goal, is_accepted(message), Instant::now()) {
                    self.submit(Part::Cancel, &cancel_of(call.goal));
                }
            }
            Part::Result if message.first().is_some_and(|state| is_over(*state)) => {
                self.goals.ended(&call.goal);
            }
            Part::Result | Part::Cancel if is_of_no_goal(call.part, message) => self.lose(&call.goal),
            // Its last state may still be on its way.
            Part::Cancel if is_unknown_or_over(message) => {
                self.goals.lose(&call.goal);
            }
            Part::Result | Part::Cancel | Part::Alive => {}
        }
    }

    /// The robot does not know a goal any more: its client hears that it was aborted. A result cannot be made up, because its type is
    /// not known here.
    fn lose(&mut self, goal: &GoalId) {
        if self.goals.lose(goal) {
            tracing::warn!(
                robot = self.robot,
                goal = hex::encode(goal),
                "the robot has lost a goal: it counts as aborted"
            );
            self.tell(&Bytes::copy_from_slice(&aborted(*goal)), |desk| &desk.status);
        }
    }

    /// Gives up what nobody has answered. A goal of which its client hears that it is refused does not run: it is cancelled.
    fn expire(&mut self) {
        let now = Instant::now();
        for call in self.waiting.expire(now).into_iter().chain(self.results.expire(now)) {
            if let Some(id) = call.id {
                self.ids.remove(&id);
            }
            self.account.refuse("no_reply", "the robot has not replied in time");
            if call.part == Part::Goal {
                self.submit(Part::Cancel, &cancel_of(call.goal));
            }
            self.say_no(&call);
        }
    }
}
