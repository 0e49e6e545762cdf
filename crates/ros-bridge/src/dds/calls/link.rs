//! A reader and a writer that belong together: the two ends of a server, or of a client.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::StreamExt;
use ledger_base::hash::Hash;
use ledger_gate::sample::{CDR_LE, HEADER_BYTES, Sample};
use rustdds::{
    DataReaderStatus, GUID, RTPSEntity, StatusEvented, Timestamp, TopicKind,
    dds::result::WriteError,
    no_key::{DataWriter, SimpleDataReader},
    rpc::SampleIdentity,
    with_key::WriteOptionsBuilder,
};
use tokio::{
    sync::mpsc,
    task::JoinHandle,
    time::{interval, sleep_until},
};

use super::{
    super::{
        ALIVE_EVERY, Matched, Participant, dds_error,
        encoding::{AnyRaw, Payload, Raw},
        graph::Role,
        intake::{Intake, Verdict},
        matched::Matches,
        prefix,
        writer::watch,
    },
    WAITING_MAX,
    held::Held,
    mapping::named,
};
use crate::{
    count::Complaint,
    error::{Error, Explained, Result},
    mark::Mark,
    names::TypeName,
    qos::Qos,
};

/// Most bytes written that readers have not acknowledged. Beyond it a write is refused.
const UNACKNOWLEDGED_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Most writers whose mark is remembered; beyond it all are looked up again.
const MARKS_MAX: usize = 256;
/// As the middlewares of ROS 2 have it for services, but deeper for bursts.
const QOS: Qos = Qos {
    reliability: crate::qos::Reliability::Reliable,
    durability: crate::qos::Durability::Volatile,
    depth: 100,
    keyed: false,
};
/// The change that brings another node together with that.
const REMEDY: &str = "services are reliable and volatile, so change the other node";

/// The two topics of a link, and how it is announced.
pub(super) struct Ends {
    pub(super) reads: (String, TypeName),
    pub(super) writes: (String, TypeName),
    pub(super) of: Of,
}

/// The side of a service that the two ends serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    Server,
    Client,
}

impl Of {
    /// The key under which `rmw_cyclonedds` announces that both ends are one.
    fn key(self) -> &'static str {
        match self {
            Self::Server => "serviceid",
            Self::Client => "clientid",
        }
    }
}

/// A message that came in.
pub(super) struct Arrival {
    /// The message, little endian.
    pub(super) message: Bytes,
    pub(super) writer: GUID,
    pub(super) sequence: i64,
    /// The request to which it is related, as it says.
    pub(super) related: Option<SampleIdentity>,
}

/// The two ends; they leave the graph when dropped.
pub(super) struct Link {
    participant: Participant,
    arrivals: mpsc::Receiver<Arrival>,
    reader: GUID,
    writer: Arc<DataWriter<Payload, Raw<1>>>,
    /// The writers of others that the reader hears.
    matched: Matched,
    /// The readers of others that hear the writer.
    hearers: Matched,
    unacknowledged: AtomicUsize,
    /// For messages.
    topic: String,
    tasks: [JoinHandle<()>; 2],
}

impl Link {
    /// Opens both ends. Nothing comes from bridges of the mark's network, nor from this participant.
    pub(super) fn open(participant: &Participant, ends: Ends, mark: Mark, bytes_max: usize) -> Result<Self> {
        let (policies, dds) = (QOS.policies(), &participant.dds);
        let failed = |error| dds_error(&format!("cannot open {}", ends.reads.0), &error);
        // One text for both ends, by which their peers know that they belong together.
        let id = Hash::of(&[&participant.guid(), ends.of.key().as_bytes(), ends.reads.0.as_bytes()]);
        let announced = |of: &TypeName| {
            let policies = mark.put_on(&participant.with_type_hash(policies.clone(), of));
            let known = policies.user_data().unwrap_or_default().to_vec();
            policies.with_user_data([known, format!("{}={id};", ends.of.key()).into_bytes()].concat())
        };
        let topic = |(name, of): &(String, TypeName)| {
            dds.create_topic(name.clone(), of.dds(), &policies, TopicKind::NoKey).map_err(failed)
        };
        let (reads, writes) = (topic(&ends.reads)?, topic(&ends.writes)?);
        let subscriber = dds.create_subscriber(&policies).map_err(failed)?;
        let source: SimpleDataReader<Sample, AnyRaw> =
            subscriber.create_simple_datareader_no_key(&reads, Some(announced(&ends.reads.1))).map_err(failed)?;
        let publisher = dds.create_publisher(&policies).map_err(failed)?;
        let writer: DataWriter<Payload, Raw<1>> =
            publisher.create_datawriter_no_key(&writes, Some(announced(&ends.writes.1))).map_err(failed)?;
        let writer = Arc::new(writer);
        let (matches, matched) = Matches::new(participant.guid_prefix());
        let (heard, hearers) = Matches::new(participant.guid_prefix());
        let (sender, arrivals) = mpsc::channel(WAITING_MAX);
        let reader = source.guid();
        participant.graph.add(Role::Reads, reader);
        participant.graph.add(Role::Writes, writer.guid());
        let pump = Pump {
            topic: ends.reads.0.clone(),
            of: ends.of,
            intake: Intake::new(participant.guid_prefix()),
            matches,
            matched: matched.clone(),
            hearers: hearers.clone(),
            held: Held::new(),
            bytes_max,
            arrivals: sender,
            participant: participant.clone(),
            mark,
            bridges: BTreeMap::new(),
            complaint: Complaint::default(),
        };
        Ok(Self {
            participant: participant.clone(),
            arrivals,
            reader,
            writer: Arc::clone(&writer),
            matched,
            hearers,
            unacknowledged: AtomicUsize::new(0),
            tasks: [
                tokio::spawn(pump.run(source)),
                tokio::spawn(watch(writer, ends.writes.0.clone(), heard, |_| REMEDY)),
            ],
            topic: ends.writes.0,
        })
    }

