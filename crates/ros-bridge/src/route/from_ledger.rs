//! From the ledger to the local graph, through the gate.
//!
//! Subscribed from now on: commands of the past are nobody's. A connection that broke is resumed where it was cut
//! off, and what is then too old stays out.
//!
//! How the robot stands is asked when it may have changed, and while somebody moves it. A message of which the gate knows
//! nothing yet waits for the answer.

mod confidential;
mod demand;
mod late;
mod settings;
mod writing;

pub(super) use self::settings::{STALE_AFTER, STALE_KEY, half, stale_after};

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{
    FutureExt, StreamExt,
    future::{BoxFuture, OptionFuture},
};
use ledger_api::{
    Context, Subscription,
    v1::{Delivery, EventRecord},
};
use ledger_base::invariant::broken;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::{
    ABAC,
    gate::{Refused, Settings as GateSettings},
    guard::{Act, Block, Guard, SILENT, Told},
    sample::Sample,
    service::Service,
};
use tokio::{sync::watch, time::sleep_until};

use self::{confidential::Reading, demand::Demand, settings::Settings};
use super::{
    Clocks, Stop,
    holder::{self, Holder, Holders},
    kind::Kind,
    local::{Outlet, changed},
    pace::{Pace, RATE_KEY},
    points::{self, Points},
    side_door::{self, SideDoor},
    silence::{Cause, Facts, Silence, fault, pause},
    stopped,
    stopping::Stopping,
};
use crate::{
    config::{HEARTBEAT_MS, RouteConfig},
    count::{Complaint, Counters, count, line},
    dds::Role,
    gateway::{Deliveries, Gateway},
    names::Interface,
    qos::Qos,
    service::{stop_for, topic_for},
    standing::{Answer, Answered, Asker, answer},
};

/// How long a stop message is waited for when the bridge ends.
const FLUSH_MAX: Duration = Duration::from_millis(500);
/// How long the writer stays after its last message was confirmed: some middleware (RustDDS) confirms before it hands
/// out, and forgets what was not handed out when the writer leaves. A stop message must not be lost so.
const LINGER: Duration = Duration::from_millis(200);
/// A subscription that has to show a certificate again is renewed at most this often.
const RENEW_EVERY: Duration = Duration::from_secs(1);

/// Commands on the robot's side, or a feed on the user's: through the gate to the local graph.
pub(super) static KIND: Kind = Kind {
    name: "from_ledger",
    carries: Interface::Message,
    right: "subscribe",
    other_end: Role::Subscriber,
    keys: &[
        "max_age_ms",
        STALE_KEY,
        "command_timeout_ms",
        side_door::NAME,
        "stop",
        "stop_hex",
        points::KEYS[0],
        points::KEYS[1],
        holder::KEY,
        RATE_KEY,
    ],
    read: settings::read,
    discovered: Some(settings::discovered),
    silence,
    beside: side_door::beside,
};

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let Facts { service, topic, .. } = facts;
    match cause {
        Cause::Alone => pause("no_subscriber", format!("nobody subscribes to {topic}")),
        Cause::Refused { line, .. } => fault("gate", format!("the gate lets nothing pass: {line}")),
        Cause::NotHeld => pause("no_holder", format!("nobody holds {service}")),
        Cause::NothingCame => pause("no_message", "nothing has come from the ledger yet".to_owned()),
    }
}

/// A route from a service to a local topic.
struct FromLedger {
    gateway: Arc<dyn Gateway>,
    route: RouteConfig,
    settings: Settings,
    outlet: Outlet,
    /// The quality of service that the outlet follows.
    qos: watch::Receiver<Qos>,
    points: Points,
    holder: Holder,
    counters: Counters,
    clocks: Clocks,
    guard: Guard,
    asker: Arc<Asker>,
    /// The question under way.
    question: Option<BoxFuture<'static, Answer>>,
    service: Service,
    /// The bridge's identity.
    context: Context,
    /// Its part as a reader, while the service is confidential.
    reading: Option<Reading>,
    demand: Demand,
    stopping: Stopping,
    side_door: SideDoor,
    /// The highest rate of a feed.
    pace: Pace<Sample>,
    /// The next height of the subscription.
    next_height: u64,
    /// When the messages that are judged now could be: they came, or the answer did that they waited for.
    judged: Instant,
    renewed: Instant,
    complaint: Complaint,
}

