//! A reader and a writer that belong together: the two ends of a server, or of a client.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_gate::sample::Sample;
use rustdds::{
    GUID, RTPSEntity, Timestamp, TopicKind,
    dds::result::WriteError,
    no_key::{DataWriter, SimpleDataReader},
    rpc::SampleIdentity,
    with_key::WriteOptionsBuilder,
};
use tokio::{sync::mpsc, task::JoinHandle};

use super::{
    arrival::{Arrival, Side},
    pump::{Pump, REMEDY},
    waiting::{WAITING_MAX, WaitingRequests},
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        dds::{
            encoding::{AnyRaw, Payload, Raw},
            failure::dds_error,
            intake::Intake,
            matched::{Matched, Matches},
            participant::Participant,
            ros_discovery::Role,
            writer::watch,
        },
        mark::Mark,
        names::TypeName,
        qos::{Durability, Qos, Reliability},
    },
    log::LogLimiter,
};

/// Most bytes written that readers have not acknowledged. Beyond it a write is refused.
const UNACKNOWLEDGED_BYTES_MAX: usize = 16 * 1024 * 1024;
/// As the middlewares of ROS 2 have it for services, but deeper for bursts.
const QOS: Qos = Qos { reliability: Reliability::Reliable, durability: Durability::Volatile, depth: 100, keyed: false };

/// The two topics of a link, and how it is announced.
pub(super) struct LinkTopics {
    pub(super) reads: (String, TypeName),
    pub(super) writes: (String, TypeName),
    pub(super) of: Side,
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
    pub(super) fn open(participant: &Participant, ends: LinkTopics, mark: Mark, bytes_max: usize) -> Result<Self> {
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
        participant.discovery.add(Role::Reads, reader);
        participant.discovery.add(Role::Writes, writer.guid());
        let pump = Pump {
            topic: ends.reads.0.clone(),
            of: ends.of,
            intake: Intake::new(participant.guid_prefix()),
            matches,
            matched: matched.clone(),
            hearers: hearers.clone(),
            held: WaitingRequests::new(),
            bytes_max,
            arrivals: sender,
            participant: participant.clone(),
            mark,
            bridges: BTreeMap::new(),
            log_limiter: LogLimiter::default(),
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
        self.participant.discovery.remove(Role::Reads, self.reader);
        self.participant.discovery.remove(Role::Writes, self.writer.guid());
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}
