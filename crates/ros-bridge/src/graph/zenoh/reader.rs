//! Takes the samples of one topic.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use bytes::Bytes;
use ledger_gate::sample::Sample;
use ros_zenoh::{
    attachment::Attachment,
    node::Node,
    subscriber::{Incoming as Arrival, Subscriber},
    token::Kind,
};
use rtps::guid::{Guid, SequenceNumber};

use super::{
    failure::zenoh_error,
    held::Held,
    matching::Matching,
    session::{Session, mark_of, token_qos},
};
use crate::{
    error::Result,
    graph::{
        dds::{Intake, Matched},
        loop_filter::{Entry, LoopFilter},
        names::{TopicName, TypeName},
        qos::Qos,
        queue::{Incoming, Limits, Queue},
    },
    log::LogLimiter,
};

/// How far ahead of the clock of this host a sample may seem to be written: the clock is put right now and then.
const AHEAD_MAX: Duration = Duration::from_secs(1);

/// Reads one topic; ends when dropped.
pub(crate) struct Reader {
    queue: Arc<Queue>,
    matching: Matching,
    _subscriber: Subscriber,
}

impl Session {
    /// Starts to read a topic. With a filter, only what it admits is given out.
    pub(crate) fn reader(
        &self,
        (topic, message): (&TopicName, &TypeName),
        qos: &Qos,
        limits: Limits,
        filter: Option<Arc<LoopFilter>>,
    ) -> Result<Reader> {
        qos.validate()?;
        let subject = self.topic(topic, message);
        let queue = Queue::new(&limits);
        let token_qos = token_qos(qos, filter.as_ref().map(|filter| filter.mark()));
        let pump = Arc::new(Pump {
            topic: topic.clone(),
            node: self.node.clone(),
            is_alone: self.is_alone,
            bytes_max: limits.sample_bytes_max,
            queue: Arc::clone(&queue),
            filter,
            publishers: AtomicUsize::new(0),
            state: Mutex::default(),
        });
        let taking = Arc::clone(&pump);
        let subscriber =
            self.node.subscriber(&subject, token_qos, limits.sample_bytes_max, move |arrival| taking.take(arrival));
        let subscriber =
            subscriber.map_err(|error| zenoh_error(&format!("cannot read topic {topic} [{message}]"), &error))?;
        let ending = Arc::clone(&queue);
        let matching = Matching::follow(
            &self.node,
            (subject, Kind::Publisher),
            move |count| pump.announced(count),
            move || ending.close(),
        );
        Ok(Reader { queue, matching, _subscriber: subscriber })
    }
}

impl Reader {
    /// The samples that wait.
    pub(crate) fn queue(&self) -> &Queue {
        &self.queue
    }

    /// The publishers of others.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matching.matched
    }
}

/// The stage between zenoh and the queue of the route.
struct Pump {
    topic: TopicName,
    node: Node,
    is_alone: bool,
    bytes_max: usize,
    queue: Arc<Queue>,
    /// Where samples go to the ledger.
    filter: Option<Arc<LoopFilter>>,
    /// The announced publishers of the topic.
    publishers: AtomicUsize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    intake: Intake,
    /// Samples for the ledger that came before a publisher of the topic was announced.
    held: Held<Incoming>,
    log_limiter: LogLimiter,
}

impl Pump {
    /// Takes what has come, on a thread of zenoh.
    fn take(&self, arrival: Arrival) {
        let mut state = self.lock();
        match arrival {
            Arrival::Message(payload, attachment) => self.take_message(&mut state, payload, &attachment),
            Arrival::TooLong(bytes) => {
                self.queue.count_dropped(1);
                if let Some(not_logged) = state.log_limiter.admit("large", Instant::now()) {
                    let bytes_max = self.bytes_max;
                    tracing::warn!(topic = %self.topic, bytes, bytes_max, not_logged, "a sample was dropped: larger than sample_bytes_max");
                }
            }
            Arrival::Malformed => {
                self.lose(&mut state, "it has no attachment of rmw_zenoh, so no ROS 2 node has sent it")
            }
        }
    }