impl FromLedger {
    /// Asks how the robot stands. The outlet comes to be when the gate is there: whoever sees it may publish, and that shall pass.
    async fn open(
        (gateway, asker, context): (Arc<dyn Gateway>, Arc<Asker>, &Context),
        (route, settings): (RouteConfig, Settings),
        gate: GateSettings,
        service: Service,
        outlet: impl Future<Output = Result<((Outlet, watch::Receiver<Qos>), (Points, Holder), Counters), Rejection>>,
    ) -> Result<Self, Rejection> {
        let height = gateway.height().await?;
        let clocks = Clocks::start();
        let guard = Guard::new(gate, &route.service, clocks.now());
        let stop = stop_for(&service, &route, settings.stop.as_ref())?;
        let ((outlet, qos), (points, holder), counters) = outlet.await?;
        let mut opened = Self {
            gateway,
            route,
            outlet,
            qos,
            points,
            holder,
            counters,
            clocks,
            guard,
            asker,
            question: None,
            demand: Demand::new(settings.on_demand && !service.is_command()),
            stopping: Stopping::new(stop, &service),
            side_door: SideDoor::new(settings.side_door),
            pace: Pace::new(settings.max_rate_hz),
            settings,
            service,
            context: context.clone(),
            reading: None,
            next_height: height.saturating_add(1),
            judged: Instant::now(),
            renewed: Instant::now(),
            complaint: Complaint::default(),
        };
        opened.read_confidential()?;
        // Nobody waits for the answer: until it comes nothing passes, and a robot that was left moving is stopped at once.
        opened.ask();
        opened.counters.lock().live.waiting = Some("the voters have not said yet how the robot stands".to_owned());
        Ok(opened)
    }

