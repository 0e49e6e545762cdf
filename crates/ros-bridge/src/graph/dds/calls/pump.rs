//! The task behind a link: takes what DDS has read, and gives it out when its reply would be heard.

use std::{collections::BTreeMap, time::Instant};

use bytes::Bytes;
use futures::StreamExt;
use ledger_gate::sample::{CDR_LE, HEADER_BYTES, Sample};
use rustdds::{DataReaderStatus, GUID, StatusEvented, no_key::SimpleDataReader, rpc::SampleIdentity};
use tokio::{
    sync::mpsc,
    time::{interval, sleep_until},
};

use super::{
    arrival::{Arrival, Side},
    mapping::named,
    waiting::WaitingRequests,
};
use crate::{
    graph::{
        dds::{
            encoding::AnyRaw,
            guid::prefix,
            intake::{Intake, Verdict},
            matched::{ALIVE_EVERY, Matched, Matches},
            participant::Participant,
        },
        mark::Mark,
    },
    log::LogLimiter,
};

/// Most writers whose mark is remembered; beyond it all are looked up again.
const MARKS_MAX: usize = 256;
/// The change that brings another node together with that.
pub(super) const REMEDY: &str = "services are reliable and volatile, so change the other node";

/// The state of the task behind a link.
pub(super) struct Pump {
    pub(super) topic: String,
    pub(super) of: Side,
    pub(super) intake: Intake,
    pub(super) matches: Matches,
    pub(super) matched: Matched,
    pub(super) hearers: Matched,
    pub(super) held: WaitingRequests<Arrival>,
    pub(super) bytes_max: usize,
    pub(super) arrivals: mpsc::Sender<Arrival>,
    pub(super) participant: Participant,
    pub(super) mark: Mark,
    /// The writers that were looked up: are they of a bridge of this network?
    pub(super) bridges: BTreeMap<[u8; 16], bool>,
    pub(super) log_limiter: LogLimiter,
}

impl Pump {
    /// Runs until the link is dropped, or DDS ends.
    pub(super) async fn run(mut self, source: SimpleDataReader<Sample, AnyRaw>) {
        let samples = source.as_async_stream();
        let mut samples = std::pin::pin!(samples);
        let mut statuses = source.as_async_status_stream();
        let mut alive = interval(ALIVE_EVERY);
        let mut hearers = self.hearers.clone();
        loop {
            let until = self.held.until();
            tokio::select! {
                // A link that is dropped ends this task; the other task may have ended before.
                Ok(()) = hearers.changed(), if until.is_some() => self.release(),
                () = async { sleep_until(until.unwrap_or_else(Instant::now).into()).await }, if until.is_some() => {
                    self.release();
                }
                sample = samples.next() => match sample {
                    Some(Ok(change)) => {
                        // DDS has told of its writer before: whoever takes it finds that there.
                        while let Some(status) = source.try_recv_status() {
                            self.note(&status);
                        }
                        let related = change.related_sample_identity();
                        self.take(change.writer_guid, change.sequence_number.into(), related, &change.sample);
                    }
                    Some(Err(_)) => self.drop_one("it cannot be read"),
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
        tracing::error!(topic = self.topic, "DDS has ended: nothing is read any more");
    }

    fn note(&mut self, status: &DataReaderStatus) {
        match status {
            DataReaderStatus::SubscriptionMatched { current, writer, .. } => {
                self.matches.changed(*writer, current.count_change());
            }
            DataReaderStatus::RequestedIncompatibleQos { last_policy_id, .. } => {
                self.matches.refused();
                let policy = format!("{last_policy_id:?}");
                if let Some(not_logged) = self.log_limiter.admit("qos", Instant::now()) {
                    tracing::warn!(
                        topic = self.topic,
                        policy,
                        not_logged,
                        "a peer offers less than services need: {REMEDY}"
                    );
                }
            }
            _ => {}
        }
    }

    fn take(&mut self, writer: GUID, sequence: i64, related: Option<SampleIdentity>, sample: &Sample) {
        let source = writer.to_bytes();
        if self.matches.with_endpoints(|present| self.intake.judge(source, sequence, present)) != Verdict::Admit
            || self.is_bridge(source)
        {
            return;
        }
        if sample.wire().len() > self.bytes_max {
            return self.drop_one("it is larger than sample_bytes_max");
        }
        if sample.representation_id() != CDR_LE {
            return self.drop_one("it is not little endian CDR");
        }
        // A copy, so that it keeps nothing larger alive.
        let message = Bytes::copy_from_slice(sample.wire().get(HEADER_BYTES..).unwrap_or_default());
        let arrival = Arrival { message, writer, sequence, related };
        if self.of == Side::Client || is_heard(&arrival, &self.matched, &self.hearers) {
            // Earlier ones of the same client go first.
            self.release();
            self.give(arrival);
        } else if let Some(oldest) = self.held.push(arrival, Instant::now()) {
            self.give(oldest);
        }
    }

    /// Gives out what waits no longer.
    fn release(&mut self) {
        let (matched, hearers) = (&self.matched, &self.hearers);
        for arrival in self.held.release(Instant::now(), |arrival| is_heard(arrival, matched, hearers)) {
            self.give(arrival);
        }
    }

    fn give(&mut self, arrival: Arrival) {
        if self.arrivals.try_send(arrival).is_err() {
            self.drop_one("too many wait");
        }
    }

    fn drop_one(&mut self, reason: &'static str) {
        if let Some(not_logged) = self.log_limiter.admit(reason, Instant::now()) {
            tracing::warn!(topic = self.topic, reason, not_logged, "a request or a reply was dropped");
        }
    }

    /// Is it an endpoint of a bridge of this network? Messages from the ledger do not go there again.
    fn is_bridge(&mut self, writer: [u8; 16]) -> bool {
        if let Some(known) = self.bridges.get(&writer) {
            return *known;
        }
        if self.bridges.len() >= MARKS_MAX {
            self.bridges.clear();
        }
        let found = self.participant.publishers().find(|neighbour| neighbour.guid == writer);
        let Some(found) = found else { return false };
        let is_bridge = found.mark.is_some_and(|mark| mark.is_of_network_of(self.mark));
        self.bridges.insert(writer, is_bridge);
        is_bridge
    }
}

/// Would the client of a request hear the reply? Its reader must be known. A request may name the reader. If not, as many
/// readers as writers of its participant must be known: each client has one of both.
fn is_heard(request: &Arrival, matched: &Matched, hearers: &Matched) -> bool {
    if let Some(reader) = named(request.related).filter(|named| named.entity_id.kind().is_reader()) {
        return hearers.has(&reader.to_bytes());
    }
    let participant = prefix(request.writer);
    hearers.of_participant(&participant) >= matched.of_participant(&participant).max(1)
}
