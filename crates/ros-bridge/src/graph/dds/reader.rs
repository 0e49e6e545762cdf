//! Takes the samples of one topic.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant, SystemTime},
};

use ledger_base::rejection::Rejection;
use ledger_gate::sample::Sample;
use rtps::{
    guid::Guid,
    interface::{EndpointSettings, IncomingSample},
    io::{DomainReader, Losses, QueueLimits},
    time::Ticks,
};
use tokio::task::JoinHandle;

use super::{
    encoding::accepting,
    failure::dds_error,
    intake::Intake,
    matched::{Matched, MismatchLog},
    participant::{Participant, described},
    remedy,
    ros_discovery::{Role, RosDiscovery},
};
use crate::{
    error::Result,
    graph::{
        loop_filter::{Entry, LoopFilter},
        mark::Mark,
        names::{TopicName, TypeName},
        qos::{Durability, Qos},
        queue::{Incoming, Limits, Queue},
    },
    log::LogLimiter,
};

/// Most writers whose mark is remembered; beyond it all are looked up again.
const MARKS_MAX: usize = 4096;
/// How far ahead of the clock of this host a sample may seem to be written, microseconds: the clock is put right now and then.
const AHEAD_MICROS_MAX: u64 = 1_000_000;
/// Most samples that wait for the task of a reader. The queue of the route is behind it.
const WAITING_MAX: usize = 1024;
/// The log where a writer offers too little.
pub(super) const OFFERS_LESS: &str = "a publisher offers less than this route requests";

/// Reads one topic; ends when dropped. A task moves samples from DDS into the queue of the route.
pub struct Reader {
    queue: Arc<Queue>,
    matched: Matched,
    guid: Guid,
    discovery: Arc<RosDiscovery>,
    pump: JoinHandle<()>,
}

impl Participant {
    /// Starts to read a topic. Samples of this participant's own writers are never given out.
    pub fn reader(&self, topic: &TopicName, message: &TypeName, qos: &Qos, limits: Limits) -> Result<Reader> {
        Reader::open(self, topic, message, qos, limits, None)
    }

    /// Starts to read a topic whose samples go to the ledger: only what the filter admits is given out. Other bridges
    /// see whose filter it is.
    pub fn reader_behind(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        limits: Limits,
        filter: Arc<LoopFilter>,
    ) -> Result<Reader> {
        Reader::open(self, topic, message, qos, limits, Some(filter))
    }
}

impl Reader {
    fn open(
        participant: &Participant,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        limits: Limits,
        filter: Option<Arc<LoopFilter>>,
    ) -> Result<Self> {
        let description = described(topic, message, qos)?;
        let policies = accepting(qos.policies());
        let settings = EndpointSettings {
            topic: description,
            qos: filter.as_ref().map_or_else(|| policies.clone(), |filter| filter.mark().put_on(policies.clone())),
            user_data: participant.type_hash(message),
            // With one clock, its timestamp shows whether a sample is history. Otherwise its place before the first HEARTBEAT does.
            without_history: !participant.is_alone && qos.durability == Durability::Volatile,
        };
        let opened = (qos.durability == Durability::Volatile).then(Instant::now);
        let waiting = QueueLimits { bytes: limits.queue_bytes_max, samples: WAITING_MAX };
        let source = participant
            .dds
            .reader(settings, waiting)
            .map_err(|error| dds_error(&format!("cannot read topic {topic} [{message}]"), &error))?;
        let (guid, matched) = (source.guid(), Matched::of(source.matches()));
        let queue = Queue::new(&limits);
        let pump = Pump {
            topic: topic.clone(),
            opened,
            intake: Intake::default(),
            mismatches: MismatchLog::new(topic.to_string(), OFFERS_LESS, remedy::for_reader),
            sample_bytes_max: limits.sample_bytes_max,
            queue: Arc::clone(&queue),
            participant: participant.clone(),
            filter,
            marks: BTreeMap::new(),
            losses: Losses::default(),
            log_limiter: LogLimiter::default(),
        };
        participant.discovery.add(Role::Reads, guid);
        Ok(Self {
            queue,
            matched,
            guid,
            discovery: Arc::clone(&participant.discovery),
            pump: tokio::spawn(pump.run(source)),
        })
    }

    /// The next sample, as soon as there is one; `None` only if DDS ended. Cancelling it loses nothing.
    pub async fn next(&mut self) -> Option<Incoming> {
        self.queue.next().await
    }

    /// The next sample if one waits.
    pub fn try_next(&mut self) -> Option<Incoming> {
        self.queue.try_next()
    }

    /// The writers of others.
    pub fn matched(&self) -> &Matched {
        &self.matched
    }

    /// The samples that wait.
    pub(crate) fn queue(&self) -> &Queue {
        &self.queue
    }

    /// Samples dropped so far: too large, or pushed out of a full queue.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.discovery.remove(Role::Reads, self.guid);
        self.pump.abort();
    }
}

/// The state of the task behind a reader.
struct Pump {
    topic: TopicName,
    /// When a reader was opened that takes nothing written before; none if it is latched.
    opened: Option<Instant>,
    intake: Intake,
    mismatches: MismatchLog,
    sample_bytes_max: usize,
    queue: Arc<Queue>,
    /// Held, so that it outlives its reader.
    participant: Participant,
    /// Where samples go to the ledger.
    filter: Option<Arc<LoopFilter>>,
    /// The marks of writers that were looked up.
    marks: BTreeMap<Guid, Option<Mark>>,
    /// The losses that the queue of the route has counted.
    losses: Losses,
    log_limiter: LogLimiter,
}

