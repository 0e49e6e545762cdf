//! Delivers what passes the gate, and stops the robot when it must.

mod certified;
mod confidential;
mod late;
mod subscribing;
mod writing;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{StreamExt, future::OptionFuture};
use ledger_api::{
    Context,
    v1::{Delivery, EventRecord},
};
use ledger_base::invariant::broken;
use ledger_base::rejection::Rejection;
use ledger_gate::{
    gate::{Refused, Settings as GateSettings},
    guard::{Act, Block, Guard, SILENT, Told},
    sample::Sample,
    service::Service,
};
use tokio::{sync::watch, time::sleep_until};

use super::{
    demand::Demand,
    points::Points,
    reader_keys::{self, ReaderKeys},
    rogue_publishers::{self, RoguePublishers},
    settings::Settings,
    stop_messages::StopMessages,
};
use crate::{
    graph::{qos::Qos, shm::Peers},
    ledger::{gateway::Gateway, robot_state::Question},
    log::{LogLimiter, one_line},
    routes::{
        clocks::Clocks,
        counters::{Counters, count},
        ends::{Outlet, changed},
        kind::{Opening, RouteConfig},
        pace::Pace,
        shown::HolderTopic,
        terms::stop_for,
    },
    shutdown::{Shutdown, requested},
};

/// How long a stop message is waited for when the bridge ends.
const FLUSH_MAX: Duration = Duration::from_millis(500);
/// How long the writer stays after its last message was confirmed: some middleware (RustDDS) confirms before it hands
/// out, and forgets what was not handed out when the writer leaves. A stop message must not be lost so.
const LINGER: Duration = Duration::from_millis(200);
/// A subscription that has to show a certificate again is renewed at most this often.
const RENEW_EVERY: Duration = Duration::from_secs(1);

/// The local ends of a route.
pub(in crate::routes) struct Outputs {
    pub(in crate::routes) outlet: Outlet,
    /// The quality of service that the outlet follows.
    pub(in crate::routes) qos: watch::Receiver<Qos>,
    pub(in crate::routes) points: Points,
    pub(in crate::routes) holder: HolderTopic,
}

/// A route from a service to a local topic.
pub(in crate::routes) struct FromLedger {
    gateway: Arc<dyn Gateway>,
    route: RouteConfig,
    settings: Settings,
    outputs: Outputs,
    counters: Counters,
    clocks: Clocks,
    guard: Guard,
    question: Question,
    service: Service,
    /// The bridge's identity.
    context: Context,
    /// Its part as a reader, while the service is confidential.
    reading: Option<ReaderKeys>,
    demand: Demand,
    stop_messages: StopMessages,
    rogue_publishers: RoguePublishers,
    /// The highest rate of a feed.
    pace: Pace<Sample>,
    /// The next height of the subscription.
    next_height: u64,
    /// When the messages that are judged now could be: they came, or the answer did that they waited for.
    judged: Instant,
    renewed: Instant,
    log_limiter: LogLimiter,
}

impl FromLedger {
    /// Asks how the robot stands. The outputs come to be when the gate is there: whoever sees them may publish, and that shall pass.
    pub(in crate::routes) async fn open(
        Opening { gateway, context, query, .. }: &Opening<'_>,
        (route, settings): (RouteConfig, Settings),
        gate: GateSettings,
        service: Service,
        counters: Counters,
        outputs: impl Future<Output = Result<Outputs, Rejection>>,
    ) -> Result<Self, Rejection> {
        let height = gateway.height().await?;
        let clocks = Clocks::start();
        let guard = Guard::new(gate, &route.service, clocks.now());
        let stop = stop_for(&service, &route, settings.stop.as_ref())?;
        let outputs = outputs.await?;
        let mut opened = Self {
            gateway: Arc::clone(gateway),
            route,
            outputs,
            counters,
            clocks,
            guard,
            question: Question::new(Arc::clone(query)),
            demand: Demand::new(settings.on_demand && !service.is_command()),
            stop_messages: StopMessages::new(stop, &service),
            rogue_publishers: RoguePublishers::new(settings.rogue_publishers),
            pace: Pace::new(settings.max_rate_hz),
            settings,
            service,
            context: (*context).clone(),
            reading: None,
            next_height: height.saturating_add(1),
            judged: Instant::now(),
            renewed: Instant::now(),
            log_limiter: LogLimiter::default(),
        };
        opened.read_confidential()?;
        // Nobody waits for the answer: until it comes nothing passes, and a robot that was left moving is stopped at once.
        opened.ask();
        opened.counters.lock().live.waiting = Some("the voters have not said yet how the robot stands".to_owned());
        Ok(opened)
    }

    /// The subscribers in shared memory.
    pub(in crate::routes) fn in_memory(&self) -> Option<Peers> {
        self.outputs.outlet.in_memory()
    }

