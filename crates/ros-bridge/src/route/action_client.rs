//! The robot's side of actions: goals that pass the gate are set here, and what the robot says of them goes to the ledger.
//!
//! A goal whose right has ended is cancelled, and again each second until the robot says that it has ended. So is a goal that an
//! earlier bridge has left, and one whose server has left and comes back.

mod earlier;
mod said;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_contract::replies;
use ledger_gate::{gate::Passed, sample::Sample, service::Service};
use tokio::{
    sync::{mpsc, watch},
    time::{sleep_until, timeout},
};

use self::{earlier::Earlier, said::Said};
use super::{
    Clocks, Stop,
    actions::{
        FEEDBACK, GoalId, Goals, LOST, Part, RESULT_KEY, RESULT_PATIENCE, RUN_MS_MAX, STATUS, cancel_of, feedback,
        goal_of, goals_in, ids_in, is_accepted, is_of_no_goal, is_over, is_unknown_or_over, result_patience,
        split_request, status,
    },
    calls::{Account, CALLS_MAX, Hand, Handed, PATIENCE, TOO_MANY, Waiting, patience, reply_to},
    kind::{self, Beside, Kind, Opened, Opening, Plan, STALE_AFTER, STALE_KEY},
    silence::{Cause, Facts, Silence, fault, pause},
    stopped,
};
use crate::{
    count::Counters,
    dds::{Client, Exchange, Number, Reader, Reply, Role},
    door::Door,
    error::Error,
    names::Interface,
    queue::{Incoming, Limits, Queue},
    standing::Asker,
};

