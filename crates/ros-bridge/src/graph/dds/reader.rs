//! Takes the samples of one topic.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant, SystemTime},
};

use futures::StreamExt;
use ledger_gate::sample::Sample;
use rustdds::{DataReaderStatus, GUID, StatusEvented, Timestamp, no_key::SimpleDataReader};
use tokio::{task::JoinHandle, time::interval};

use super::{
    encoding::{AnyRaw, accepted},
    failure::dds_error,
    intake::{Intake, Verdict},
    matched::{ALIVE_EVERY, Matched, Matches},
    participant::Participant,
    remedy::remedy,
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
/// How far ahead of the clock of this host a sample may seem to be written: the clock is put right now and then. In parts of a
/// second, of which there are 2^32.
const AHEAD_TICKS_MAX: u64 = 1 << 32;

/// Reads one topic; ends when dropped. A task moves samples from DDS into a queue that is limited in bytes.
pub struct Reader {
    queue: Arc<Queue>,
    matched: Matched,
    guid: GUID,
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
        let failed = |error| dds_error(&format!("cannot read topic {topic} [{message}]"), &error);
        let dds_topic = participant.topic(topic, message, qos)?;
        let policies = qos.policies();
        let policies = participant.with_type_hash(policies, message);
        let policies = filter.as_ref().map_or_else(|| policies.clone(), |filter| filter.mark().put_on(&policies));
        let policies = policies.with_data_representation(accepted());
        // With one clock, a sample tells whether it is history. Otherwise its place before the first HEARTBEAT does.
        let policies = if participant.is_alone { policies } else { policies.without_history() };
        let opened = (qos.durability == Durability::Volatile).then(Instant::now);
        let subscriber = participant.dds.create_subscriber(&qos.policies()).map_err(failed)?;
        let source: SimpleDataReader<Sample, AnyRaw> =
            subscriber.create_simple_datareader_no_key(&dds_topic, Some(policies)).map_err(failed)?;
        let guid = source.guid();
        let (matches, matched) = Matches::new(participant.guid_prefix());
        let queue = Queue::new(&limits);
        let pump = Pump {
            topic: topic.clone(),
            opened,
            intake: Intake::new(participant.guid_prefix()),
            matches,
            sample_bytes_max: limits.sample_bytes_max,
            queue: Arc::clone(&queue),
            participant: participant.clone(),
            filter,
            marks: BTreeMap::new(),
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
    matches: Matches,
    sample_bytes_max: usize,
    queue: Arc<Queue>,
    /// Held, so that it outlives its reader.
    participant: Participant,
    /// Where samples go to the ledger.
    filter: Option<Arc<LoopFilter>>,
    /// The marks of writers that were looked up.
    marks: BTreeMap<[u8; 16], Option<Mark>>,
    log_limiter: LogLimiter,
}

impl Pump {
    /// Runs until the reader is dropped.
    async fn run(mut self, source: SimpleDataReader<Sample, AnyRaw>) {
        let samples = source.as_async_stream();
        let mut samples = std::pin::pin!(samples);
        let mut statuses = source.as_async_status_stream();
        let mut alive = interval(ALIVE_EVERY);
        loop {
            tokio::select! {
                sample = samples.next() => match sample {
                    Some(Ok(change)) => {
                        let waited = self.waited(change.source_timestamp());
                        self.take(change.writer_guid, change.sequence_number.into(), change.sample, waited);
                    }
                    Some(Err(error)) => self.drop_unreadable(&error),
                    None => break,
                },
                status = statuses.next() => match status {
                    Some(status) => self.note(&status),
                    None => break,
                },
                // Nobody is woken when DDS ends, so it is looked at again.
                _ = alive.tick() => {}
            }
        }
        tracing::error!(topic = %self.topic, "DDS has ended: no sample is read any more");
        self.queue.close();
    }

    /// How long a sample was on its way, by the time that its publisher gave it. That lies far back where this process stood still
    /// and the sample waited in a socket. It says something only if its clock is ours: other hosts have other clocks.
    fn waited(&self, sent: Option<Timestamp>) -> Duration {
        sent.filter(|_| self.participant.is_alone).map_or(Duration::ZERO, since)
    }

    fn take(&mut self, writer: GUID, sequence: i64, sample: Sample, waited: Duration) {
        let source = writer.to_bytes();
        if self.matches.with_endpoints(|present| self.intake.judge(source, sequence, present)) != Verdict::Admit {
            return;
        }
        // A publisher may send what it keeps for others, or for those who come late.
        if self.opened.is_some_and(|opened| waited > opened.elapsed()) {
            return self.skip_history();
        }
        if sample.wire().len() > self.sample_bytes_max {
            return self.drop_large(sample.wire().len());
        }
        let received = Instant::now();
        if let Some(filter) = self.filter.clone() {
            let mark = self.mark_of(source, &filter);
            if filter.judge(source, mark, sample.wire(), received) != Entry::Admit {
                return;
            }
        }
        let sequence = u64::try_from(sequence).unwrap_or_default();
        self.queue.push(Incoming { sample, source, sequence, received, wall: SystemTime::now(), waited });
    }

    fn skip_history(&mut self) {
        if let Some(not_logged) = self.log_limiter.admit("history", Instant::now()) {
            tracing::info!(topic = %self.topic, not_logged, "a sample is not taken in: its publisher wrote it before this route read the topic");
        }
    }

    fn drop_large(&mut self, bytes: usize) {
        self.queue.count_dropped();
        if let Some(not_logged) = self.log_limiter.admit("large", Instant::now()) {
            let bytes_max = self.sample_bytes_max;
            tracing::warn!(topic = %self.topic, bytes, bytes_max, not_logged, "a sample was dropped: larger than sample_bytes_max");
        }
    }

    fn drop_unreadable(&mut self, error: &dyn std::error::Error) {
        self.queue.count_dropped();
        if let Some(not_logged) = self.log_limiter.admit("unreadable", Instant::now()) {
            tracing::warn!(topic = %self.topic, %error, not_logged, "a sample was dropped: no CDR, so its publisher has another `type` than this route");
        }
    }

    /// The mark of a writer. Discovery knew it before its first sample was let in; a writer that is not found there has left.
    fn mark_of(&mut self, writer: [u8; 16], filter: &LoopFilter) -> Option<Mark> {
        if let Some(known) = self.marks.get(&writer) {
            return *known;
        }
        if self.marks.len() >= MARKS_MAX {
            self.marks.clear();
        }
        let mut found = None;
        for neighbour in self.participant.publishers() {
            if let Some(mark) = neighbour.mark {
                filter.hear_of(mark);
            }
            if neighbour.guid == writer {
                found = neighbour.mark;
                self.marks.insert(writer, found);
            }
        }
        found
    }

    fn note(&mut self, status: &DataReaderStatus) {
        match status {
            DataReaderStatus::SubscriptionMatched { current, writer, .. } => {
                self.matches.changed(*writer, current.count_change());
            }
            DataReaderStatus::RequestedIncompatibleQos { last_policy_id, .. } => {
                self.matches.refused();
                let (policy, remedy) = (format!("{last_policy_id:?}"), remedy(Role::Reads, *last_policy_id));
                if let Some(not_logged) = self.log_limiter.admit(remedy, Instant::now()) {
                    tracing::warn!(topic = %self.topic, policy, not_logged, "a publisher offers less than this route requests: {remedy}");
                }
            }
            DataReaderStatus::SampleLost { count } => {
                tracing::debug!(topic = %self.topic, lost = count.count(), "samples were lost before they reached the bridge");
            }
            _ => {}
        }
    }
}

/// How long ago that was by the clock of this host; zero if it is no time. If it lies ahead, the clock was set back since then,
/// and nobody knows.
fn since(sent: Timestamp) -> Duration {
    if [Timestamp::ZERO, Timestamp::INVALID, Timestamp::INFINITE].contains(&sent) {
        return Duration::ZERO;
    }
    let (now, sent) = (Timestamp::now().to_ticks(), sent.to_ticks());
    if sent > now.saturating_add(AHEAD_TICKS_MAX) {
        return Duration::MAX;
    }
    let ticks = now.saturating_sub(sent);
    let micros = (u128::from(ticks) * 1_000_000) >> 32_u32;
    Duration::from_micros(u64::try_from(micros).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_of_before_the_clock_was_set_back_is_older_than_any_and_one_without_a_time_is_not_old() {
        for sent in [Timestamp::ZERO, Timestamp::INVALID, Timestamp::INFINITE] {
            assert_eq!(since(sent), Duration::ZERO, "{sent:?}");
        }
        let ahead = Timestamp::from_ticks(Timestamp::now().to_ticks() + (3600 << 32));
        assert_eq!(since(ahead), Duration::MAX);
        let before = Timestamp::from_ticks(Timestamp::now().to_ticks() - (60 << 32));
        assert!(since(before) >= Duration::from_secs(60));
    }
}
