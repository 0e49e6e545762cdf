//! Asserts the liveliness of own writers (§8.4.13): one message of the participant for all of them.

use crate::guid::{EntityId, GuidPrefix};
use crate::time::Now;
use bytes::{BufMut, Bytes, BytesMut};
use std::collections::BTreeMap;

/// Assertions in the shortest lease of a writer: two may be lost.
const ASSERTIONS_PER_LEASE: u64 = 3;
/// Shortest time between two assertions, microseconds.
const PERIOD_MIN: u64 = 10_000;

/// When to assert.
#[derive(Debug, Default)]
pub(crate) struct Liveliness {
    /// The leases of own writers that are alive as long as their participant is, microseconds.
    leases: BTreeMap<EntityId, u64>,
    next: Option<u64>,
}

impl Liveliness {
    /// A writer of kind AUTOMATIC with a finite lease. It is asserted at once.
    pub(crate) fn add(&mut self, now: Now, writer: EntityId, lease: u64) {
        self.leases.insert(writer, lease);
        self.next = Some(now.steady);
    }

    /// A writer has been closed.
    pub(crate) fn remove(&mut self, writer: EntityId) {
        self.leases.remove(&writer);
        if self.leases.is_empty() {
            self.next = None;
        }
    }

    /// When the next assertion is due.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.next
    }

    /// The assertion that is due, as the payload of a sample.
    pub(crate) fn poll(&mut self, now: Now, prefix: GuidPrefix) -> Option<Bytes> {
        self.next.filter(|at| *at <= now.steady)?;
        let lease = self.leases.values().min()?;
        self.next = Some(now.steady.saturating_add((lease / ASSERTIONS_PER_LEASE).max(PERIOD_MIN)));
        Some(automatic(prefix))
    }
}

/// `ParticipantMessageData` (§9.6.3.1) of kind AUTOMATIC_LIVELINESS_UPDATE, without data, in CDR_LE.
fn automatic(prefix: GuidPrefix) -> Bytes {
    let mut bytes = BytesMut::with_capacity(24);
    bytes.put_slice(&[0, 1, 0, 0]);
    bytes.put_slice(&prefix.0);
    bytes.put_slice(&[0, 0, 0, 1]);
    bytes.put_u32_le(0);
    bytes.freeze()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(steady: u64) -> Now {
        Now { steady, wall: 0 }
    }

    #[test]
    fn the_shortest_lease_is_asserted_three_times_until_its_writer_closes() {
        let [slow, fast] = [1, 2].map(|key| EntityId::writer(key, false));
        let mut liveliness = Liveliness::default();
        assert_eq!((liveliness.poll(at(0), GuidPrefix([7; 12])), liveliness.deadline()), (None, None));
        liveliness.add(at(0), slow, 3_000_000);
        liveliness.add(at(0), fast, 300_000);
        let message = liveliness.poll(at(0), GuidPrefix([7; 12]));
        assert_eq!(message.as_ref().map(Bytes::len), Some(24));
        assert_eq!(liveliness.poll(at(99_999), GuidPrefix([7; 12])), None);
        assert_eq!(liveliness.poll(at(100_000), GuidPrefix([7; 12])), message);
        liveliness.remove(fast);
        assert_eq!(liveliness.poll(at(200_000), GuidPrefix([7; 12])), message);
        assert_eq!(liveliness.deadline(), Some(1_200_000));
        liveliness.remove(slow);
        assert_eq!(liveliness.deadline(), None);
    }
}
