//! Asserts the liveliness of own writers (§8.4.13): one message of the participant for all of a kind.
//!
//! AUTOMATIC ones by a timer. MANUAL_BY_PARTICIPANT ones when one of them writes or is asserted, and by no timer alone.

use crate::guid::{EntityId, GuidPrefix, PREFIX_BYTES};
use crate::qos::LivelinessKind;
use crate::time::Now;
use bytes::{BufMut, Bytes, BytesMut};
use std::collections::BTreeMap;

/// Assertions in the shortest lease of a writer: two may be lost.
const ASSERTIONS_PER_LEASE: u64 = 3;
/// Shortest time between two assertions, microseconds.
const PERIOD_MIN: u64 = 10_000;
/// Encapsulation header of CDR_LE.
const CDR_LE: [u8; 4] = [0, 1, 0, 0];
/// `PARTICIPANT_MESSAGE_DATA_KIND_AUTOMATIC_LIVELINESS_UPDATE`.
const AUTOMATIC: [u8; 4] = [0, 0, 0, 1];
/// `PARTICIPANT_MESSAGE_DATA_KIND_MANUAL_LIVELINESS_UPDATE`.
const MANUAL: [u8; 4] = [0, 0, 0, 2];

/// When to assert.
#[derive(Debug, Default)]
pub(crate) struct Liveliness {
    automatic: Kind,
    manual: Kind,
}

/// The writers of one kind.
#[derive(Debug, Default)]
struct Kind {
    /// Their leases, microseconds.
    leases: BTreeMap<EntityId, u64>,
    next: Option<u64>,
    /// When they were asserted last.
    sent: Option<u64>,
}

impl Kind {
    fn add(&mut self, now: Now, writer: EntityId, lease: u64) {
        self.leases.insert(writer, lease);
        self.next = Some(now.steady);
    }

    fn remove(&mut self, writer: EntityId) {
        self.leases.remove(&writer);
        if self.leases.is_empty() {
            self.next = None;
        }
    }

    fn period(&self) -> Option<u64> {
        Some((self.leases.values().min()? / ASSERTIONS_PER_LEASE).max(PERIOD_MIN))
    }

    /// Is an assertion due?
    fn take_due(&mut self, now: Now) -> bool {
        let is_due = self.next.is_some_and(|at| at <= now.steady);
        if is_due {
            self.next = None;
            self.sent = Some(now.steady);
        }
        is_due
    }
}

impl Liveliness {
    /// A writer with a finite lease, microseconds. It is asserted at once. One of kind MANUAL_BY_TOPIC asserts itself.
    pub(crate) fn add(&mut self, now: Now, writer: EntityId, kind: LivelinessKind, lease: u64) {
        match kind {
            LivelinessKind::Automatic => self.automatic.add(now, writer, lease),
            LivelinessKind::ManualByParticipant => self.manual.add(now, writer, lease),
            LivelinessKind::ManualByTopic => {}
        }
    }

    /// A writer has been closed.
    pub(crate) fn remove(&mut self, writer: EntityId) {
        self.automatic.remove(writer);
        self.manual.remove(writer);
    }

    /// A writer of kind MANUAL_BY_PARTICIPANT has written, or is asserted. Others get to know it at once, or a third of the lease after
    /// they did last.
    pub(crate) fn assert_manually(&mut self, now: Now) {
        let Some(period) = self.manual.period() else { return };
        let earliest = self.manual.sent.map_or(now.steady, |sent| sent.saturating_add(period).max(now.steady));
        self.manual.next = Some(self.manual.next.map_or(earliest, |next| next.min(earliest)));
    }

    /// When the next assertion is due.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.automatic.next.into_iter().chain(self.manual.next).min()
    }

    /// The assertions that are due, as payloads of samples.
    pub(crate) fn poll(&mut self, now: Now, prefix: GuidPrefix) -> Vec<Bytes> {
        let mut due = Vec::new();
        if self.automatic.take_due(now) {
            self.automatic.next = self.automatic.period().map(|period| now.steady.saturating_add(period));
            due.push(message(prefix, AUTOMATIC));
        }
        if self.manual.take_due(now) {
            due.push(message(prefix, MANUAL));
        }
        due
    }
}

