//! From the local graph to the ledger: every sample becomes a signed transaction, in the order in which they came.
//!
//! Nothing waits for an earlier verdict, and no batch waits to be filled. When the ledger is slower than the topic,
//! the newest samples replace the oldest that wait, and that is counted.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{
    FutureExt, StreamExt,
    future::{BoxFuture, OptionFuture},
    stream::FuturesUnordered,
};
use ledger_api::{Subscription, v1::Delivery};
use ledger_rejection::{Code, Rejection};

use super::{Clocks, Stop, local::Inlet, stopped};
use crate::{
    config::HEARTBEAT_MS,
    count::{Complaint, Counters, count, line},
    fit::Fit,
    gateway::{ABAC, Gateway, ask},
    queue::Incoming,
    service::{Authorization, Caller, Grant, Released, read},
};

/// Most transactions of one route without a verdict; beyond it samples wait, and the newest replace the oldest.
const IN_FLIGHT_MAX: usize = 256;
/// Most bytes of one route without a verdict; the same beyond it.
const IN_FLIGHT_BYTES_MAX: usize = 8 * 1024 * 1024;
/// A batch takes no more samples beyond this, in bytes.
const BATCH_BYTES_MAX: usize = 256 * 1024;
/// The own grant is asked for at most this often.
const REFRESH_EVERY: Duration = Duration::from_millis(500);

/// The own grant as far as it is known, and the next sequence number.
#[derive(Debug)]
struct Publishing {
    service: String,
    /// `Org1/Salma`.
    me: String,
    /// 0 without a grant.
    epoch: u64,
    /// The largest sequence number used or known to be used.
    last_seq: u64,
    /// Height of the newest knowledge about the grant.
    as_of: u64,
}

impl Publishing {
    /// Arguments of `set` for these samples, in order. Numbers go on from the clock, so that a restarted bridge, or
    /// another one of the same user, goes on above what was used before.
    fn call(&mut self, wall_us: u64, samples: &[Incoming]) -> Vec<Bytes> {
        let first = self.last_seq.saturating_add(1).max(wall_us);
        self.last_seq = first.saturating_add(samples.len() as u64).saturating_sub(1);
        let head = [self.service.clone(), self.epoch.to_string(), first.to_string()];
        head.into_iter().map(Bytes::from).chain(samples.iter().map(|incoming| incoming.sample.wire().clone())).collect()
    }

    /// Events about the own grant.
    fn hear(&mut self, delivery: &Delivery) {
        for event in &delivery.events {
            match event.name.as_str() {
                "granted" | "renewed" => {
                    if let Some(grant) = read::<Grant>(&event.payload).filter(|grant| grant.holder == self.me) {
                        self.learn(delivery.height, grant.epoch, grant.next_seq);
                    }
                }
                "released" => {
                    let own = |released: &Released| released.holder == self.me && released.epoch == self.epoch;
                    if read::<Released>(&event.payload).is_some_and(|released| own(&released)) {
                        self.learn(delivery.height, 0, 0);
                    }
                }
                _ => {}
            }
        }
        self.as_of = self.as_of.max(delivery.height);
    }

    /// Takes over what is newer than what is known.
    fn learn(&mut self, height: u64, epoch: u64, next_seq: u64) {
        if height < self.as_of {
            return;
        }
        self.as_of = height;
        self.last_seq = self.last_seq.max(next_seq.saturating_sub(1));
        if self.epoch != epoch {
            tracing::info!(service = self.service, epoch, "{}", if epoch == 0 { "grant ended" } else { "grant held" });
            self.epoch = epoch;
        }
    }
}

/// A route from a local topic to a service.
pub(crate) struct ToLedger {
    gateway: Arc<dyn Gateway>,
    inlet: Inlet,
    batch_max: usize,
    counters: Counters,
    fit: Fit,
    clocks: Clocks,
    publishing: Publishing,
    /// Where the subscription begins.
    from_height: u64,
    complaint: Complaint,
    replaced: Complaint,
    no_news: Complaint,
    refreshed: Option<Instant>,
    /// Bytes without a verdict.
    under_way_bytes: usize,
}

/// The outcome of samples that were submitted together.
struct Outcome {
    /// When each was taken in.
    received: Vec<Instant>,
    bytes: usize,
    verdict: Result<(), Rejection>,
}

