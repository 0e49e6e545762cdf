//! Neighbours in the domain: the publishers and subscribers of other participants, as discovery knows them.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use rtps::{
    guid::{EntityId, Guid},
    interface::RemoteEndpoint,
    qos::Qos as Policies,
};
use tokio::{sync::watch, time::sleep};

use super::participant::Participant;
use crate::graph::{endpoint::Role, mark::Mark};

/// Between two looks, however much changes: a look costs as much as there are endpoints in the domain.
const LOOK_PAUSE: Duration = Duration::from_millis(100);
/// Most endpoints that are followed; more are not told of.
const NEIGHBOURS_MAX: usize = 4096;

/// The words for an endpoint that no datagram reaches, behind its name.
pub(crate) const UNREACHABLE: &str =
    "has no address for UDP over IPv4: nothing passes until its node starts with FASTDDS_BUILTIN_TRANSPORTS=DEFAULT";
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
    pub qos: Policies,
    /// Set by bridges.
    pub mark: Option<Mark>,
    /// Does it take messages by UDP over IPv4? Fast DDS with shared memory or TCP alone does not.
    pub is_reachable: bool,
    /// Its participant: unique in the world.
    pub participant: [u8; 16],
    /// Does its middleware keep endpoints apart whose quality of service does not fit? zenoh does not.
    pub is_strict: bool,
}

impl Neighbour {
    pub(super) fn of(endpoint: &RemoteEndpoint) -> Self {
        let role = if endpoint.guid.entity.is_writer() { Role::Publisher } else { Role::Subscriber };
        Self {
            guid: endpoint.guid.to_bytes(),
            role,
            topic: endpoint.topic.name.clone(),
            type_name: endpoint.topic.type_name.clone(),
            qos: endpoint.qos.clone(),
            mark: Mark::of(&endpoint.qos),
            is_reachable: endpoint.is_reachable,
            participant: Guid::new(endpoint.guid.prefix, EntityId::PARTICIPANT).to_bytes(),
            is_strict: true,
        }
    }

    /// Is its topic declared with keys? The last byte of a GUID says so.
    pub(crate) fn is_keyed(&self) -> bool {
        self.is_strict && matches!(self.guid, [.., WRITER_WITH_KEY | READER_WITH_KEY])
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
        self.dds.publishers().into_iter().map(|endpoint| Neighbour::of(&endpoint))
    }

    /// Is this publisher of another in the domain?
    pub(crate) fn has_publisher(&self, guid: &[u8; 16]) -> bool {
        self.dds.endpoint(Guid::from_bytes(*guid)).is_some_and(|found| found.guid.entity.is_writer())
    }

    /// The hash that an endpoint in the graph announces for a type.
    pub(super) fn hash_in_graph(&self, dds_type: &str) -> Option<String> {
        let all = self.dds.publishers().into_iter().chain(self.dds.subscribers());
        let mut announced = all.filter(|endpoint| endpoint.topic.type_name == dds_type);
        announced.find_map(|endpoint| type_hash(&endpoint.user_data))
    }

    /// The subscribers of others, now.
    pub(super) fn subscribers(&self) -> impl Iterator<Item = Neighbour> {
        self.dds.subscribers().into_iter().map(|endpoint| Neighbour::of(&endpoint))
    }

    /// Tells, as long as it runs, of publishers and subscribers that come and leave. Those that are there already come
    /// first: all that are marked, and those on the DDS topics of `topics`, which may change.
    pub async fn follow(&self, mut topics: watch::Receiver<BTreeSet<String>>, mut tell: impl FnMut(Change)) {
        let mut changes = self.dds.changes();
        let mut known: BTreeMap<[u8; 16], Neighbour> = BTreeMap::new();
        loop {
            changes.mark_unchanged();
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
            tokio::select! {
                changed = changes.changed() => if changed.is_err() {
                    // DDS has ended: its readers and writers say so.
                    return std::future::pending().await;
                },
                Ok(()) = topics.changed() => {}
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
    use bytes::Bytes;
    use rtps::{guid::VendorId, interface::TopicDescription};

    #[test]
    fn endpoints_with_keys_are_told_by_their_guid() {
        let of = |kind| {
            let mut guid = [7; 16];
            let [.., last] = &mut guid;
            *last = kind;
            let topic = TopicDescription { name: "rt/x".to_owned(), type_name: "X_".to_owned(), keyed: false };
            let (qos, user_data, vendor) = (Policies::default(), Bytes::new(), VendorId::UNKNOWN);
            let guid = Guid::from_bytes(guid);
            Neighbour::of(&RemoteEndpoint { guid, vendor, topic, qos, user_data, is_reachable: true }).is_keyed()
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
