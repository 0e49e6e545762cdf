//! From the local graph to the ledger: every sample becomes a signed transaction, in the order in which they came.
//!
//! Nothing waits for an earlier verdict, and no batch waits to be filled. When the ledger is slower than the topic,
//! the newest samples replace the oldest that wait, and that is counted. A command that has waited for longer than its service
//! allows is dropped, and counted: with a signature it would be new.

mod latch;
mod outcome;
mod publishing;
mod sealing;

#[cfg(test)]
mod tests;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{
    FutureExt, StreamExt,
    future::{BoxFuture, OptionFuture},
    stream::FuturesUnordered,
};
use ledger_api::Subscription;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_contract::Grant;
use ledger_gate::ABAC;
use tokio::{sync::mpsc, time::sleep_until};

use self::{
    latch::{KEYS as LATCH_KEYS, Latch},
    outcome::{LEFT_OUT, Outcome, TOO_OLD},
    publishing::Publishing,
    sealing::Sealing,
};
use super::{
    Clocks, Stop,
    calls::Told,
    holder::{self, Following, Holder, Holders},
    kind::{Beside, Given, Kind, Opened, Opening, Plan},
    local::Inlet,
    pace::{Pace, RATE_KEY, read_rate},
    silence::{self, Cause, Facts, Silence, fault, pause},
    stopped,
};
use crate::{
    config::HEARTBEAT_MS,
    count::{Complaint, Counters, line},
    dds::Role,
    door::Door,
    fit::Fit,
    gateway::{Gateway, ask},
    names::{Interface, TopicName},
    queue::{Incoming, Queue},
    service::{Authorization, Caller},
};

/// Most samples of one transaction.
const BATCH_SAMPLES_MAX: u32 = 256;
/// Most transactions of one route without a verdict; beyond it samples wait, and the newest replace the oldest.
const IN_FLIGHT_MAX: usize = 256;
/// Most bytes of one route without a verdict; the same beyond it.
const IN_FLIGHT_BYTES_MAX: usize = 8 * 1024 * 1024;
/// A batch takes no more samples beyond this, in bytes.
const BATCH_BYTES_MAX: usize = 256 * 1024;
/// The own grant is asked for at most this often.
const REFRESH_EVERY: Duration = Duration::from_millis(500);

/// A user's commands, or a robot's feed.
pub(super) static KIND: Kind = Kind {
    name: "to_ledger",
    carries: Interface::Message,
    right: "publish",
    other_end: Role::Publisher,
    keys: &["batch_max", RATE_KEY, LATCH_KEYS[0], LATCH_KEYS[1], holder::KEY],
    read,
    discovered: Some(|terms| {
        let (max_rate_hz, latched) = (terms.max_rate_hz, latch::Terms::default());
        Arc::new(Settings { batch_max: 1, max_rate_hz, latched, held_only: terms.needs_grant, holder: None })
    }),
    silence,
    beside,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// Most samples of one transaction; a batch is never waited for.
    batch_max: usize,
    /// Most samples a second; none = any number.
    max_rate_hz: Option<u32>,
    /// Where the local topic is latched.
    latched: latch::Terms,
    /// Is nothing submitted without the grant that the service asks for?
    held_only: bool,
    /// Where it is shown who holds the service.
    holder: Option<TopicName>,
}

