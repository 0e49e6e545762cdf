//! Publishes raw CDR on one topic.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{StreamExt, future::BoxFuture};
use ledger_gate::sample::{CDR_BE, CDR_LE, PL_CDR_BE, PL_CDR_LE, Sample};
use rustdds::{
    DataWriterStatus, GUID, QosPolicies, RTPSEntity, StatusEvented, Timestamp, Topic,
    dds::{qos::QosPolicyId, result::WriteError},
    no_key::DataWriter,
};
use tokio::{task::AbortHandle, time::interval};

use super::{
    encoding::{Payload, Raw, offered},
    failure::dds_error,
    matched::{ALIVE_EVERY, Matched, Matches},
    participant::Participant,
    remedy::remedy,
    ros_discovery::Role,
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        mark::Mark,
        names::{TopicName, TypeName},
        qos::Qos,
    },
    log::LogLimiter,
};

/// A sample up to this size is copied. DDS keeps many samples for readers that lag. Each would keep the whole buffer in
/// memory in which it came, with everything else that came in it.
const COPIED_BYTES_MAX: usize = 4 * 1024;

/// Offers one topic; leaves it when dropped. Writing never blocks, and waits for no reader: one that does not keep up
/// loses what newer samples have replaced.
pub struct Writer {
    participant: Participant,
    topic: TopicName,
    dds_topic: Topic,
    policies: QosPolicies,
    matched: Matched,
    endpoints: Mutex<BTreeMap<[u8; 2], Endpoint>>,
}

/// The DDS writer of one encoding.
struct Endpoint {
    output: Arc<dyn Output>,
    watcher: AbortHandle,
}

impl Participant {
    /// Starts to offer a topic.
    pub fn writer(&self, topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<Writer> {
        Writer::open(self, topic, message, qos, None)
    }

    /// Starts to offer a topic with samples that come from the ledger. No bridge of that network takes them in.
    pub fn marked_writer(&self, topic: &TopicName, message: &TypeName, qos: &Qos, mark: Mark) -> Result<Writer> {
        Writer::open(self, topic, message, qos, Some(mark))
    }
}

impl Writer {
    fn open(
        participant: &Participant,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        mark: Option<Mark>,
    ) -> Result<Self> {
        let policies = participant.with_type_hash(qos.policies(), message);
        let dds_topic = participant.topic(topic, message, qos)?;
        let (matches, matched) = Matches::new(participant.guid_prefix());
        let mut writer = Self {
            participant: participant.clone(),
            topic: topic.clone(),
            dds_topic,
            policies: mark.map_or_else(|| policies.clone(), |mark| mark.put_on(&policies)),
            matched,
            endpoints: Mutex::default(),
        };
        let first = writer.endpoint(CDR_LE, matches)?;
        writer.endpoints.get_mut().unwrap_or_else(PoisonError::into_inner).insert(CDR_LE, first);
        Ok(writer)
    }

    /// Publishes a sample. [`Error::Dds`] means that the participant is broken, or has ended.
    pub fn write(&self, sample: &Sample) -> Result<()> {
        if self.matched.is_ended() {
            let what = format!("cannot publish on {}", self.topic);
            return Err(Error::Dds(Explained::new(what, "DDS has ended", "a running DDS", "start the bridge again")));
        }
        let mut endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
        let id = sample.representation_id();
        let endpoint = match endpoints.entry(id) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(new) => {
                let (matches, _) = Matches::new(self.participant.guid_prefix());
                new.insert(self.endpoint(id, matches)?)
            }
        };
        let (options, mut body) = (sample.options(), sample.body());
        if body.len() <= COPIED_BYTES_MAX {
            body = Bytes::copy_from_slice(&body);
        }
        let payload = Payload { options, body };
        endpoint.output.put(payload).map_err(|error| dds_error(&format!("cannot publish on {}", self.topic), &error))
    }

    /// Waits until all reliable readers have everything written so far; `false` after `at_most`. A stop message
    /// deserves it before the writer is dropped.
    pub async fn flush(&self, at_most: Duration) -> bool {
        let outputs: Vec<Arc<dyn Output>> = {
            let endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
            endpoints.values().map(|endpoint| Arc::clone(&endpoint.output)).collect()
        };
        let all = futures::future::join_all(outputs.iter().map(|output| output.acknowledged()));
        tokio::time::timeout(at_most, all).await.is_ok_and(|all| all.into_iter().all(|done| done))
    }

    /// The readers of others (of the usual encoding, little endian).
    pub fn matched(&self) -> &Matched {
        &self.matched
    }

