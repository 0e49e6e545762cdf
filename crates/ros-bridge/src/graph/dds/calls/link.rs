//! A reader and a writer that belong together: the two ends of a server, or of a client.

use std::{collections::BTreeMap, sync::Arc};

use bytes::{BufMut, Bytes, BytesMut};
use ledger_base::hash::Hash;
use ledger_gate::sample::{CDR_LE, HEADER_BYTES};
use rtps::{
    guid::{Guid, SampleIdentity},
    interface::{EndpointSettings, OutgoingSample, TopicDescription},
    io::{DomainWriter, QueueLimits},
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
            encoding::accepting,
            failure::dds_error,
            intake::Intake,
            matched::{Matched, MismatchLog, watch_writer},
            participant::Participant,
            reader::OFFERS_LESS,
            ros_discovery::Role,
            writer::{REQUESTS_MORE, now},
        },
        mark::Mark,
        names::TypeName,
        qos::{Durability, Qos, Reliability},
    },
    log::LogLimiter,
};

/// Most bytes written that readers have not acknowledged. Beyond it a write is refused.
const UNACKNOWLEDGED_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Most bytes that wait for the task of a link.
const QUEUE_BYTES_MAX: usize = 64 * 1024 * 1024;
/// As the middlewares of ROS 2 have it for services, but deeper for bursts.
const QOS: Qos = Qos::new(Reliability::Reliable, Durability::Volatile, 100);

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
    reader: Guid,
    writer: Arc<DomainWriter>,
    /// The writers of others that the reader hears.
    matched: Matched,
    /// The readers of others that hear the writer.
    hearers: Matched,
    /// For messages.
    topic: String,
    tasks: [JoinHandle<()>; 2],
}

impl Link {
    /// Opens both ends. Nothing comes from bridges of the mark's network, nor from this participant.
    pub(super) fn open(participant: &Participant, ends: LinkTopics, mark: Mark, bytes_max: usize) -> Result<Self> {
        let failed = |error: &dyn std::error::Error| dds_error(&format!("cannot open {}", ends.reads.0), error);
        // One text for both ends, by which their peers know that they belong together.
        let id = Hash::of(&[&participant.guid(), ends.of.key().as_bytes(), ends.reads.0.as_bytes()]);
        let pair = format!("{}={id};", ends.of.key());
        let settings = |(name, of): &(String, TypeName)| EndpointSettings {
            topic: TopicDescription { name: name.clone(), type_name: of.dds(), keyed: false },
            qos: mark.put_on(QOS.policies()),
            user_data: Bytes::from([&participant.type_hash(of), pair.as_bytes()].concat()),
            // A request may be written before its server knows the client.
            without_history: false,
        };
        let mut reads = settings(&ends.reads);
        reads.qos = accepting(reads.qos);
        let waiting = QueueLimits { bytes: QUEUE_BYTES_MAX, samples: WAITING_MAX };
        let source = participant.dds.reader(reads, waiting).map_err(|error| failed(&error))?;
        let writer = Arc::new(participant.dds.writer(settings(&ends.writes)).map_err(|error| failed(&error))?);
        let (matched, hearers) = (Matched::of(source.matches()), Matched::of(writer.matches()));
        let (sender, arrivals) = mpsc::channel(WAITING_MAX);
        let reader = source.guid();
        participant.discovery.add(Role::Reads, reader);
        participant.discovery.add(Role::Writes, writer.guid());
        let pump = Pump {
            topic: ends.reads.0.clone(),
            of: ends.of,
            intake: Intake::default(),
            mismatches: MismatchLog::new(ends.reads.0, OFFERS_LESS, |_| REMEDY),
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
        let log = MismatchLog::new(ends.writes.0.clone(), REQUESTS_MORE, |_| REMEDY);
        let watcher = watch_writer(writer.matches().clone(), log);
        Ok(Self {
            participant: participant.clone(),
            arrivals,
            reader,
            writer,
            matched,
            hearers,
            tasks: [tokio::spawn(pump.run(source)), tokio::spawn(watcher)],
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
        let (bytes, waiting) = (message.len(), self.writer.unacknowledged_bytes());
        if waiting > 0 && waiting.saturating_add(bytes) > UNACKNOWLEDGED_BYTES_MAX {
            let found = format!("{waiting} bytes that nobody has acknowledged");
            let wanted = format!("at most {UNACKNOWLEDGED_BYTES_MAX} bytes");
            let hint = "look at the process at the other end";
            return Err(Error::Slow(Explained::new(cannot, found, wanted, hint)));
        }
        let mut payload = BytesMut::with_capacity(HEADER_BYTES + bytes);
        payload.put_slice(&CDR_LE);
        payload.put_slice(&[0, 0]);
        payload.put_slice(&message);
        let sample = OutgoingSample { payload: payload.freeze(), timestamp: Some(now()), related };
        let sequence = self.writer.write(sample).map_err(|error| dds_error(&cannot, &error))?;
        Ok(SampleIdentity { writer: self.writer.guid(), sequence })
    }

    /// The participant.
    pub(super) fn participant(&self) -> &Participant {
        &self.participant
    }

    /// The reader and the writer.
    pub(super) fn guids(&self) -> [Guid; 2] {
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