/// The setting of how long the server is waited for.
const KEY: &str = "server_timeout_ms";
/// The setting of how long a goal may run.
const GOAL_KEY: &str = "goal_timeout_ms";
/// The setting of how often feedback goes to the ledger.
const RATE_KEY: &str = "feedback_rate_hz";
/// Shortest `goal_timeout_ms`.
const GOAL_MS_MIN: u64 = 100;
/// Highest `feedback_rate_hz`.
const RATE_HZ_MAX: u64 = 1000;
const RATE_HZ_DEFAULT: u32 = 10;
/// Most replies and feedback that wait to go to the ledger.
const ANSWERS_MAX: usize = 4 * CALLS_MAX;
/// How long the bridge waits for the server at its end, when goals are cancelled.
const FAREWELL_MAX: Duration = Duration::from_millis(500);
/// Between two looks whether there is a server still.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A client of the robot's own action.
pub(super) static KIND: Kind = Kind {
    name: "action_client",
    carries: Interface::Action,
    right: "subscribe",
    other_end: Role::Subscriber,
    keys: &[KEY, RESULT_KEY, GOAL_KEY, RATE_KEY, STALE_KEY],
    read: |section: &mut Section<'_, '_>, _| Arc::new(Settings::read(section)),
    discovered: Some(|_terms| {
        Arc::new(Settings {
            patience: PATIENCE,
            results: RESULT_PATIENCE,
            goal: None,
            feedback_every: Duration::from_secs(1) / RATE_HZ_DEFAULT,
            stale_after: STALE_AFTER,
        })
    }),
    silence,
    beside,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long the server is waited for.
    patience: Duration,
    /// How long a result is waited for.
    results: Duration,
    /// How long a goal may run; none for as long as it takes.
    goal: Option<Duration>,
    /// Between two times that feedback goes to the ledger.
    feedback_every: Duration,
    /// Silence of the ledger after which goals are cancelled.
    stale_after: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    fn read(section: &mut Section<'_, '_>) -> Self {
        let (mut goal_ms, mut rate_hz) = (None, RATE_HZ_DEFAULT);
        section.integer(GOAL_KEY, GOAL_MS_MIN..=RUN_MS_MAX, &mut goal_ms);
        section.integer(RATE_KEY, 1..=RATE_HZ_MAX, &mut rate_hz);
        Self {
            patience: patience(section, KEY),
            results: result_patience(section),
            goal: goal_ms.map(Duration::from_millis),
            feedback_every: Duration::from_secs(1) / rate_hz.max(1),
            stale_after: kind::stale_after(section),
        }
    }

    async fn join(&self, opening: Opening<'_>) -> Result<Opened, Rejection> {
        let Opening { route, gateway, local, service, topic, mark, counters, stop, .. } = &opening;
        let (came, clocks) = (Instant::now(), Clocks::start());
        let earlier = Earlier::new(Some(clocks.now().wall));
        let participant = local.participant();
        let client = |exchange: Exchange| participant.client(&exchange, *mark, route.sample_bytes_max);
        let clients = Clients {
            goals: client(Exchange::of_goals(topic, &route.message)?)?,
            cancels: client(Exchange::of_cancels(topic)?)?,
            results: client(Exchange::of_results(topic, &route.message)?)?,
        };
        let max_age = Duration::from_millis(service.max_age_ms);
        let reader = |told: super::actions::Told| {
            let limits = Limits { queue_samples_max: CALLS_MAX, ..route.limits() };
            let door = Arc::new(Door::new(*mark, &route.service, max_age, Arc::clone(local.delivered())));
            participant.reader_behind(&told.topic, &told.message, &told.qos, limits, door)
        };
        let (feedback, status) = (reader(feedback(topic, &route.message)?)?, reader(status(topic)?)?);
        counters.opened(clients.goals.matched(), None);
        let answers = Queue::new(&Limits { queue_samples_max: ANSWERS_MAX, ..route.limits() });
        let (gateway, of_replies, answered) =
            (Arc::clone(gateway), Counters::new(route).traced(counters.tracer.clone()), replies(&route.service));
        let to = kind::submitted(gateway, &answered, Arc::clone(&answers), None, of_replies).await?;
        let (hand, handed, rests) = Hand::until_rest(clients.goals.matched().clone(), self.stale_after);
        let from = kind::gated(&opening, service.clone(), hand, counters.clone()).await?;
        let is_used = may_be_used(service.clone(), Arc::clone(&opening.asker), came);
        let desk = Desk {
            clients,
            feedback,
            status,
            handed,
            rests,
            known: 0,
            answers,
            waiting: Waiting::new(self.patience),
            results: Waiting::new(self.results),
            goals: Goals::new(self.goal),
            servers: 0,
            earlier,
            clocks,
            said: Said::new(self.feedback_every),
            last: 0,
            account: Account::new(&route.service, counters.clone()),
            service: route.service.clone(),
        };
        let running = futures::future::join3(to(stop.clone()), from(stop.clone()), desk.run(stop.clone(), is_used));
        Ok(Opened { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// May goals have been set through the ledger before that moment? Where the voters do not say how the service stands, they may.
async fn may_be_used(service: Service, asker: Arc<Asker>, since: Instant) -> bool {
    let is_new = |service: &Service| service.epoch == 0 && service.needs_grant();
    if !is_new(&service) {
        return true;
    }
    let answer = asker.ask(since).await;
    let certified = answer.and_then(|answered| answered.standing.service(&service.service));
    !certified.is_ok_and(|certified| is_new(&certified))
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let Facts { service, topic, .. } = facts;
    match cause {
        Cause::Alone => pause("no_subscriber", format!("no action server is there for {topic}")),
        Cause::Refused { line, .. } => fault("gate", format!("the last request has failed: {line}")),
        Cause::NotHeld => pause("no_holder", format!("nobody holds {service}")),
        Cause::NothingCame => pause("no_message", "nobody has set a goal yet".to_owned()),
    }
}

/// The warning about another client.
fn beside(Beside { topic, is_same_service, .. }: &Beside<'_>) -> Option<String> {
    Some(if *is_same_service {
        format!("another bridge sets goals on {topic} too: each goal is set twice; stop one of both")
    } else {
        format!("a client beside this bridge of {topic}: its goals go around the ledger")
    })
}

/// A call of the server under way.
enum Call {
    /// For a request on the ledger, with the goal that it sets or asks about.
    Passed { request: Hash, part: Part, goal: Option<GoalId> },
    /// A cancelling of the bridge's own.
    Own(GoalId),
    /// A question of the bridge's own, whether the server knows the goal: for its result.
    Asked(GoalId),
}

/// The clients of the three services.
struct Clients {
    goals: Client,
    cancels: Client,
    results: Client,
}

impl Clients {
    /// The next reply. None if the middleware ended. Cancelling it loses nothing.
    async fn next(&mut self) -> Option<(Part, Reply)> {
        let Self { goals, cancels, results } = self;
        let (part, reply) = tokio::select! {
            reply = goals.next() => (Part::Goal, reply),
            reply = cancels.next() => (Part::Cancel, reply),
            reply = results.next() => (Part::Result, reply),
        };
        reply.map(|reply| (part, reply))
    }
}

/// Knows which goals run, and which request each call of the server is for.
struct Desk {
    clients: Clients,
    feedback: Reader,
    status: Reader,
    handed: mpsc::Receiver<Handed>,
    /// Tells the gate when the robot rests, by the number of messages that are known here.
    rests: watch::Sender<u64>,
    known: u64,
    answers: Arc<Queue>,
    waiting: Waiting<(Part, Number), Call>,
    results: Waiting<(Part, Number), Call>,
    goals: Goals,
    /// How many servers there were at the last look.
    servers: usize,
    earlier: Earlier,
    clocks: Clocks,
    said: Said,
    /// The number of the last message to the ledger.
    last: u64,
    account: Account,
    service: String,
}

impl Desk {
    /// Runs until it is told to end, or the middleware ends. Then the goals that run are cancelled. `is_used`: may goals have been set
    /// before? Nothing passes the gate until the voters have answered, so this waits for them, too.
    async fn run(mut self, mut stop: Stop, is_used: impl Future<Output = bool>) {
        tokio::select! {
            () = stopped(&mut stop) => {}
            is_used = is_used => if !is_used {
                self.earlier = Earlier::new(None);
            }
        }
        let mut look = tokio::time::interval(LOOK_EVERY);
        loop {
            let late = [self.waiting.due(), self.results.due(), self.goals.due()].into_iter().flatten().min();
            let said = self.said.due();
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break,
                // A stop before what the robot says, however much that is.
                Some(handed) = self.handed.recv() => match handed {
                    Handed::Passed(passed) => {
                        self.known = self.known.saturating_add(1);
                        self.request(&passed);
                    }
                    Handed::Stop(reason) => self.stop(reason),
                },
                reply = self.clients.next() => match reply {
                    Some((part, reply)) => self.reply(part, &reply),
                    None => break,
                },
                () = sleep_until(late.unwrap_or_else(Instant::now).into()), if late.is_some() => self.expire(),
                () = sleep_until(said.unwrap_or_else(Instant::now).into()), if said.is_some() => self.say(),
                _ = look.tick() => self.look(),
                Some(status) = self.status.next() => self.state(&status),
                Some(feedback) = self.feedback.next() => self.hear(&feedback.sample),
            }
            if self.goals.rests() {
                self.rests.send_if_modified(|rests| std::mem::replace(rests, self.known) != self.known);
            }
        }
        self.stop("shutdown");
        // The server may have heard of a goal whose acceptance is under way.
        let farewell = async {
            while !self.waiting.is_empty()
                && let Some((part, reply)) = self.clients.next().await
            {
                self.reply(part, &reply);
            }
        };
        if timeout(FAREWELL_MAX, farewell).await.is_err() {
            tracing::warn!(service = self.service, "the robot has not confirmed that every goal is cancelled");
        }
        self.answers.close();
    }

    fn request(&mut self, Passed { transaction, samples, .. }: &Passed) {
        // A reply names a transaction, so there is one request in each.
        let [sample] = samples.as_slice() else {
            return self.account.refuse("several_calls", "a transaction has more than one request");
        };
        let Some((part, message)) = split_request(sample) else {
            return self.account.refuse("bad_payload", "it is no request of an action");
        };
        let goal = goal_of(&message);
        let waiting = if part == Part::Result { &self.results } else { &self.waiting };
        let is_full = waiting.is_full() || (part == Part::Goal && self.goals.is_full());
        match (part, goal) {
            (Part::Alive, _) => return self.tell_lost(&message),
            (_, None) => return self.account.refuse("bad_payload", "a request of an action names a goal"),
            _ if is_full => {
                return self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} goals or requests have not ended"));
            }
            (Part::Goal, Some(goal)) => self.goals.ask(goal),
            (Part::Cancel | Part::Result, Some(_)) => {}
        }
        let is_made = self.call(part, &message, Call::Passed { request: *transaction, part, goal });
        if let (Part::Goal, Some(goal), false) = (part, goal, is_made) {
            self.goals.answered(&goal, false, Instant::now());
        }
    }

    /// Tells a user's bridge which of the goals that it keeps the grant for are lost: else it would keep it for ever.
    fn tell_lost(&mut self, alive: &[u8]) {
        let lost: Vec<GoalId> = ids_in(alive).filter(|goal| self.goals.has_lost(goal)).collect();
        if !lost.is_empty() {
            // A goal that has just ended is not lost: its last state comes first.
            self.say();
            self.submit(LOST, &lost.concat());
        }
    }

    /// Calls the server. False if there is none.
    fn call(&mut self, part: Part, message: &[u8], call: Call) -> bool {
        let client = match part {
            Part::Goal => &mut self.clients.goals,
            Part::Cancel | Part::Alive => &mut self.clients.cancels,
            Part::Result => &mut self.clients.results,
        };
        match client.call(message) {
            Ok(number) => {
                let waiting = if part == Part::Result { &mut self.results } else { &mut self.waiting };
                waiting.insert((part, number), call, Instant::now());
                self.account.published();
                return true;
            }
            Err(Error::Unserved(explained)) => self.account.refuse("no_server", &explained.what),
            Err(error) => self.account.unpublished("a request", &error),
        }
        false
    }

    /// Cancels goals for a reason of the bridge's own.
    fn cancel(&mut self, goals: &[GoalId], reason: &'static str) {
        for goal in goals {
            tracing::warn!(service = self.service, goal = hex::encode(goal), reason, "a goal is cancelled");
            self.call(Part::Cancel, &cancel_of(*goal), Call::Own(*goal));
        }
    }

    fn stop(&mut self, reason: &'static str) {
        let goals = self.goals.stop(Instant::now());
        self.cancel(&goals, reason);
    }

    fn reply(&mut self, part: Part, Reply { number, message }: &Reply) {
        let call = self.waiting.take(&(part, *number)).or_else(|| self.results.take(&(part, *number)));
        match call {
            None => {}
            Some(Call::Own(goal)) if is_unknown_or_over(message) => {
                self.goals.ended(&goal);
            }
            Some(Call::Own(goal)) if message.first() == Some(&1) => {
                let goal = hex::encode(goal);
                tracing::error!(service = self.service, goal, "THE ROBOT REFUSES TO CANCEL A GOAL");
            }
            Some(Call::Asked(goal)) if is_of_no_goal(part, message) => {
                self.goals.lose(&goal);
            }
            Some(Call::Own(_) | Call::Asked(_)) => {}
            Some(Call::Passed { request, part, goal }) => {
                if let Some(goal) = goal {
                    self.learn(part, goal, message);
                }
                self.submit(request, message);
            }
        }
    }

    /// A reply tells how a goal stands.
    fn learn(&mut self, part: Part, goal: GoalId, message: &[u8]) {
        if part == Part::Goal {
            if self.goals.answered(&goal, is_accepted(message), Instant::now()) {
                self.cancel(&[goal], "stopped before it was accepted");
            }
        } else if part == Part::Result && message.first().is_some_and(|state| is_over(*state)) {
            // What was said of it comes before its result.
            self.goals.ended(&goal);
            self.say();
        }
    }

    /// Takes the states of the goals, and passes them on while some of them are of the ledger's, or may have been.
    fn state(&mut self, Incoming { sample, source, .. }: &Incoming) {
        let Some(message) = super::calls::message_of(sample) else { return };
        let (was_empty, states) = (self.goals.is_empty(), goals_in(&message));
        for stated in states.iter().filter(|stated| stated.is_over()) {
            self.goals.ended(&stated.goal);
        }
        let earlier = self.earlier.look(*source, &states, self.clocks.now().wall);
        if !was_empty || earlier.is_some() {
            self.keep(STATUS, GoalId::default(), message);
        }
        for goal in earlier.into_iter().flatten() {
            if self.goals.found(goal, Instant::now()) {
                self.cancel(&[goal], "it ran when the bridge came");
            }
        }
    }

    fn hear(&mut self, sample: &Sample) {
        let Some(message) = super::calls::message_of(sample) else { return };
        if let Some(goal) = goal_of(&message).filter(|goal| self.goals.has(goal)) {
            self.keep(FEEDBACK, goal, message);
        }
    }

    fn keep(&mut self, what: Hash, goal: GoalId, message: Bytes) {
        let thinned = self.said.keep(what, goal, message, Instant::now());
        self.account.thinned(u64::from(thinned));
    }

    /// Hands over to the ledger whatever was said.
    fn say(&mut self) {
        for (what, message) in self.said.take(Instant::now()) {
            self.submit(what, &message);
        }
    }

    fn submit(&mut self, request: Hash, message: &[u8]) {
        let Ok(sample) = reply_to(request, message) else { return };
        let sequence = self.last.saturating_add(1);
        self.last = sequence;
        self.answers.push(Incoming::own(sample, sequence));
    }

    /// Gives up what nobody has answered, and cancels what runs for too long.
    fn expire(&mut self) {
        let now = Instant::now();
        for call in self.waiting.expire(now).into_iter().chain(self.results.expire(now)) {
            if let Call::Passed { part: Part::Goal, goal: Some(goal), .. } = call {
                self.goals.unanswered(&goal, now);
            }
            self.account.refuse("no_reply", "the action server has not replied in time");
        }
        let overdue = self.goals.overdue(now);
        self.cancel(&overdue, "it has not ended in time");
    }

    /// A server that has left may only stand still: when it comes back, its goals are cancelled. Where another one has taken its place
    /// meanwhile, that one is asked which goals it knows.
    fn look(&mut self) {
        let servers = self.clients.goals.matched().now().matched;
        let before = std::mem::replace(&mut self.servers, servers);
        if servers > 0 {
            let back = self.goals.come_back(Instant::now());
            self.cancel(&back, "its server has come back");
            let asked = if servers == 1 && before > 1 { self.goals.accepted() } else { Vec::new() };
            for goal in asked {
                self.call(Part::Result, &goal, Call::Asked(goal));
            }
        } else if self.goals.leave() {
            tracing::warn!(
                service = self.service,
                "the action server has left: its goals are cancelled if it comes back"
            );
        }
    }
}