    /// Opens the DDS writer of an encoding and follows its status.
    fn endpoint(&self, id: [u8; 2], matches: Matches) -> Result<Endpoint> {
        match id {
            CDR_LE => self.endpoint_of::<1>(matches),
            CDR_BE => self.endpoint_of::<0>(matches),
            PL_CDR_BE => self.endpoint_of::<2>(matches),
            PL_CDR_LE => self.endpoint_of::<3>(matches),
            [0, 6] => self.endpoint_of::<6>(matches),
            [0, 7] => self.endpoint_of::<7>(matches),
            [0, 8] => self.endpoint_of::<8>(matches),
            [0, 9] => self.endpoint_of::<9>(matches),
            [0, 10] => self.endpoint_of::<10>(matches),
            [0, 11] => self.endpoint_of::<11>(matches),
            [first, second] => {
                let found = format!("encoding {first:02x} {second:02x}");
                let what = format!("cannot publish on {}: unknown encoding", self.topic);
                Err(Error::Sample(Explained::new(what, found, "00 00 to 00 03, or 00 06 to 00 0b", "")))
            }
        }
    }

    fn endpoint_of<const ID: u8>(&self, matches: Matches) -> Result<Endpoint> {
        let failed = |error| dds_error(&format!("cannot write topic {}", self.topic), &error);
        let policies = match offered([0, ID]) {
            Some(version) => self.policies.clone().with_data_representation(version),
            None => self.policies.clone(),
        };
        let publisher = self.participant.dds.create_publisher(&policies).map_err(failed)?;
        let writer: DataWriter<Payload, Raw<ID>> =
            publisher.create_datawriter_no_key(&self.dds_topic, Some(policies)).map_err(failed)?;
        let writer = Arc::new(writer);
        self.participant.discovery.add(Role::Writes, writer.guid());
        let remedy = |policy| remedy(Role::Writes, policy);
        let watcher = tokio::spawn(watch(Arc::clone(&writer), self.topic.to_string(), matches, remedy)).abort_handle();
        Ok(Endpoint { output: writer, watcher })
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        for endpoint in self.endpoints.get_mut().unwrap_or_else(PoisonError::into_inner).values() {
            endpoint.watcher.abort();
            self.participant.discovery.remove(Role::Writes, endpoint.output.id());
        }
    }
}

/// A DDS writer of any encoding.
trait Output: Send + Sync {
    fn put(&self, payload: Payload) -> std::result::Result<(), WriteError<Payload>>;
    fn acknowledged(&self) -> BoxFuture<'_, bool>;
    fn id(&self) -> GUID;
}

impl<const ID: u8> Output for DataWriter<Payload, Raw<ID>> {
    fn put(&self, payload: Payload) -> std::result::Result<(), WriteError<Payload>> {
        self.write(payload, Some(Timestamp::now()))
    }

    fn acknowledged(&self) -> BoxFuture<'_, bool> {
        Box::pin(async { self.async_wait_for_acknowledgments().await.unwrap_or(false) })
    }

    fn id(&self) -> GUID {
        self.guid()
    }
}

/// Follows the status of a DDS writer until it is dropped. `remedy` tells what brings it together with a reader.
pub(super) async fn watch<const ID: u8>(
    writer: Arc<DataWriter<Payload, Raw<ID>>>,
    topic: String,
    mut matches: Matches,
    remedy: fn(QosPolicyId) -> &'static str,
) {
    let mut statuses = writer.as_async_status_stream();
    let (mut alive, mut log_limiter) = (interval(ALIVE_EVERY), LogLimiter::default());
    loop {
        let status = tokio::select! {
            status = statuses.next() => status,
            // Nobody is woken when DDS ends, so it is looked at again.
            _ = alive.tick() => continue,
        };
        let Some(status) = status else { break };
        match status {
            DataWriterStatus::PublicationMatched { current, reader, .. } => {
                matches.changed(reader, current.count_change());
            }
            DataWriterStatus::OfferedIncompatibleQos { last_policy_id, .. } => {
                matches.refused();
                let (policy, remedy) = (format!("{last_policy_id:?}"), remedy(last_policy_id));
                if let Some(not_logged) = log_limiter.admit(remedy, Instant::now()) {
                    tracing::warn!(
                        topic,
                        policy,
                        not_logged,
                        "a subscriber requests more than this route offers: {remedy}"
                    );
                }
            }
            _ => {}
        }
    }
    tracing::error!(topic, "DDS has ended: no sample is written any more");
}
