//! The topics of a replay, each with its writer.

use super::nothing;
use super::summary::Count;
use crate::argument::remap::Remap;
use crate::recording::{CDR, NETWORK_KEY, OWN_PACKAGE, Reading, SERVICE_KEY, Source};
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::sample::Sample;
use ros_bridge::dds::{Participant, Writer};
use ros_bridge::error::Result as BridgeResult;
use ros_bridge::mark::Mark;
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// All topics of a replay, by the channels of its file.
pub(super) struct Cast {
    parts: BTreeMap<u16, Part>,
}

/// One topic.
pub(super) struct Part {
    topic: TopicName,
    message: TypeName,
    /// Of messages that came from a ledger.
    mark: Option<Mark>,
    /// Messages of the file.
    recorded: u64,
    published: u64,
    writer: Option<Writer>,
}

impl Cast {
    /// Reads the file once, so that nothing is published of one that is damaged, and every topic is known.
    ///
    /// # Errors
    /// [`Code::BadFile`] if it is damaged or has nothing to publish; [`Code::BadArgument`] for a name that it has not.
    pub(super) fn of_file(path: &Path, remaps: &[Remap]) -> Result<Self, Rejection> {
        let mut reading = Reading::open(path)?;
        let mut recorded: BTreeMap<u16, u64> = BTreeMap::new();
        while let Some(found) = reading.next()? {
            *recorded.entry(found.channel).or_default() += 1;
        }
        let sources: BTreeMap<u16, &Source> =
            reading.sources().iter().filter(|(_, source)| is_ros(source)).map(|(id, source)| (*id, source)).collect();
        if sources.keys().all(|id| !recorded.contains_key(id)) {
            let topics: Vec<_> = sources.values().map(|source| source.topic.as_str()).collect();
            let found = match topics.as_slice() {
                [] => "no channel of ROS 2".to_owned(),
                topics => format!("no message on {}", topics.join(", ")),
            };
            return Err(nothing(path, found));
        }
        for Remap { from, .. } in remaps {
            let mut known = sources.values().map(|source| source.topic.as_str());
            if !known.clone().any(|topic| topic == from) {
                return Err(Rejection::new(Code::BadArgument, format!("the file has no topic {from}"))
                    .found(format!("{from:?}"))
                    .wanted(known.clone().collect::<Vec<_>>().join(", "))
                    .next(did_you_mean(from, &mut known, "the name in front of := is one of the file")));
            }
        }
        let mut parts = BTreeMap::new();
        for (id, source) in sources {
            let part = Part::of(source, remaps, recorded.get(&id).copied().unwrap_or_default())?;
            let twin = parts.values().find(|other: &&Part| other.topic == part.topic && other.message != part.message);
            if let Some(other) = twin {
                return Err(Rejection::new(Code::BadArgument, format!("two types on one topic {}", part.topic))
                    .found(format!("{} and {}", other.message, part.message))
                    .wanted("one type for each topic")
                    .next("give one of both another name: --topic FROM:=TO"));
            }
            parts.insert(id, part);
        }
        Ok(Self { parts })
    }

    /// Opens a writer for each topic.
    pub(super) fn open(&mut self, participant: &Participant) -> Result<(), Rejection> {
        for part in self.parts.values_mut() {
            let Part { topic, message, mark, .. } = part;
            let qos = Qos::default();
            let writer = match mark {
                Some(mark) => participant.marked_writer(topic, message, &qos, *mark),
                None => participant.writer(topic, message, &qos),
            };
            part.writer = Some(writer?);
        }
        Ok(())
    }

    /// How many messages there are to publish.
    pub(super) fn recorded(&self) -> u64 {
        self.parts.values().map(|part| part.recorded).sum()
    }

    /// The topics with their types, for people.
    pub(super) fn told(&self) -> String {
        let told: Vec<_> = self.parts.values().map(|part| format!("{} [{}]", part.topic, part.message)).collect();
        told.join(", ")
    }

    /// The names of the topics in DDS.
    pub(super) fn topics(&self) -> BTreeSet<String> {
        self.parts.values().map(|part| part.topic.dds()).collect()
    }

    /// The topic of a channel; none if it is not published.
    pub(super) fn part(&mut self, channel: u16) -> Option<&mut Part> {
        self.parts.get_mut(&channel)
    }

    /// Waits until every topic has a subscriber.
    pub(super) async fn heard(&self) {
        for writer in self.parts.values().filter_map(|part| part.writer.as_ref()) {
            writer.matched().at_least(1).await;
        }
    }

    /// The topics that nobody subscribes to.
    pub(super) fn unheard(&self) -> Vec<&str> {
        self.parts.values().filter(|part| part.subscribers() == 0).map(|part| part.topic.as_str()).collect()
    }

    /// Waits until subscribers have everything.
    pub(super) async fn flush(&self, within: Duration) {
        for writer in self.parts.values().filter_map(|part| part.writer.as_ref()) {
            writer.flush(within).await;
        }
    }

    /// How much was published.
    pub(super) fn into_counts(self) -> Vec<Count> {
        let count = |part: Part| Count {
            subscribers: part.subscribers(),
            topic: part.topic.to_string(),
            type_name: part.message.to_string(),
            recorded: part.recorded,
            published: part.published,
        };
        self.parts.into_values().map(count).collect()
    }
}

impl Part {
    fn of(source: &Source, remaps: &[Remap], recorded: u64) -> Result<Self, Rejection> {
        let renamed = remaps.iter().rev().find(|remap| remap.from == source.topic);
        let topic = TopicName::parse(renamed.map_or(source.topic.as_str(), |remap| remap.to.as_str()))?;
        let message = TypeName::parse(&source.type_name)?;
        let (service, network) = (source.about.get(SERVICE_KEY), source.about.get(NETWORK_KEY));
        let network = network.and_then(|network| Hash::from_hex(network));
        let mark = network.zip(service).map(|(network, service)| Mark::new(&network, service));
        Ok(Self { topic, message, mark, recorded, published: 0, writer: None })
    }

    /// Publishes a message.
    pub(super) fn publish(&mut self, sample: &Sample) -> BridgeResult<()> {
        if let Some(writer) = &self.writer {
            writer.write(sample)?;
            self.published += 1;
        }
        Ok(())
    }

    fn subscribers(&self) -> usize {
        self.writer.as_ref().map_or(0, |writer| writer.matched().now().matched)
    }
}

/// Is it a channel of messages of ROS 2? Channels about the ledger are for readers, not for robots.
fn is_ros(source: &Source) -> bool {
    let package = source.type_name.split('/').next().unwrap_or_default();
    source.encoding == CDR && !package.is_empty() && package != OWN_PACKAGE
}
