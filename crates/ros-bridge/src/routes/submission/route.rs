//! Submits what comes from the local graph, and follows the own grant.

mod kept;
mod outcome;

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
use ledger_contract::Grant;
use ledger_gate::{ABAC, service::Service};
use tokio::{sync::mpsc, time::sleep_until};

use self::outcome::Outcome;
pub(in crate::routes) use self::outcome::{LEFT_OUT, TOO_OLD};
use super::{key_sharing::KeySharing, latch::Latch, own_grant::OwnGrant, settings::Settings};
use crate::{
    graph::{messages::length::LengthCheck, queue::Incoming},
    ledger::{
        gateway::{Gateway, HEARTBEAT_MS, ask},
        service::{Authorization, Caller},
    },
    log::{LogLimiter, one_line},
    routes::{
        clocks::Clocks,
        counters::Counters,
        ends::{Inlet, SubmitUpdate, changed},
        pace::Pace,
        shown::HolderNames,
    },
    shutdown::{Shutdown, requested},
};

/// The right on the service that the bridge's identity needs.
const RIGHT: &str = "publish";
/// Most transactions of one route without a verdict; beyond it samples wait, and the newest replace the oldest.
const IN_FLIGHT_MAX: usize = 256;
/// Most bytes of one route without a verdict; the same beyond it.
const IN_FLIGHT_BYTES_MAX: usize = 8 * 1024 * 1024;
/// A batch takes no more samples beyond this, in bytes.
const BATCH_BYTES_MAX: usize = 256 * 1024;
/// The own grant is asked for at most this often.
const REFRESH_EVERY: Duration = Duration::from_millis(500);

/// A route from a local topic to a service.
pub(in crate::routes) struct ToLedger {
    gateway: Arc<dyn Gateway>,
    inlet: Inlet,
    batch_max: usize,
    pace: Pace<Incoming>,
    counters: Counters,
    check: LengthCheck,
    /// Does nothing go out while the user holds no grant?
    withholds: bool,
    /// The age beyond which a command is dropped; none for all that is no command.
    max_age: Option<Duration>,
    /// The last samples of a latched topic; none for commands.
    latch: Option<Latch>,
    clocks: Clocks,
    grant: OwnGrant,
    holders: HolderNames,
    keys: KeySharing,
    /// Where the subscription begins.
    from_height: u64,
    log_limiter: LogLimiter,
    replaced: LogLimiter,
    no_news: LogLimiter,
    refreshed: Option<Instant>,
    /// Bytes without a verdict.
    under_way_bytes: usize,
    /// The other half of a route of calls.
    updates: Option<mpsc::UnboundedSender<SubmitUpdate>>,
}

impl ToLedger {
    /// Learns who the bridge is and what it holds now.
    pub(in crate::routes) async fn open(
        gateway: Arc<dyn Gateway>,
        service: &str,
        inlet: Inlet,
        settings: &Settings,
        counters: Counters,
    ) -> Result<Self, Rejection> {
        let height = gateway.height().await?;
        let (caller, _): (Caller, u64) = ask(&*gateway, height, ABAC, "GetSubmittingClientIdentity", &[]).await?;
        let mut grant = OwnGrant { service: service.to_owned(), me: caller.id, epoch: 0, last_seq: 0, as_of: 0 };
        let (now, as_of) = authorization(Arc::clone(&gateway), height, service.to_owned()).await?;
        grant.learn(as_of, now.epoch, now.next_seq);
        let (grants, _): (Vec<Grant>, u64) = ask(&*gateway, height, ABAC, "grants", &[service]).await?;
        let opened = Self {
            keys: KeySharing::new(Arc::clone(&gateway), Hash::ZERO, false),
            gateway,
            inlet,
            batch_max: settings.batch_max,
            pace: Pace::new(settings.max_rate_hz),
            counters,
            check: LengthCheck::none(),
            withholds: false,
            max_age: None,
            latch: None,
            clocks: Clocks::start(),
            grant,
            holders: HolderNames::of(service, &grants),
            from_height: height.saturating_add(1),
            log_limiter: LogLimiter::default(),
            replaced: LogLimiter::default(),
            no_news: LogLimiter::default(),
            refreshed: None,
            under_way_bytes: 0,
            updates: None,
        };
        opened.tell_grant(None);
        Ok(opened)
    }

    /// For a topic of this service.
    pub(in crate::routes) fn of_topic(
        self,
        network: Hash,
        service: &Service,
        check: LengthCheck,
        settings: &Settings,
    ) -> Self {
        // A command that is said again would move the robot again.
        let latch = (!service.is_command()).then(|| Latch::new(settings.latched));
        let max_age = service.is_command().then_some(Duration::from_millis(service.max_age_ms));
        let mut opened = Self { withholds: settings.held_only, max_age, latch, check, ..self };
        opened.keys = KeySharing::new(Arc::clone(&opened.gateway), network, service.confidential);
        // A user who needs a grant and has none shares when it begins.
        if opened.grant.epoch > 0 || !service.needs_grant() {
            opened.keys.renew_if_confidential(&opened.grant);
        }
        opened
    }