impl ToLedger {
    /// Learns who the bridge is and what it holds now.
    pub(crate) async fn open(
        gateway: Arc<dyn Gateway>,
        service: &str,
        (inlet, fit): (Inlet, Fit),
        batch_max: usize,
        counters: Counters,
    ) -> Result<Self, Rejection> {
        let height = gateway.height().await?;
        let (caller, _): (Caller, u64) = ask(&*gateway, height, ABAC, "GetSubmittingClientIdentity", &[]).await?;
        let mut publishing = Publishing { service: service.to_owned(), me: caller.id, epoch: 0, last_seq: 0, as_of: 0 };
        let (now, as_of) = authorization(Arc::clone(&gateway), height, service.to_owned()).await?;
        publishing.learn(as_of, now.epoch, now.next_seq);
        counters.lock().live.held = publishing.epoch > 0;
        Ok(Self {
            gateway,
            inlet,
            batch_max,
            counters,
            fit,
            clocks: Clocks::start(),
            publishing,
            from_height: height.saturating_add(1),
            complaint: Complaint::default(),
            replaced: Complaint::default(),
            no_news: Complaint::default(),
            refreshed: None,
            under_way_bytes: 0,
        })
    }

    /// Runs until it is told to end, or the middleware ends.
    pub(crate) async fn run(mut self, mut stop: Stop) {
        let mut events = self.gateway.subscribe(Subscription {
            from_height: self.from_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![self.publishing.service.clone()],
            names: ["granted", "renewed", "released"].map(str::to_owned).to_vec(),
            heartbeat: HEARTBEAT_MS,
        });
        let mut under_way: FuturesUnordered<BoxFuture<'static, Outcome>> = FuturesUnordered::new();
        let mut refresh: OptionFuture<BoxFuture<'static, Result<(Authorization, u64), Rejection>>> = None.into();
        loop {
            let has_room = under_way.len() < IN_FLIGHT_MAX && self.under_way_bytes < IN_FLIGHT_BYTES_MAX;
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break,
                Some(delivery) = events.next() => match delivery {
                    Ok(delivery) => {
                        self.publishing.hear(&delivery);
                        self.tell_grant(Some(Instant::now()));
                    }
                    Err(refused) => {
                        if let Some(not_logged) = self.no_news.worth(refused.code.name(), Instant::now()) {
                            tracing::warn!(reason = line(&refused), not_logged, "cannot receive news about grants");
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
                        Err(refused) => tracing::warn!(reason = line(&refused), "cannot read the bridge's own grant"),
                    }
                }
                Some(outcome) = under_way.next() => {
                    let is_due = self.refreshed.is_none_or(|before| before.elapsed() >= REFRESH_EVERY);
                    if self.note(outcome) && is_due {
                        self.refreshed = Some(Instant::now());
                        let (gateway, service) = (Arc::clone(&self.gateway), self.publishing.service.clone());
                        refresh = Some(authorization(gateway, self.publishing.as_of, service).boxed()).into();
                    }
                }
                incoming = self.inlet.next(), if has_room => match incoming {
                    Some(incoming) if self.fits(&incoming) => under_way.push(self.submit(incoming)),
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

    /// Tells the reporter how the own grant stands, and when the ledger was heard.
    fn tell_grant(&self, heard: Option<Instant>) {
        let live = &mut self.counters.lock().live;
        live.held = self.publishing.epoch > 0;
        live.heard = heard.or(live.heard);
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
        let verdict = self.gateway.set(self.publishing.call(self.clocks.now().wall, &samples));
        let received: Vec<Instant> = samples.iter().map(|incoming| incoming.received).collect();
        let mut counts = self.counters.lock();
        counts.summary.samples_in += received.len() as u64;
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
        verdict.map(move |verdict| Outcome { received, bytes, verdict }).boxed()
    }

    /// Can the sample be a message of the route's type? One that cannot is counted as refused here and never submitted.
    fn fits(&mut self, incoming: &Incoming) -> bool {
        let Err(refused) = self.fit.check(&incoming.sample) else { return true };
        let mut counts = self.counters.lock();
        let now = Instant::now();
        counts.summary.samples_in += 1;
        count(&mut counts.summary.refused, refused.code.name(), 1);
        counts.live.came = Some(now);
        counts.live.refused = Some((refused.code.name(), line(&refused), now));
        drop(counts);
        if let Some(not_logged) = self.complaint.worth(refused.code.name(), now) {
            let service = &self.publishing.service;
            tracing::warn!(service, reason = line(&refused), not_logged, "samples do not fit the type");
        }
        false
    }

    /// Counts an outcome. True if the own grant seems to be another than is known.
    fn note(&mut self, Outcome { received, bytes, verdict }: Outcome) -> bool {
        self.under_way_bytes = self.under_way_bytes.saturating_sub(bytes);
        let mut counts = self.counters.lock();
        let now = Instant::now();
        let refused = match verdict {
            Ok(()) => {
                for taken in received {
                    counts.committed(now.saturating_duration_since(taken));
                }
                return false;
            }
            Err(refused) => refused,
        };
        count(&mut counts.summary.refused, refused.code.name(), received.len() as u64);
        counts.live.refused = Some((refused.code.name(), line(&refused), now));
        drop(counts);
        if let Some(silent) = self.complaint.worth(refused.code.name(), now) {
            let service = &self.publishing.service;
            tracing::warn!(service, reason = line(&refused), not_logged = silent, "the ledger refuses samples");
        }
        matches!(refused.code, Code::NotHolder | Code::StaleEpoch | Code::StaleSequence)
    }
}

async fn authorization(
    gateway: Arc<dyn Gateway>,
    height: u64,
    service: String,
) -> Result<(Authorization, u64), Rejection> {
    ask(&*gateway, height, ABAC, "authorize", &[&service, "publish"]).await
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::sample::{CDR_LE, Sample};
    use ledger_api::v1::EventRecord;

    fn publishing() -> Publishing {
        Publishing { service: "T/cmd_vel".into(), me: "Org1/Salma".into(), epoch: 0, last_seq: 0, as_of: 0 }
    }

    fn samples(count: u64) -> Vec<Incoming> {
        let sample = Sample::new(CDR_LE, &[7]).unwrap();
        let received = Instant::now();
        (1..=count).map(|sequence| Incoming { sample: sample.clone(), source: [0; 16], sequence, received }).collect()
    }

    fn event(height: u64, name: &str, holder: &str, epoch: u64) -> Delivery {
        let payload = serde_json::json!({ "service": "T/cmd_vel", "holder": holder, "epoch": epoch, "lease_ms": 1, "reason": "x" });
        let payload = Bytes::from(payload.to_string());
        let event = EventRecord { name: name.into(), payload, ..EventRecord::default() };
        Delivery { height, events: vec![event], ..Delivery::default() }
    }

    #[test]
    fn numbers_follow_the_clock_and_never_repeat() {
        let mut publishing = publishing();
        let number = |args: Vec<Bytes>| String::from_utf8(args.get(2).unwrap().to_vec()).unwrap();
        assert_eq!(number(publishing.call(1000, &samples(3))), "1000");
        assert_eq!(number(publishing.call(1001, &samples(1))), "1003", "the three before end with 1002");
        assert_eq!(number(publishing.call(500, &samples(1))), "1004", "the clock went back");
        publishing.learn(1, 4, 9000);
        assert_eq!(number(publishing.call(2000, &samples(1))), "9000", "the ledger knows larger ones");
    }

    #[test]
    fn the_epoch_is_that_of_the_own_grant_only() {
        let mut publishing = publishing();
        publishing.hear(&event(5, "granted", "Org1/Farhad", 3));
        assert_eq!(publishing.epoch, 0);
        publishing.hear(&event(6, "granted", "Org1/Salma", 4));
        assert_eq!(publishing.epoch, 4);
        publishing.hear(&event(7, "released", "Org1/Salma", 3));
        assert_eq!(publishing.epoch, 4, "an older grant ended");
        publishing.learn(6, 3, 0);
        assert_eq!(publishing.epoch, 4, "an answer from an older state changes nothing");
        publishing.hear(&event(8, "released", "Org1/Salma", 4));
        assert_eq!(publishing.epoch, 0);
        let args = publishing.call(1, &samples(1));
        assert_eq!(args.get(1).unwrap(), "0");
    }
}