    /// The next message; none if DDS ended. Cancelling it loses nothing.
    pub(super) async fn next(&mut self) -> Option<Arrival> {
        self.arrivals.recv().await
    }

    /// Writes a message. Answers with its identity.
    ///
    /// # Errors
    /// [`Error::Slow`] if readers are too far behind; [`Error::Dds`] if DDS has ended.
    pub(super) fn write(&self, message: Bytes, related: Option<SampleIdentity>) -> Result<SampleIdentity> {
        let cannot = format!("cannot write on {}", self.topic);
        if self.matched.is_ended() {
            return Err(Error::Dds(Explained::new(cannot, "DDS has ended", "a running DDS", "start the bridge again")));
        }
        if self.writer.wait_for_acknowledgments(Duration::ZERO).unwrap_or(false) {
            self.unacknowledged.store(0, Ordering::Relaxed);
        }
        let bytes = message.len();
        let waiting = self.unacknowledged.load(Ordering::Relaxed);
        let slow = || {
            let found = format!("{waiting} bytes that nobody has acknowledged");
            let wanted = format!("at most {UNACKNOWLEDGED_BYTES_MAX} bytes");
            Error::Slow(Explained::new(cannot.clone(), found, wanted, "look at the process at the other end"))
        };
        if waiting > 0 && waiting.saturating_add(bytes) > UNACKNOWLEDGED_BYTES_MAX {
            return Err(slow());
        }
        let options =
            WriteOptionsBuilder::new().source_timestamp(Timestamp::now()).related_sample_identity_opt(related);
        match self.writer.write_with_options(Payload { options: [0, 0], body: message }, options.build()) {
            Ok(written) => {
                self.unacknowledged.fetch_add(bytes, Ordering::Relaxed);
                Ok(written)
            }
            Err(WriteError::WouldBlock { .. }) => Err(slow()),
            Err(error) => Err(dds_error(&cannot, &error)),
        }
    }

    /// The participant.
    pub(super) fn participant(&self) -> &Participant {
        &self.participant
    }

    /// The reader and the writer.
    pub(super) fn guids(&self) -> [GUID; 2] {
        [self.reader, self.writer.guid()]
    }

    /// The writers of others that the reader hears.
    pub(super) fn matched(&self) -> &Matched {
        &self.matched
    }

    /// The readers of others that hear the writer.
    pub(super) fn hearers(&self) -> &Matched {
        &self.hearers
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.participant.graph.remove(Role::Reads, self.reader);
        self.participant.graph.remove(Role::Writes, self.writer.guid());
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

/// The state of the task behind a link.
struct Pump {
    topic: String,
    of: Of,
    intake: Intake,
    matches: Matches,
    matched: Matched,
    hearers: Matched,
    held: Held<Arrival>,
    bytes_max: usize,
    arrivals: mpsc::Sender<Arrival>,
    participant: Participant,
    mark: Mark,
    /// The writers that were looked up: are they of a bridge of this network?
    bridges: BTreeMap<[u8; 16], bool>,
    complaint: Complaint,
}

impl Pump {
    /// Runs until the link is dropped, or DDS ends.
    async fn run(mut self, source: SimpleDataReader<Sample, AnyRaw>) {
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
                if let Some(not_logged) = self.complaint.worth("qos", Instant::now()) {
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
        if self.of == Of::Client || is_heard(&arrival, &self.matched, &self.hearers) {
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
        if let Some(not_logged) = self.complaint.worth(reason, Instant::now()) {
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