    /// Runs until it is told to end; then the robot stops, if anybody moved it.
    async fn run(mut self, mut stop: Stop) {
        let (mut events, mut revocations) = self.begin();
        let mut late: OptionFuture<_> = self.fetch_late().into();
        let mut graph_ended = Box::pin(self.outlet.matched().clone().ended());
        let fault = loop {
            if let Some(found) = self.guard.gate().fault() {
                break Some(found.to_owned());
            }
            // Others have their turn, also while events come without an end.
            tokio::task::consume_budget().await;
            // By the clock, before anything else is looked at: a flood of events must not put off a stop.
            if let Some(reason) = self.guard.overdue(self.clocks.now()) {
                self.publish_stop(reason).await;
            }
            if self.side_door.opens(&self.counters) {
                self.halt(side_door::NAME).await;
            }
            let due = |due: Option<u64>| due.map(|due| self.clocks.instant(due));
            let (stop_due, mut ask_due) = (due(self.guard.stop_at().map(|(due, _)| due)), due(self.guard.asks_at()));
            if let Some((ask, stale)) = self.points.due(self.settings.stale_after) {
                if stale <= Instant::now() {
                    self.points.clear();
                    continue;
                }
                let next = if self.question.is_some() { stale } else { ask };
                ask_due = Some(ask_due.map_or(next, |due| due.min(next)));
            }
            let (paced, keys_due) = (self.pace.due(), self.keys_due());
            let (again, demand) = (self.stopping.due(&self.outlet), self.demand.due(&self.outlet));
            let (follow, rests) = (changed(&self.qos), self.outlet.hand().map(|hand| hand.done()));
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break None,
                () = &mut graph_ended => {
                    tracing::error!(service = self.route.service, "THE LOCAL GRAPH IS LOST: the robot cannot be reached");
                    break None;
                }
                // The next turn stops the robot.
                () = sleep_until(stop_due.unwrap_or_else(Instant::now).into()), if stop_due.is_some() => {}
                () = again => {
                    if self.stopping.say_again(&self.outlet, &self.route.service) {
                        count(&mut self.counters.lock().summary.stops, "start", 1);
                    }
                }
                answer = answer(&mut self.question) => self.answered(answer).await,
                Some(()) = OptionFuture::from(rests), if self.guard.gate().is_moving() => self.guard.rested(),
                () = follow => {
                    let qos = *self.qos.borrow_and_update();
                    self.outlet.follow(&qos);
                    self.counters.opened_again(self.outlet.matched());
                    graph_ended = Box::pin(self.outlet.matched().clone().ended());
                    late = self.fetch_late().into();
                }
                () = demand => {
                    if self.demand.look(&self.outlet) {
                        (events, revocations) = self.begin_again();
                        late = self.fetch_late().into();
                    }
                }
                Some(fetched) = &mut late, if !self.guard.gate().is_closed() => {
                    late = None.into();
                    self.deliver_late(fetched).await;
                }
                () = sleep_until(ask_due.unwrap_or_else(Instant::now).into()), if ask_due.is_some() => {
                    // With a question under way the points on show are too old: the next turn takes them away.
                    if self.question.is_none() {
                        self.ask();
                    }
                }
                () = sleep_until(paced.unwrap_or_else(Instant::now).into()), if paced.is_some() => self.write_paced(),
                fetched = confidential::fetched(&mut self.reading) => self.take_keys(fetched).await,
                () = sleep_until(keys_due.unwrap_or_else(Instant::now).into()), if keys_due.is_some() => self.look_for_keys(),
                Some(delivery) = revocations.next() => self.handle_all(delivery).await,
                Some(delivery) = events.next() => {
                    // What is told early has no height, and is no sign that blocks come.
                    if let Ok(delivery) = &delivery && !delivery.early {
                        self.counters.lock().live.heard = Some(Instant::now());
                        self.next_height = self.next_height.max(delivery.height.saturating_add(1));
                        self.guard.heard(delivery.time, self.clocks.now());
                    }
                    let known = self.count_of(Refused::UnknownCreator);
                    self.handle_all(delivery).await;
                    if self.count_of(Refused::UnknownCreator) > known && self.renewed.elapsed() >= RENEW_EVERY {
                        self.renewed = Instant::now();
                        events = self.subscribe();
                    }
                }
            }
        };
        if self.guard.gate().is_moving() {
            self.halt(if fault.is_some() { "fault" } else { "shutdown" }).await;
        }
        self.points.clear();
        self.stopping.finish(&self.outlet, &self.route.service).await;
        if !self.outlet.flush(FLUSH_MAX).await {
            tracing::warn!(service = self.route.service, "not every subscriber confirmed the last messages");
        }
        tokio::time::sleep(LINGER).await;
        if let Some(found) = fault {
            broken("a message that passes the gate is its holder's, and newer than the last", format_args!("{found}"));
        }
    }

    /// Asks how the robot stands.
    fn ask(&mut self) {
        let since = self.clocks.instant(self.guard.ask(self.clocks.now()));
        let asker = Arc::clone(&self.asker);
        self.question = Some(async move { asker.ask(since).await }.boxed());
    }

    fn subscribe(&self) -> Deliveries {
        let tasks = if self.settings.points.is_empty() { &[][..] } else { &["task"] };
        let names = ["message", "keyed", "granted", "released", "robot", "stopped", "resumed"].iter().chain(tasks);
        self.gateway.subscribe(Subscription {
            from_height: self.next_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![self.route.service.clone(), self.service.robot.clone()],
            names: names.map(|name| (*name).to_owned()).collect(),
            heartbeat: HEARTBEAT_MS,
            early: true,
            proofs: false,
        })
    }

    /// Handles the events of a block in their order.
    async fn handle_all(&mut self, delivery: Result<Delivery, Rejection>) {
        self.judged = Instant::now();
        let delivery = match delivery {
            Ok(delivery) => delivery,
            Err(refused) => {
                let reason = line(&refused);
                tracing::error!(
                    service = self.route.service,
                    code = refused.code.name(),
                    reason,
                    "the ledger has ended the subscription"
                );
                self.counters.lock().live.waiting = Some(format!("the ledger has ended the subscription: {reason}"));
                if self.guard.gate().is_moving() {
                    self.halt("refused").await;
                }
                return;
            }
        };
        let mut block = Block::new(delivery.height, delivery.time);
        for event in &delivery.events {
            if let Some(act) = self.guard.told(&mut block, &told(event), self.clocks.now()) {
                self.carry_out(act).await;
            }
        }
        self.tell_holders();
    }

    async fn carry_out(&mut self, act: Act) {
        match act {
            Act::Publish(passed) => self.publish(passed),
            Act::Stop(reason) => self.publish_stop(reason).await,
            Act::Refused { refused, height } => self.refuse(refused, height),
        }
    }

    /// Takes the answer of the voters, and judges the messages that waited for it.
    async fn answered(&mut self, answer: Answer) {
        self.judged = Instant::now();
        let answered = match answer {
            Ok(answered) => answered,
            Err(refused) => return self.not_known(&refused, None).await,
        };
        match self.learn(&answered) {
            Ok(acts) => {
                for act in acts {
                    self.carry_out(act).await;
                }
                self.tell_holders();
                let task = answered.standing.tasks.iter().find(|task| task.service == self.route.service);
                self.points.show(task, answered.asked);
                self.holder.show(&self.route.service, &answered.standing);
            }
            Err(refused) => self.not_known(&refused, Some(self.clocks.steady(answered.asked))).await,
        }
    }

    /// Takes how the robot stands.
    fn learn(&mut self, Answered { standing, asked }: &Answered) -> Result<Vec<Act>, Rejection> {
        let service = standing.service(&self.route.service)?;
        topic_for(&service, &self.route)?;
        self.stopping.learn(stop_for(&service, &self.route, self.settings.stop.as_ref())?, &service);
        let acts = self.guard.answered(&service, standing, self.clocks.steady(*asked), self.clocks.now());
        let mut counts = self.counters.lock();
        counts.live.needs_grant = service.needs_grant() && service.is_command();
        counts.live.holder = Holders::of(&self.route.service, &standing.grants).names();
        drop(counts);
        self.service = service;
        self.read_confidential()?;
        Ok(acts)
    }

    /// Nobody says how the robot stands. Where that is because there is no such service, or none that this version knows, it stops.
    /// Else what is known counts for a while.
    async fn not_known(&mut self, refused: &Rejection, asked: Option<u64>) {
        self.guard.unanswered(asked);
        let reason = line(refused);
        let is_gone = matches!(
            refused.code,
            Code::UnknownRobot | Code::UnknownService | Code::UnknownMode | Code::WrongType | Code::BadArgument
        );
        if is_gone {
            for act in self.guard.gone(self.clocks.now()) {
                self.carry_out(act).await;
            }
        }
        self.counters.lock().live.waiting = Some(format!("the voters do not say how the robot stands: {reason}"));
        if let Some(not_logged) = self.complaint.worth("standing", Instant::now()) {
            let service = &self.route.service;
            tracing::warn!(
                service,
                code = refused.code.name(),
                reason,
                not_logged,
                "the voters do not say how the robot stands"
            );
        }
        if is_gone {
            self.points.clear();
            if self.guard.gate().is_moving() {
                self.halt("no_service").await;
            }
        }
    }

    /// Tells the reporter how the service stands.
    fn tell_holders(&self) {
        let live = &mut self.counters.lock().live;
        live.held = self.guard.gate().is_held();
        if !live.held {
            live.holder.clear();
        }
        if !self.guard.gate().is_closed() {
            live.waiting = None;
        }
    }

    /// Stops the robot by our own decision: then nothing from before passes any more.
    async fn halt(&mut self, reason: &'static str) {
        self.guard.stopped(self.clocks.now());
        self.publish_stop(reason).await;
    }

    async fn publish_stop(&mut self, reason: &'static str) {
        // A driver who is silent still holds the service, and a task goes on.
        if reason != SILENT {
            self.points.clear();
        }
        let is_told = match self.outlet.hand() {
            Some(hand) => hand.stop(reason).await,
            None => self.stopping.is_known(),
        };
        if !is_told {
            return;
        }
        tracing::info!(service = self.route.service, reason, "stop");
        self.stopping.say(&self.outlet, &self.route.service);
        count(&mut self.counters.lock().summary.stops, reason, 1);
    }

    fn refuse(&mut self, refused: Refused, height: u64) {
        if let Some(reading) = self.reading.as_mut().filter(|_| refused == Refused::NoKey) {
            reading.missing();
        }
        let mut counts = self.counters.lock();
        count(&mut counts.summary.gate, refused.name(), 1);
        counts.live.refused = Some((refused.name(), refused.meaning().to_owned(), Instant::now()));
        drop(counts);
        if let Some(silent) = self.complaint.worth(refused.name(), Instant::now()) {
            let (service, reason, meaning) = (&self.route.service, refused.name(), refused.meaning());
            tracing::warn!(service, height, reason, meaning, not_logged = silent, "the gate dropped a message");
        }
    }

    fn count_of(&self, refused: Refused) -> u64 {
        self.counters.lock().summary.gate.get(refused.name()).copied().unwrap_or(0)
    }
}

/// The event as the gate reads it.
fn told(event: &EventRecord) -> Told<'_> {
    let EventRecord { index, chaincode, name, payload, transaction, certificate, .. } = event;
    Told { index: *index, chaincode, name, payload, transaction, certificate }
}
