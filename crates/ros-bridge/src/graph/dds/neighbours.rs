//! Neighbours in the domain: the publishers and subscribers of other participants, as discovery knows them.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use futures::{FutureExt, StreamExt};
use rustdds::{GUID, QosPolicies, StatusEvented};
use tokio::{
    sync::watch,
    time::{sleep, timeout},
};

use super::{guid::prefix, participant::Participant};
use crate::graph::{endpoint::Role, mark::Mark};

/// Between two looks, however much changes: a look costs as much as there are endpoints in the domain.
const LOOK_PAUSE: Duration = Duration::from_millis(100);
/// A look without news: those may be lost where many come at once.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// Most endpoints that are followed; more are not told of.
const NEIGHBOURS_MAX: usize = 4096;

/// The kinds of endpoints of applications on topics with keys (DDSI-RTPS 9.3.1.2).
const WRITER_WITH_KEY: u8 = 0x02;
const READER_WITH_KEY: u8 = 0x07;

/// A publisher or subscriber of another participant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Neighbour {
    /// Its GUID.
    pub guid: [u8; 16],
    /// Which of both.
    pub role: Role,
    /// The DDS topic, `rt/cmd_vel`.
    pub topic: String,
    /// The DDS type, `geometry_msgs::msg::dds_::Twist_`.
    pub type_name: String,
    /// The QoS that it offers or requests.
    pub qos: QosPolicies,
    /// Set by bridges.
    pub mark: Option<Mark>,
}

impl Neighbour {
    fn new(guid: GUID, role: Role, topic: &str, type_name: &str, qos: QosPolicies) -> Self {
        let mark = Mark::of(qos.lifespan());
        let (topic, type_name) = (topic.to_owned(), type_name.to_owned());
        Self { guid: guid.to_bytes(), role, topic, type_name, qos, mark }
    }

    /// Is its topic declared with keys? The last byte of a GUID says so.
    pub(crate) fn is_keyed(&self) -> bool {
        matches!(self.guid, [.., WRITER_WITH_KEY | READER_WITH_KEY])
    }
}

/// The change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// It was not there before.
    Came(Neighbour),
    /// It has left, or its participant gave no sign of life.
    Left(Neighbour),
}

impl Participant {
    /// The publishers of others, now.
    pub(super) fn publishers(&self) -> impl Iterator<Item = Neighbour> {
        let own = self.guid_prefix();
        let writers = self.dds.discovered_writers().into_iter().map(|writer| {
            let (guid, data) = (writer.writer_proxy.remote_writer_guid, writer.publication_topic_data);
            (guid, Neighbour::new(guid, Role::Publisher, &data.topic_name, &data.type_name, data.qos()))
        });
        writers.filter(move |(guid, _)| prefix(*guid) != own).map(|(_, neighbour)| neighbour)
    }

    /// Is this publisher of another in the domain?
    pub(crate) fn has_publisher(&self, guid: &[u8; 16]) -> bool {
        self.publishers().any(|publisher| publisher.guid == *guid)
    }

    /// The hash that somebody in the graph announces for a type.
    pub(super) fn hash_in_graph(&self, dds_type: &str) -> Option<String> {
        let writers = self.dds.discovered_writers().into_iter();
        let readers = self.dds.discovered_readers().into_iter();
        let writers = writers.map(|writer| (writer.publication_topic_data.type_name.clone(), writer.user_data));
        let readers = readers.map(|reader| (reader.subscription_topic_data.type_name().clone(), reader.user_data));
        let mut announced = writers.chain(readers).filter(|(name, _)| name == dds_type);
        announced.find_map(|(_, user_data)| type_hash(&user_data))
    }

    /// The subscribers of others, now.
    pub(super) fn subscribers(&self) -> impl Iterator<Item = Neighbour> {
        let own = self.guid_prefix();
        let readers = self.dds.discovered_readers().into_iter().map(|reader| {
            let (guid, data) = (reader.reader_proxy.remote_reader_guid, reader.subscription_topic_data);
            (guid, Neighbour::new(guid, Role::Subscriber, data.topic_name(), data.type_name(), data.qos()))
        });
        readers.filter(move |(guid, _)| prefix(*guid) != own).map(|(_, neighbour)| neighbour)
    }

    /// Tells, as long as it runs, of publishers and subscribers that come and leave. Those that are there already come
    /// first: all that are marked, and those on the DDS topics of `topics`, which may change. One caller at a time: the
    /// news of a participant are given out once.
    pub async fn follow(&self, mut topics: watch::Receiver<BTreeSet<String>>, mut tell: impl FnMut(Change)) {
        let listener = self.dds.status_listener();
        let mut news = listener.as_async_status_stream();
        let mut known: BTreeMap<[u8; 16], Neighbour> = BTreeMap::new();
        loop {
            let meant = topics.borrow_and_update().clone();
            let all = self.publishers().chain(self.subscribers());
            let all = all.filter(|neighbour| neighbour.mark.is_some() || meant.contains(&neighbour.topic));
            let now: BTreeMap<_, _> = all.take(NEIGHBOURS_MAX).map(|neighbour| (neighbour.guid, neighbour)).collect();
            let before = std::mem::replace(&mut known, now);
            for (guid, neighbour) in &before {
                if !known.contains_key(guid) {
                    tell(Change::Left(neighbour.clone()));
                }
            }
            for (guid, neighbour) in &known {
                if !before.contains_key(guid) {
                    tell(Change::Came(neighbour.clone()));
                }
            }
            sleep(LOOK_PAUSE).await;
            let next = async {
                tokio::select! {
                    next = news.next() => next.map(drop),
                    Ok(()) = topics.changed() => Some(()),
                }
            };
            match timeout(LOOK_EVERY, next).await {
                // DDS has ended: its readers and writers say so.
                Ok(None) => return std::future::pending().await,
                // Whatever else came meanwhile is seen at the next look as well.
                Ok(Some(_)) => while let Some(Some(_)) = news.next().now_or_never() {},
                Err(_) => {}
            }
        }
    }
}
/// The hash in the USER_DATA of an endpoint: `typehash=RIHS01_…;` among other `key=value;`.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(user_data).ok()?;
    let hash = text.split(';').find_map(|part| part.trim().strip_prefix("typehash="))?;
    let digits = hash.strip_prefix("RIHS01_")?;
    let is_hash = digits.len() == 64 && digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_hash.then(|| hash.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_with_keys_are_told_by_their_guid() {
        let of = |kind| {
            let mut guid = [7; 16];
            let [.., last] = &mut guid;
            *last = kind;
            Neighbour::new(GUID::from_bytes(guid), Role::Publisher, "rt/x", "X_", QosPolicies::default()).is_keyed()
        };
        assert_eq!([0x02, 0x03, 0x04, 0x07].map(of), [true, false, false, true]);
    }

    #[test]
    fn the_hash_of_a_type_stands_in_the_user_data_of_an_endpoint() {
        let hash = format!("RIHS01_{}", "0a".repeat(32));
        assert_eq!(type_hash(format!("enclave=/;typehash={hash};").as_bytes()), Some(hash));
        for none in ["", "typehash=RIHS01_;", "typehash=RIHS02_00;", "hash=1", "\u{e9};;"] {
            assert_eq!(type_hash(none.as_bytes()), None, "{none}");
        }
    }
}