fn read(section: &mut Section<'_, '_>, _given: &Given<'_>) -> Arc<dyn Plan> {
    let mut batch_max = 1_u32;
    section.integer("batch_max", 1..=u64::from(BATCH_SAMPLES_MAX), &mut batch_max);
    let max_rate_hz = read_rate(section);
    if let Some(hz) = max_rate_hz.filter(|_| batch_max > 1) {
        let found = format!("{batch_max} and {hz}");
        section.conflict(["batch_max", RATE_KEY], found, "one of them: with a rate each sample goes alone".to_owned());
    }
    let (batch_max, latched) = (usize::try_from(batch_max).unwrap_or(1), latch::Terms::read(section));
    Arc::new(Settings { batch_max, max_rate_hz, latched, held_only: false, holder: holder::read(section) })
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<Opened, Rejection> {
        let Opening { route, gateway, context, local, service, topic, mark, asker, counters, qos, stop } = opening;
        let max_age = Duration::from_millis(service.max_age_ms);
        let door = Arc::new(Door::new(mark, &route.service, max_age, Arc::clone(local.delivered())));
        let (inlet, matched, in_memory) =
            local.inlet(topic, &route.message, qos, route.limits(), Arc::clone(&door)).await?;
        counters.opened(&matched, Some(door));
        counters.lock().live.needs_grant = service.needs_grant() && service.is_command();
        let inlet = (inlet, Fit::of(&route.message));
        let opened = ToLedger::open(gateway, &route.service, inlet, self, counters).await?;
        // A command that is said again would move the robot again.
        let latch = (!service.is_command()).then(|| Latch::new(self.latched));
        let max_age = service.is_command().then_some(max_age);
        let mut opened = ToLedger { withholds: self.held_only, max_age, latch, ..opened };
        opened.sealing = Sealing::new(Arc::clone(&opened.gateway), context.network, service.confidential);
        // Who needs a grant and has none shares when it begins.
        if opened.publishing.epoch > 0 || !service.needs_grant() {
            opened.sealing.renew_if_confidential(&opened.publishing);
        }
        let running = match &self.holder {
            Some(shown) => {
                let holder = Holder::open(Some(shown), [topic].into_iter(), local, mark).await?;
                let following = Following::new(holder, &*opened.gateway, (asker, &service), opened.from_height);
                following.beside(opened.run(stop)).boxed()
            }
            None => opened.run(stop).boxed(),
        };
        Ok(Opened { in_memory, running })
    }
}

/// Opens the half of a route of calls that goes to the ledger: each sample is a transaction of its own. `told` hears which one, by
/// the sample's number.
pub(super) async fn half(
    gateway: Arc<dyn Gateway>,
    service: &str,
    calls: Arc<Queue>,
    told: Option<mpsc::UnboundedSender<Told>>,
    counters: Counters,
) -> Result<impl FnOnce(Stop) -> BoxFuture<'static, ()> + use<>, Rejection> {
    let settings =
        Settings { batch_max: 1, max_rate_hz: None, latched: latch::Terms::default(), held_only: false, holder: None };
    let opened = ToLedger::open(gateway, service, (Inlet::Calls(calls), Fit::none()), &settings, counters).await?;
    Ok(move |stop| ToLedger { told, ..opened }.run(stop).boxed())
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    // It was dropped here: the ledger has not seen it.
    if let Cause::Refused { name: TOO_OLD | LEFT_OUT, line, .. } = cause {
        return fault("refused", line.to_owned());
    }
    let topic = facts.topic;
    let alone = if facts.surroundings.bridges > 0 {
        let reason = format!("only a bridge publishes on {topic}, and what came from the ledger is not taken in");
        fault("only_bridges", reason)
    } else {
        pause("no_publisher", format!("nobody publishes on {topic}"))
    };
    let nothing = format!("the publisher on {topic} has sent nothing yet");
    silence::of_sending(facts, cause, (alone, "the ledger refuses", nothing))
}

/// The warning about another that takes samples in.
fn beside(Beside { service, topic, is_same_service, .. }: &Beside<'_>) -> Option<String> {
    let warning =
        || format!("another bridge takes {topic} to {service} too: each sample is submitted twice; stop one of both");
    is_same_service.then(warning)
}

/// A route from a local topic to a service.
struct ToLedger {
    gateway: Arc<dyn Gateway>,
    inlet: Inlet,
    batch_max: usize,
    pace: Pace<Incoming>,
    counters: Counters,
    fit: Fit,
    /// Does nothing go out while the user holds no grant?
    withholds: bool,
    /// The age beyond which a command is dropped; none for all that is no command.
    max_age: Option<Duration>,
    /// The last samples of a latched topic; none for commands.
    latch: Option<Latch>,
    clocks: Clocks,
    publishing: Publishing,
    holders: Holders,
    sealing: Sealing,
    /// Where the subscription begins.
    from_height: u64,
    complaint: Complaint,
    replaced: Complaint,
    no_news: Complaint,
    refreshed: Option<Instant>,
    /// Bytes without a verdict.
    under_way_bytes: usize,
    /// The other half of a route of calls.
    told: Option<mpsc::UnboundedSender<Told>>,
}