    fn take_message(&self, state: &mut State, payload: Bytes, attachment: &Attachment) {
        let Attachment { sequence, time, gid } = *attachment;
        if !state.intake.admits_any(Guid::from_bytes(gid), SequenceNumber(sequence)) {
            return;
        }
        let Ok(sample) = Sample::from_wire(payload, self.bytes_max) else {
            return self.lose(state, "it is no CDR, so its publisher has another `type` than this route");
        };
        let (received, wall) = (Instant::now(), SystemTime::now());
        let waited = if self.is_alone { since(time, wall) } else { Duration::ZERO };
        let sequence = u64::try_from(sequence).unwrap_or_default();
        let incoming = Incoming { sample, source: gid, sequence, received, wall, waited };
        if self.is_announced(&gid) && state.held.is_empty() {
            self.admit(incoming);
        } else if state.held.push(incoming, received).is_some() {
            self.lose(state, UNANNOUNCED);
        }
    }

    /// May a sample of this source go to the ledger? A publisher of the topic must be announced. Its token need not have that
    /// identifier: some implementations take it from elsewhere. One with a mark has it.
    fn is_announced(&self, source: &[u8; 16]) -> bool {
        let is_known = || self.node.graph().endpoint(source).is_some();
        self.filter.is_none() || self.publishers.load(Ordering::Relaxed) > 0 || is_known()
    }

    /// Takes the number of announced publishers, and gives out the samples that waited for one.
    fn announced(&self, count: usize) {
        self.publishers.store(count, Ordering::Relaxed);
        let mut state = self.lock();
        if state.held.is_empty() {
            return;
        }
        let (released, late) = state.held.release(Instant::now(), |incoming| self.is_announced(&incoming.source));
        released.into_iter().for_each(|incoming| self.admit(incoming));
        late.iter().for_each(|_| self.lose(&mut state, UNANNOUNCED));
    }

    /// Gives out a sample, if the filter lets it pass.
    fn admit(&self, incoming: Incoming) {
        let entry = self.filter.as_ref().map_or(Entry::Admit, |filter| {
            let mark = self.node.graph().endpoint(&incoming.source).and_then(|endpoint| mark_of(&endpoint));
            filter.judge(incoming.source, mark, incoming.sample.wire(), incoming.received)
        });
        if entry == Entry::Admit {
            self.queue.push(incoming);
        }
    }

    fn lose(&self, state: &mut State, reason: &'static str) {
        self.queue.count_dropped(1);
        if let Some(not_logged) = state.log_limiter.admit(reason, Instant::now()) {
            tracing::warn!(topic = %self.topic, not_logged, "a sample was dropped: {reason}");
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why a sample of an unknown publisher is lost.
const UNANNOUNCED: &str = "no publisher of this topic is announced in the graph";

/// How long ago that was by the clock of this host, in nanoseconds since 1970; zero if it is no time. If it lies ahead, the clock was
/// set back since then, and the age is unknown.
fn since(sent: i64, now: SystemTime) -> Duration {
    let now = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    let sent = match u64::try_from(sent) {
        Ok(sent) if sent > 0 => Duration::from_nanos(sent),
        _ => return Duration::ZERO,
    };
    if sent > now.saturating_add(AHEAD_MAX) { Duration::MAX } else { now.saturating_sub(sent) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_of_before_the_clock_was_set_back_is_older_than_any_and_one_without_a_time_is_not_old() {
        let now = UNIX_EPOCH + Duration::from_secs(7200);
        let at = |seconds: i64| since(seconds * 1_000_000_000, now);
        assert_eq!([at(0), at(-5)], [Duration::ZERO; 2]);
        assert_eq!(at(7200 + 3600), Duration::MAX);
        assert_eq!(at(7200 + 1), Duration::ZERO);
        assert_eq!(at(7140), Duration::from_secs(60));
    }
}