impl Pump {
    /// Runs until the reader is dropped.
    async fn run(mut self, mut source: DomainReader) {
        let mut matches = source.matches().clone();
        loop {
            tokio::select! {
                sample = source.next() => match sample {
                    Some(sample) => self.take(sample, &source),
                    None => break,
                },
                Ok(()) = matches.changed() => self.mismatches.look(&matches.borrow_and_update()),
            }
            self.count_losses(source.losses());
        }
        tracing::error!(topic = %self.topic, "DDS ended; no samples are read any more");
        self.queue.close();
    }

    /// How long a sample was on its way, by the time that its publisher gave it. That lies far back where this process stood still
    /// and the sample waited in a socket. It says something only if its clock is ours: other hosts have other clocks.
    fn waited(&self, sent: Option<Ticks>) -> Duration {
        sent.filter(|_| self.participant.is_alone).map_or(Duration::ZERO, |sent| since(sent, SystemTime::now()))
    }

    fn take(&mut self, incoming: IncomingSample, source: &DomainReader) {
        let IncomingSample { writer, sequence, timestamp, payload, .. } = incoming;
        if !self.intake.admits(writer, sequence, &source.matches().borrow().endpoints) {
            return;
        }
        let waited = self.waited(timestamp);
        // A publisher may send what it keeps for others, or for those who come late.
        if self.opened.is_some_and(|opened| waited > opened.elapsed()) {
            return self.skip_history();
        }
        if payload.len() > self.sample_bytes_max {
            return self.drop_large(payload.len());
        }
        let sample = match Sample::from_wire(payload, self.sample_bytes_max) {
            Ok(sample) => sample,
            Err(rejection) => return self.drop_unreadable(&rejection),
        };
        let received = Instant::now();
        if let Some(filter) = self.filter.clone() {
            let mark = self.mark_of(writer, &filter);
            if filter.judge(writer.to_bytes(), mark, sample.wire(), received) != Entry::Admit {
                return;
            }
        }
        let sequence = u64::try_from(sequence.0).unwrap_or_default();
        let (source, wall) = (writer.to_bytes(), SystemTime::now());
        self.queue.push(Incoming { sample, source, sequence, received, wall, waited });
    }

    /// Counts what was lost on the way here.
    fn count_losses(&mut self, losses: Losses) {
        if losses == self.losses {
            return;
        }
        self.queue.count_dropped(losses.dropped.saturating_sub(self.losses.dropped));
        for (reason, count) in &losses.lost {
            let lost = count.saturating_sub(self.losses.lost.get(reason).copied().unwrap_or_default());
            // A best-effort sample may be lost without a fault.
            if lost > 0 && reason.is_best_effort() {
                tracing::debug!(topic = %self.topic, lost, "samples lost before they reached the bridge");
            } else if lost > 0
                && let Some(not_logged) = self.log_limiter.admit("lost", Instant::now())
            {
                let reason = reason.name();
                tracing::warn!(topic = %self.topic, lost, reason, not_logged, "samples lost before they reached the bridge");
            }
        }
        self.losses = losses;
    }

    fn skip_history(&mut self) {
        if let Some(not_logged) = self.log_limiter.admit("history", Instant::now()) {
            tracing::info!(topic = %self.topic, not_logged, "sample ignored: written before this route read the topic");
        }
    }

    fn drop_large(&mut self, bytes: usize) {
        self.queue.count_dropped(1);
        if let Some(not_logged) = self.log_limiter.admit("large", Instant::now()) {
            let bytes_max = self.sample_bytes_max;
            tracing::warn!(topic = %self.topic, bytes, bytes_max, not_logged, "a sample was dropped: larger than sample_bytes_max");
        }
    }

    fn drop_unreadable(&mut self, error: &Rejection) {
        self.queue.count_dropped(1);
        if let Some(not_logged) = self.log_limiter.admit("unreadable", Instant::now()) {
            tracing::warn!(topic = %self.topic, %error, not_logged, "sample dropped: not CDR, so its publisher has another `type` than this route");
        }
    }

    /// The mark of a writer. Discovery knew it before its first sample was let in; a writer that is not found there has left.
    fn mark_of(&mut self, writer: Guid, filter: &LoopFilter) -> Option<Mark> {
        if let Some(known) = self.marks.get(&writer) {
            return *known;
        }
        if self.marks.len() >= MARKS_MAX {
            self.marks.clear();
        }
        self.participant.publishers().filter_map(|neighbour| neighbour.mark).for_each(|mark| filter.hear_of(mark));
        let found = self.participant.dds.endpoint(writer)?;
        let mark = Mark::of(&found.qos);
        self.marks.insert(writer, mark);
        mark
    }
}

/// How long ago that was by the clock of this host; zero if it is no time. If it lies ahead, the clock was set back since then,
/// and the age is unknown.
fn since(sent: Ticks, now: SystemTime) -> Duration {
    let now = now.duration_since(SystemTime::UNIX_EPOCH).map_or(0, rtps::time::micros);
    let Some(sent) = sent.to_micros().filter(|sent| *sent > 0) else { return Duration::ZERO };
    if sent > now.saturating_add(AHEAD_MICROS_MAX) {
        return Duration::MAX;
    }
    Duration::from_micros(now.saturating_sub(sent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_of_before_the_clock_was_set_back_is_older_than_any_and_one_without_a_time_is_not_old() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(7200);
        let at = |seconds: u64| since(Ticks::from_micros(seconds * 1_000_000), now);
        for sent in [Ticks::ZERO, Ticks::INVALID, Ticks::INFINITE] {
            assert_eq!(since(sent, now), Duration::ZERO, "{sent:?}");
        }
        assert_eq!(at(7200 + 3600), Duration::MAX);
        assert_eq!(at(7200 + 1), Duration::ZERO);
        assert_eq!(at(7140), Duration::from_secs(60));
    }
}