impl ToLedger {
    /// Learns who the bridge is and what it holds now.
    async fn open(
        gateway: Arc<dyn Gateway>,
        service: &str,
        (inlet, fit): (Inlet, Fit),
        settings: &Settings,
        counters: Counters,
    ) -> Result<Self, Rejection> {
        let height = gateway.height().await?;
        let (caller, _): (Caller, u64) = ask(&*gateway, height, ABAC, "GetSubmittingClientIdentity", &[]).await?;
        let mut publishing = Publishing { service: service.to_owned(), me: caller.id, epoch: 0, last_seq: 0, as_of: 0 };
        let (now, as_of) = authorization(Arc::clone(&gateway), height, service.to_owned()).await?;
        publishing.learn(as_of, now.epoch, now.next_seq);
        let (grants, _): (Vec<Grant>, u64) = ask(&*gateway, height, ABAC, "grants", &[service]).await?;
        let sealing = Sealing::new(Arc::clone(&gateway), Hash::ZERO, false);
        let opened = Self {
            gateway,
            sealing,
            inlet,
            batch_max: settings.batch_max,
            pace: Pace::new(settings.max_rate_hz),
            counters,
            fit,
            withholds: false,
            max_age: None,
            latch: None,
            clocks: Clocks::start(),
            publishing,
            holders: Holders::of(service, &grants),
            from_height: height.saturating_add(1),
            complaint: Complaint::default(),
            replaced: Complaint::default(),
            no_news: Complaint::default(),
            refreshed: None,
            under_way_bytes: 0,
            told: None,
        };
        opened.tell_grant(None);
        Ok(opened)
    }

    /// Runs until it is told to end, or the middleware ends.
    async fn run(mut self, mut stop: Stop) {
        let mut events = self.gateway.subscribe(Subscription {
            from_height: self.from_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![self.publishing.service.clone()],
            names: ["granted", "renewed", "released", "reader"].map(str::to_owned).to_vec(),
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        let mut under_way: FuturesUnordered<BoxFuture<'static, Outcome>> = FuturesUnordered::new();
        let mut refresh: OptionFuture<BoxFuture<'static, Result<(Authorization, u64), Rejection>>> = None.into();
        loop {
            let has_room = under_way.len() < IN_FLIGHT_MAX && self.under_way_bytes < IN_FLIGHT_BYTES_MAX;
            let paced = self.pace.due();
            let follow = self.inlet.to_follow();
            let again = self.latch.as_ref().filter(|_| self.inlet.is_latched()).and_then(Latch::due);
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break,
                Some(delivery) = events.next() => match delivery {
                    Ok(delivery) => {
                        let held = self.publishing.epoch;
                        self.publishing.hear(&delivery);
                        self.holders.hear(&delivery);
                        self.hear_of_readers(&delivery, held);
                        self.tell_grant(Some(Instant::now()));
                    }
                    Err(refused) => {
                        if let Some(not_logged) = self.no_news.worth(refused.code.name(), Instant::now()) {
                            tracing::warn!(code = refused.code.name(), reason = line(&refused), not_logged, "cannot receive news about grants");
                        }
                    }
                },
                Some(answer) = &mut refresh => {
                    refresh = None.into();
                    match answer {
                        Ok((now, height)) => {
                            self.publishing.learn(height, now.epoch, now.next_seq);
                            self.tell_grant(None);
                        }
                        Err(refused) => tracing::warn!(code = refused.code.name(), reason = line(&refused), "cannot read the bridge's own grant"),
                    }
                }
                made = self.sealing.made() => self.shared(made),
                Some(outcome) = under_way.next() => {
                    let is_due = self.refreshed.is_none_or(|before| before.elapsed() >= REFRESH_EVERY);
                    if self.note(outcome) && is_due {
                        self.refreshed = Some(Instant::now());
                        let (gateway, service) = (Arc::clone(&self.gateway), self.publishing.service.clone());
                        refresh = Some(authorization(gateway, self.publishing.as_of, service).boxed()).into();
                    }
                }
                () = sleep_until(paced.unwrap_or_else(Instant::now).into()), if has_room && paced.is_some() => {
                    // The grant may have ended meanwhile.
                    let waited = self.pace.take(Instant::now());
                    let waited = waited.filter(|waited| !self.is_withheld() && !self.is_too_old(waited));
                    under_way.extend(waited.map(|waited| self.submit(waited)));
                }
                () = sleep_until(again.unwrap_or_else(Instant::now).into()), if has_room && again.is_some() => {
                    under_way.extend(self.say_latched());
                }
                () = follow => {
                    if let Some(matched) = self.inlet.follow() {
                        self.counters.opened_again(&matched);
                    }
                }
                incoming = self.inlet.next(), if has_room => match incoming {
                    Some(incoming) if self.fits(&incoming) => {
                        let now = self.keep(incoming).and_then(|incoming| self.in_its_turn(incoming));
                        under_way.extend(now.map(|now| self.submit(now)));
                    }
                    Some(_) => {}
                    None => {
                        tracing::error!(service = self.publishing.service, "the local topic ended");
                        break;
                    }
                },
            }
        }
        self.counters.lock().summary.replaced = self.inlet.dropped();
    }

    /// Tells the reporter how the own grant stands, who holds the service, and when the ledger was heard.
    fn tell_grant(&self, heard: Option<Instant>) {
        let live = &mut self.counters.lock().live;
        live.held = self.publishing.epoch > 0;
        live.holder = self.holders.names();
        live.heard = heard.or(live.heard);
    }

    /// The sample to submit now: this one, unless the route has a highest rate and it comes too soon.
    fn in_its_turn(&mut self, incoming: Incoming) -> Option<Incoming> {
        let now = Instant::now();
        let passes = self.pace.offer(incoming, now);
        if !self.pace.is_unlimited() {
            let mut counts = self.counters.lock();
            let thinned = self.pace.thinned();
            counts.summary.samples_in += thinned;
            counts.summary.thinned += thinned;
            counts.live.came = Some(now);
        }
        passes
    }

    /// Submits a sample, with those that wait behind it up to a batch.
    fn submit(&mut self, first: Incoming) -> BoxFuture<'static, Outcome> {
        let mut bytes = first.sample.wire().len();
        let mut samples = vec![first];
        while samples.len() < self.batch_max && bytes < BATCH_BYTES_MAX {
            let Some(next) = self.inlet.try_next() else { break };
            if !self.fits(&next) {
                continue;
            }
            bytes = bytes.saturating_add(next.sample.wire().len());
            samples.push(next);
        }
        let received: Vec<Instant> = samples.iter().map(|incoming| incoming.received).collect();
        self.counters.lock().summary.samples_in += received.len() as u64;
        self.submit_all(&samples, received, bytes)
    }