    /// For the local part of a route of calls, which may want to hear of the fate of each sample.
    pub(in crate::routes) fn of_calls(self, updates: Option<mpsc::UnboundedSender<SubmitUpdate>>) -> Self {
        Self { updates, ..self }
    }

    /// The ledger to which it submits.
    pub(in crate::routes) fn gateway(&self) -> &dyn Gateway {
        &*self.gateway
    }

    /// Where its subscription begins.
    pub(in crate::routes) fn begins_at(&self) -> u64 {
        self.from_height
    }

    /// Runs until it is told to end, or the middleware ends.
    pub(in crate::routes) async fn run(mut self, mut shutdown: Shutdown) {
        let mut events = self.gateway.subscribe(Subscription {
            from_height: self.from_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![self.grant.service.clone()],
            names: ["granted", "renewed", "released", "reader"].map(str::to_owned).to_vec(),
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        let mut under_way: FuturesUnordered<BoxFuture<'static, Outcome>> = FuturesUnordered::new();
        let mut refresh: OptionFuture<BoxFuture<'static, Result<(Authorization, u64), Rejection>>> = None.into();
        loop {
            let has_room = under_way.len() < IN_FLIGHT_MAX && self.under_way_bytes < IN_FLIGHT_BYTES_MAX;
            let paced = self.pace.due();
            let follow = changed(self.inlet.qos());
            let again = self.latch.as_ref().filter(|_| self.inlet.is_latched()).and_then(Latch::due);
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break,
                Some(delivery) = events.next() => match delivery {
                    Ok(delivery) => {
                        let held = self.grant.epoch;
                        self.grant.hear(&delivery);
                        self.holders.hear(&delivery);
                        self.hear_of_readers(&delivery, held);
                        self.tell_grant(Some(Instant::now()));
                    }
                    Err(refused) => {
                        if let Some(not_logged) = self.no_news.admit(refused.code.name(), Instant::now()) {
                            tracing::warn!(code = refused.code.name(), reason = one_line(&refused), not_logged, "cannot receive news about grants");
                        }
                    }
                },
                Some(answer) = &mut refresh => {
                    refresh = None.into();
                    match answer {
                        Ok((now, height)) => {
                            self.grant.learn(height, now.epoch, now.next_seq);
                            self.tell_grant(None);
                        }
                        Err(refused) => tracing::warn!(code = refused.code.name(), reason = one_line(&refused), "cannot read the bridge's own grant"),
                    }
                }
                made = self.keys.made() => self.shared(made),
                Some(outcome) = under_way.next() => {
                    let is_due = self.refreshed.is_none_or(|before| before.elapsed() >= REFRESH_EVERY);
                    if self.note(outcome) && is_due {
                        self.refreshed = Some(Instant::now());
                        let (gateway, service) = (Arc::clone(&self.gateway), self.grant.service.clone());
                        refresh = Some(authorization(gateway, self.grant.as_of, service).boxed()).into();
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
                    if let Some(matched) = self.inlet.follow().await {
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
                        tracing::error!(service = self.grant.service, "the local topic ended");
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
        live.held = self.grant.epoch > 0;
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
        let (id, verdict) = match self.keys.sealer().and_then(|sealer| self.grant.call(wall, samples, sealer)) {
            Ok(args) => self.gateway.set(args),
            Err(refused) => (None, std::future::ready(Err(refused)).boxed()),
        };
        if let Some(id) = id {
            self.tell(SubmitUpdate::Submitted(number, id));
        }
        let mut counts = self.counters.lock();
        counts.summary.submitted += received.len() as u64;
        counts.live.came = Some(Instant::now());
        let replaced = self.inlet.dropped();
        let more = replaced.saturating_sub(std::mem::replace(&mut counts.summary.replaced, replaced));
        drop(counts);
        if more > 0 && self.replaced.admit("replaced", Instant::now()).is_some() {
            let service = &self.grant.service;
            tracing::warn!(service, replaced, "the ledger is slower than the topic; newer samples replace older ones");
        }
        self.under_way_bytes = self.under_way_bytes.saturating_add(bytes);
        let key = self.keys.key();
        let submitted = (id, Instant::now());
        verdict.map(move |verdict| Outcome { first: number, received, submitted, bytes, key, verdict }).boxed()
    }

    /// Tells the other half of a route of calls, if this is one.
    fn tell(&self, news: SubmitUpdate) {
        if let Some(updates) = &self.updates {
            // An error means that the other half has ended, and this one will.
            drop(updates.send(news));
        }
    }
}

async fn authorization(
    gateway: Arc<dyn Gateway>,
    height: u64,
    service: String,
) -> Result<(Authorization, u64), Rejection> {
    ask(&*gateway, height, ABAC, "authorize", &[&service, RIGHT]).await
}