/// `ParticipantMessageData` (§9.6.3.1) without data, in CDR_LE.
fn message(prefix: GuidPrefix, kind: [u8; 4]) -> Bytes {
    let mut bytes = BytesMut::with_capacity(24);
    bytes.put_slice(&CDR_LE);
    bytes.put_slice(&prefix.0);
    bytes.put_slice(&kind);
    bytes.put_u32_le(0);
    bytes.freeze()
}

/// Does this message of a participant assert its writers of kind MANUAL_BY_PARTICIPANT? Neither its byte order nor its data count.
pub(crate) fn is_manual(prefix: GuidPrefix, message: &[u8]) -> bool {
    let rest = message.get(CDR_LE.len()..).and_then(|rest| rest.split_at_checked(PREFIX_BYTES));
    rest.is_some_and(|(of, rest)| of == prefix.0 && rest.starts_with(&MANUAL))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PREFIX: GuidPrefix = GuidPrefix([7; 12]);

    fn at(steady: u64) -> Now {
        Now { steady, wall: 0 }
    }

    #[test]
    fn the_shortest_lease_is_asserted_three_times_until_its_writer_closes() {
        let [slow, fast] = [1, 2].map(|key| EntityId::writer(key, false));
        let mut liveliness = Liveliness::default();
        assert_eq!((liveliness.poll(at(0), PREFIX), liveliness.deadline()), (vec![], None));
        liveliness.add(at(0), slow, LivelinessKind::Automatic, 3_000_000);
        liveliness.add(at(0), fast, LivelinessKind::Automatic, 300_000);
        let automatic = [message(PREFIX, AUTOMATIC)];
        assert_eq!(liveliness.poll(at(0), PREFIX), automatic);
        assert!(liveliness.poll(at(99_999), PREFIX).is_empty());
        assert_eq!(liveliness.poll(at(100_000), PREFIX), automatic);
        liveliness.remove(fast);
        assert_eq!(liveliness.poll(at(200_000), PREFIX), automatic);
        assert_eq!(liveliness.deadline(), Some(1_200_000));
        liveliness.remove(slow);
        assert_eq!(liveliness.deadline(), None);
    }

    #[test]
    fn writers_of_kind_manual_by_participant_are_asserted_by_writing_and_never_by_time_alone() {
        let mut liveliness = Liveliness::default();
        liveliness.assert_manually(at(0));
        assert_eq!(liveliness.deadline(), None, "there is none");
        liveliness.add(at(0), EntityId::writer(1, false), LivelinessKind::ManualByParticipant, 300_000);
        liveliness.add(at(0), EntityId::writer(2, false), LivelinessKind::ManualByTopic, 10_000);
        assert_eq!(liveliness.poll(at(0), PREFIX), [message(PREFIX, MANUAL)]);
        assert_eq!(liveliness.deadline(), None);
        liveliness.assert_manually(at(30_000));
        liveliness.assert_manually(at(60_000));
        assert_eq!(liveliness.deadline(), Some(100_000), "often enough for the lease, and not for each sample");
        assert_eq!(liveliness.poll(at(100_000), PREFIX), [message(PREFIX, MANUAL)]);
        liveliness.assert_manually(at(900_000));
        assert_eq!((liveliness.poll(at(900_000), PREFIX).len(), liveliness.deadline()), (1, None));
    }

    #[test]
    fn a_message_asserts_manually_if_it_says_so_of_its_own_participant() {
        assert!(is_manual(PREFIX, &message(PREFIX, MANUAL)));
        assert!(
            !is_manual(PREFIX, &message(PREFIX, AUTOMATIC))
                && !is_manual(GuidPrefix([8; 12]), &message(PREFIX, MANUAL))
        );
        assert!(!is_manual(PREFIX, &message(PREFIX, MANUAL).slice(..19)) && !is_manual(PREFIX, &[]));
    }
}