    /// Submits the last samples of a latched topic, all together.
    fn say_latched(&mut self) -> Option<BoxFuture<'static, Outcome>> {
        let (latch, now) = (self.latch.as_mut()?, Instant::now());
        let samples = latch.take(|source| self.inlet.has_publisher(source), now);
        if samples.is_empty() {
            return None;
        }
        let bytes = samples.iter().map(|incoming| incoming.sample.wire().len()).sum();
        let said = vec![now; samples.len()];
        Some(self.submit_all(&samples, said, bytes))
    }

    fn submit_all(
        &mut self,
        samples: &[Incoming],
        received: Vec<Instant>,
        bytes: usize,
    ) -> BoxFuture<'static, Outcome> {
        let number = samples.first().map_or(0, |first| first.sequence);
        let wall = self.clocks.now().wall;
        let (id, verdict) = match self.sealing.sealer().and_then(|sealer| self.publishing.call(wall, samples, sealer)) {
            Ok(args) => self.gateway.set(args),
            Err(refused) => (None, std::future::ready(Err(refused)).boxed()),
        };
        if let Some(id) = id {
            self.tell(Told::Submitted(number, id));
        }
        let mut counts = self.counters.lock();
        counts.summary.submitted += received.len() as u64;
        counts.live.came = Some(Instant::now());
        let replaced = self.inlet.dropped();
        let more = replaced.saturating_sub(std::mem::replace(&mut counts.summary.replaced, replaced));
        drop(counts);
        if more > 0 && self.replaced.worth("replaced", Instant::now()).is_some() {
            let service = &self.publishing.service;
            tracing::warn!(service, replaced, "the ledger is slower than the topic; newer samples replace older ones");
        }
        self.under_way_bytes = self.under_way_bytes.saturating_add(bytes);
        let key = self.sealing.key();
        let submitted = (id, Instant::now());
        verdict.map(move |verdict| Outcome { first: number, received, submitted, bytes, key, verdict }).boxed()
    }

    /// Tells the other half of a route of calls, if this is one.
    fn tell(&self, news: Told) {
        if let Some(told) = &self.told {
            // An error means that the other half has ended, and this one will.
            drop(told.send(news));
        }
    }
}

async fn authorization(
    gateway: Arc<dyn Gateway>,
    height: u64,
    service: String,
) -> Result<(Authorization, u64), Rejection> {
    ask(&*gateway, height, ABAC, "authorize", &[&service, KIND.right]).await
}
