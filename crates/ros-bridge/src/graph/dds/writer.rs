//! Publishes raw CDR on one topic.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, SystemTime},
};

use bytes::Bytes;
use ledger_gate::sample::Sample;
use rtps::{
    interface::{EndpointSettings, OutgoingSample},
    io::DomainWriter,
    qos::Representation,
    time::Ticks,
};
use tokio::task::AbortHandle;

use super::{
    encoding::{offering, version_of},
    failure::dds_error,
    matched::{Matched, MismatchLog, watch_writer},
    participant::{Participant, described},
    remedy,
    ros_discovery::Role,
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        mark::Mark,
        names::{TopicName, TypeName},
        qos::Qos,
    },
};

/// The log where a reader requests too much.
pub(super) const REQUESTS_MORE: &str = "a subscriber requests more than this route offers";
/// A sample up to this size is copied. DDS keeps many samples for readers that lag. Each would keep the whole buffer in
/// memory in which it came, with everything else that came in it.
const COPIED_BYTES_MAX: usize = 4 * 1024;

/// Offers one topic; leaves it when dropped. Writing never blocks, and waits for no reader: one that does not keep up
/// loses what newer samples have replaced.
pub struct Writer {
    participant: Participant,
    topic: TopicName,
    settings: EndpointSettings,
    matched: Matched,
    endpoints: Mutex<BTreeMap<Representation, Endpoint>>,
}

/// The DDS writer of one version of CDR: readers must accept what it offers.
struct Endpoint {
    output: Arc<DomainWriter>,
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
        let (topic_description, policies) = (described(topic, message, qos)?, qos.policies());
        let settings = EndpointSettings {
            topic: topic_description,
            qos: mark.map_or_else(|| policies.clone(), |mark| mark.put_on(policies.clone())),
            user_data: participant.type_hash(message),
            without_history: false,
        };
        let first = open(participant, topic, &settings, Representation::XCDR1)?;
        Ok(Self {
            participant: participant.clone(),
            topic: topic.clone(),
            settings,
            matched: Matched::of(first.output.matches()),
            endpoints: Mutex::new(BTreeMap::from([(Representation::XCDR1, first)])),
        })
    }

    /// Publishes a sample. [`Error::Dds`] means that the participant is broken, or has ended.
    pub fn write(&self, sample: &Sample) -> Result<()> {
        if self.matched.is_ended() {
            let what = format!("cannot publish on {}", self.topic);
            return Err(Error::Dds(Explained::new(what, "DDS has ended", "a running DDS", "start the bridge again")));
        }
        let id = sample.representation_id();
        let version = version_of(sample).ok_or_else(|| {
            let found = format!("encoding {id:02x?}");
            let what = format!("cannot publish on {}: unknown encoding", self.topic);
            Error::Sample(Explained::new(what, found, "00 00 to 00 03, or 00 06 to 00 0b", ""))
        })?;
        let mut endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
        let endpoint = match endpoints.entry(version) {
            std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
            std::collections::btree_map::Entry::Vacant(new) => {
                new.insert(open(&self.participant, &self.topic, &self.settings, version)?)
            }
        };
        let mut payload = sample.wire().clone();
        if payload.len() <= COPIED_BYTES_MAX {
            payload = Bytes::copy_from_slice(&payload);
        }
        let written = endpoint.output.write(OutgoingSample { payload, timestamp: Some(now()), related: None });
        written.map(drop).map_err(|error| dds_error(&format!("cannot publish on {}", self.topic), &error))
    }

    /// Waits until all reliable readers have everything written so far; `false` after `at_most`. A stop message
    /// deserves it before the writer is dropped.
    pub async fn flush(&self, at_most: Duration) -> bool {
        let outputs: Vec<Arc<DomainWriter>> = {
            let endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
            endpoints.values().map(|endpoint| Arc::clone(&endpoint.output)).collect()
        };
        let all = futures::future::join_all(outputs.iter().map(|output| output.acknowledged()));
        tokio::time::timeout(at_most, all).await.is_ok_and(|all| all.into_iter().all(|done| done.is_ok()))
    }

    /// The readers of others that accept XCDR1, as all of ROS 2 do.
    pub fn matched(&self) -> &Matched {
        &self.matched
    }
}

/// The time of the wall clock as it travels with a sample.
pub(super) fn now() -> Ticks {
    SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(Ticks::INVALID, |now| Ticks::from_micros(rtps::time::micros(now)))
}

/// Opens the DDS writer of a version of CDR, and follows its matches.
fn open(
    participant: &Participant,
    topic: &TopicName,
    settings: &EndpointSettings,
    version: Representation,
) -> Result<Endpoint> {
    let settings = EndpointSettings { qos: offering(settings.qos.clone(), version), ..settings.clone() };
    let output =
        participant.dds.writer(settings).map_err(|error| dds_error(&format!("cannot write topic {topic}"), &error))?;
    participant.discovery.add(Role::Writes, output.guid());
    let log = MismatchLog::new(topic.to_string(), REQUESTS_MORE, remedy::for_writer);
    let watcher = tokio::spawn(watch_writer(output.matches().clone(), log)).abort_handle();
    Ok(Endpoint { output: Arc::new(output), watcher })
}

impl Drop for Writer {
    fn drop(&mut self) {
        for endpoint in self.endpoints.get_mut().unwrap_or_else(PoisonError::into_inner).values() {
            endpoint.watcher.abort();
            self.participant.discovery.remove(Role::Writes, endpoint.output.guid());
        }
    }
}