    /// Runs until it is told to end; then the robot stops, if anybody moved it.
    pub(in crate::routes) async fn run(mut self, mut shutdown: Shutdown) {
        let (mut events, mut revocations) = self.begin();
        let mut late: OptionFuture<_> = self.fetch_late().into();
        let mut graph_ended = Box::pin(self.outputs.outlet.matched().clone().ended());
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
            if self.rogue_publishers.opens(&self.counters) {
                self.halt(rogue_publishers::NAME).await;
            }
            let due = |due: Option<u64>| due.map(|due| self.clocks.instant(due));
            let (stop_due, mut ask_due) = (due(self.guard.stop_at().map(|(due, _)| due)), due(self.guard.asks_at()));
            if let Some((ask, stale)) = self.outputs.points.due(self.settings.stale_after) {
                if stale <= Instant::now() {
                    self.outputs.points.clear();
                    continue;
                }
                let next = if self.question.is_under_way() { stale } else { ask };
                ask_due = Some(ask_due.map_or(next, |due| due.min(next)));
            }
            let (paced, keys_due) = (self.pace.due(), self.keys_due());
            let (again, demand) = (self.stop_messages.due(&self.outputs.outlet), self.demand.due(&self.outputs.outlet));
            let (follow, rests) =
                (changed(Some(&self.outputs.qos)), self.outputs.outlet.hand().map(|hand| hand.done()));
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break None,
                () = &mut graph_ended => {
                    tracing::error!(service = self.route.service, "THE LOCAL GRAPH IS LOST: the robot cannot be reached");
                    break None;
                }
                // The next turn stops the robot.
                () = sleep_until(stop_due.unwrap_or_else(Instant::now).into()), if stop_due.is_some() => {}
                () = again => {
                    if self.stop_messages.say_again(&self.outputs.outlet, &self.route.service) {
                        count(&mut self.counters.lock().summary.stops, "start", 1);
                    }
                }
                answer = self.question.answer() => self.answered(answer).await,
                Some(()) = OptionFuture::from(rests), if self.guard.gate().is_moving() => self.guard.rested(),
                () = follow => {
                    let qos = *self.outputs.qos.borrow_and_update();
                    self.outputs.outlet.follow(&qos).await;
                    self.counters.opened_again(self.outputs.outlet.matched());
                    graph_ended = Box::pin(self.outputs.outlet.matched().clone().ended());
                    late = self.fetch_late().into();
                }
                () = demand => {
                    if self.demand.look(&self.outputs.outlet) {
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
                    if !self.question.is_under_way() {
                        self.ask();
                    }
                }
                () = sleep_until(paced.unwrap_or_else(Instant::now).into()), if paced.is_some() => self.write_paced(),
                fetched = reader_keys::fetched(&mut self.reading) => self.take_keys(fetched).await,
                () = sleep_until(keys_due.unwrap_or_else(Instant::now).into()), if keys_due.is_some() => self.look_for_keys(),
                Some(delivery) = revocations.next() => self.handle_all(delivery).await,
                Some(delivery) = events.next() => {
                    // What is told early has no height, and is no sign that blocks come.
                    if let Ok(delivery) = &delivery && !delivery.early {
                        self.counters.lock().live.heard = Some(Instant::now());
                        self.next_height = self.next_height.max(delivery.height.saturating_add(1));
                        let now = self.clocks.now();
                        self.guard.heard(delivery.time, now);
                        self.guard.heads(delivery.height, &delivery.heads, now);
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
        self.outputs.points.clear();
        self.stop_messages.finish(&self.outputs.outlet, &self.route.service).await;
        if !self.outputs.outlet.flush(FLUSH_MAX).await {
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
        self.question.ask(since, self.guard.open_stops().collect());
    }

    /// Handles the events of a block in their order.
    async fn handle_all(&mut self, delivery: Result<Delivery, Rejection>) {
        self.judged = Instant::now();
        let delivery = match delivery {
            Ok(delivery) => delivery,
            Err(refused) => {
                let reason = one_line(&refused);
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
        self.judge(Block::new(delivery.height, delivery.time), &delivery).await;
        self.tell_holders();
    }

    /// Judges the events of a block in their order.
    async fn judge(&mut self, mut block: Block, delivery: &Delivery) {
        for event in &delivery.events {
            if let Some(act) = self.guard.told(&mut block, &told(event), self.clocks.now()) {
                self.carry_out(act).await;
            }
        }
    }

    async fn carry_out(&mut self, act: Act) {
        match act {
            Act::Publish(passed) => self.publish(passed),
            Act::Stop(reason) => self.publish_stop(reason).await,
            Act::Refused { refused, height } => {
                self.refuse(refused, height);
                if refused.stops() {
                    self.publish_stop(refused.name()).await;
                }
            }
        }
    }

    /// Stops the robot by our own decision: then nothing from before passes any more.
    async fn halt(&mut self, reason: &'static str) {
        self.guard.stopped(self.clocks.now());
        self.publish_stop(reason).await;
    }

    async fn publish_stop(&mut self, reason: &'static str) {
        // A driver who is silent, or asks for no speed, still holds the service, and a task goes on.
        if reason != SILENT && reason != Refused::BadSpeed.name() {
            self.outputs.points.clear();
        }
        let is_told = match self.outputs.outlet.hand() {
            Some(hand) => hand.stop(reason).await,
            None => self.stop_messages.is_known(),
        };
        if !is_told {
            return;
        }
        tracing::info!(service = self.route.service, reason, "stop");
        self.stop_messages.say(&self.outputs.outlet, &self.route.service);
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
        if let Some(silent) = self.log_limiter.admit(refused.name(), Instant::now()) {
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
