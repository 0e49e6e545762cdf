//! Whether the writers of others are alive, by the leases that they offer (DDS 1.4 §2.2.3.11, RTPS §8.4.13).
//!
//! AUTOMATIC: anything of the participant asserts it. MANUAL_BY_PARTICIPANT: a message that says so, and samples of any writer of
//! that kind. MANUAL_BY_TOPIC: samples of the writer, and HEARTBEATs that say so. A writer is alive when it is found. One without
//! a finite lease is not followed: it ends with its participant.

use super::remote::LEASE_MIN;
use crate::guid::{EntityId, Guid, GuidPrefix};
use crate::qos::{LivelinessKind, Qos};
use crate::time::Now;
use crate::timers::Timers;
use std::collections::BTreeMap;

/// A writer has lost its liveliness, or has it again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LivelinessChange {
    pub(crate) writer: Guid,
    pub(crate) is_alive: bool,
}

#[derive(Debug)]
struct WriterLease {
    kind: LivelinessKind,
    /// Microseconds.
    lease: u64,
    /// When it was found, or asserted itself last.
    asserted: u64,
    is_alive: bool,
}

/// A participant that has writers with leases.
#[derive(Debug, Default)]
struct Participant {
    /// When anything came of it.
    heard: u64,
    /// When it asserted its writers of kind MANUAL_BY_PARTICIPANT.
    asserted: u64,
    writers: usize,
    /// Writers that are not alive.
    lost: usize,
}

/// The writers with finite leases.
#[derive(Debug, Default)]
pub(crate) struct WriterLeases {
    writers: BTreeMap<Guid, WriterLease>,
    /// Invariant: the participants of `writers`, and how many they are.
    participants: BTreeMap<GuidPrefix, Participant>,
    /// When leases are looked at. Those that are renewed meanwhile are not moved: that costs nothing for each message.
    timers: Timers<Guid>,
}

impl WriterLeases {
    /// A writer was found, or offers something else.
    pub(crate) fn add(&mut self, now: Now, writer: Guid, qos: &Qos) {
        self.remove(writer);
        let Some(lease) = qos.liveliness_lease.to_micros() else { return };
        let lease = lease.max(LEASE_MIN);
        let state = WriterLease { kind: qos.liveliness, lease, asserted: now.steady, is_alive: true };
        self.timers.set(writer, Some(now.steady.saturating_add(lease)));
        self.writers.insert(writer, state);
        self.participants.entry(writer.prefix).or_default().writers += 1;
    }

    /// A writer has gone.
    pub(crate) fn remove(&mut self, writer: Guid) {
        let Some(state) = self.writers.remove(&writer) else { return };
        self.timers.set(writer, None);
        if let Some(participant) = self.participants.get_mut(&writer.prefix) {
            participant.writers -= 1;
            participant.lost -= usize::from(!state.is_alive);
            if participant.writers == 0 {
                self.participants.remove(&writer.prefix);
            }
        }
    }

    /// Is it alive, as far as its lease says?
    pub(crate) fn is_alive(&self, writer: Guid) -> bool {
        self.writers.get(&writer).is_none_or(|state| state.is_alive)
    }

    /// Something has come of a participant.
    pub(crate) fn heard(&mut self, now: Now, prefix: GuidPrefix, changes: &mut Vec<LivelinessChange>) {
        if let Some(participant) = self.participants.get_mut(&prefix) {
            participant.heard = now.steady;
            self.revive(now, prefix, LivelinessKind::Automatic, changes);
        }
    }

    /// A participant asserts its writers of kind MANUAL_BY_PARTICIPANT.
    pub(crate) fn asserted(&mut self, now: Now, prefix: GuidPrefix, changes: &mut Vec<LivelinessChange>) {
        if let Some(participant) = self.participants.get_mut(&prefix) {
            participant.asserted = now.steady;
            self.revive(now, prefix, LivelinessKind::ManualByParticipant, changes);
        }
    }

    /// A writer has written, or asserts itself.
    pub(crate) fn wrote(&mut self, now: Now, writer: Guid, changes: &mut Vec<LivelinessChange>) {
        let Some(state) = self.writers.get_mut(&writer) else { return };
        state.asserted = now.steady;
        if state.kind == LivelinessKind::ManualByParticipant {
            self.asserted(now, writer.prefix, changes);
        } else if !state.is_alive {
            self.revive_one(now, writer, changes);
        }
    }

    /// The writers of this kind that were lost are alive again.
    fn revive(&mut self, now: Now, prefix: GuidPrefix, kind: LivelinessKind, changes: &mut Vec<LivelinessChange>) {
        if self.participants.get(&prefix).is_none_or(|participant| participant.lost == 0) {
            return;
        }
        let all = Guid::new(prefix, EntityId([0; 4]))..=Guid::new(prefix, EntityId([0xff; 4]));
        let lost = self.writers.range(all).filter(|(_, state)| !state.is_alive && state.kind == kind);
        let lost: Vec<Guid> = lost.map(|(writer, _)| *writer).collect();
        lost.into_iter().for_each(|writer| self.revive_one(now, writer, changes));
    }

    fn revive_one(&mut self, now: Now, writer: Guid, changes: &mut Vec<LivelinessChange>) {
        let Some(state) = self.writers.get_mut(&writer) else { return };
        state.is_alive = true;
        self.timers.set(writer, Some(now.steady.saturating_add(state.lease)));
        if let Some(participant) = self.participants.get_mut(&writer.prefix) {
            participant.lost -= 1;
        }
        changes.push(LivelinessChange { writer, is_alive: true });
    }

    /// Reports the writers whose leases are over.
    pub(crate) fn poll(&mut self, now: Now, changes: &mut Vec<LivelinessChange>) {
        for writer in self.timers.take_due(now.steady) {
            let Some(state) = self.writers.get_mut(&writer) else { continue };
            let Some(participant) = self.participants.get_mut(&writer.prefix) else { continue };
            let asserted = match state.kind {
                LivelinessKind::Automatic => state.asserted.max(participant.heard),
                LivelinessKind::ManualByParticipant => state.asserted.max(participant.asserted),
                LivelinessKind::ManualByTopic => state.asserted,
            };
            let due = asserted.saturating_add(state.lease);
            if due > now.steady {
                self.timers.set(writer, Some(due));
            } else {
                state.is_alive = false;
                participant.lost += 1;
                changes.push(LivelinessChange { writer, is_alive: false });
            }
        }
    }

    /// When [`WriterLeases::poll`] has something to do next.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.timers.next()
    }

    /// This process stood still: it could not hear others meanwhile.
    pub(crate) fn postpone(&mut self, time: u64) {
        self.timers.postpone(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Ticks;

    const PREFIX: GuidPrefix = GuidPrefix([7; 12]);
    const LEASE: u64 = 1_000_000;

    fn at(steady: u64) -> Now {
        Now { steady, wall: 0 }
    }

    fn guid(key: u32) -> Guid {
        Guid::new(PREFIX, EntityId::writer(key, false))
    }

    /// Writers 1, 2 and 3 are of the three kinds, and 4 is a second one of MANUAL_BY_PARTICIPANT.
    fn leases() -> WriterLeases {
        let mut leases = WriterLeases::default();
        let kinds = [LivelinessKind::Automatic, LivelinessKind::ManualByParticipant, LivelinessKind::ManualByTopic];
        for (key, liveliness) in (1..).zip(kinds.into_iter().chain([LivelinessKind::ManualByParticipant])) {
            let qos = Qos { liveliness, liveliness_lease: Ticks::from_micros(LEASE), ..Qos::default() };
            leases.add(at(0), guid(key), &qos);
        }
        leases.add(at(0), guid(9), &Qos::default());
        leases
    }

    /// Lets time pass; the keys of writers that are not alive at its end.
    fn lost(leases: &mut WriterLeases, until: u64) -> Vec<u32> {
        while let Some(due) = leases.deadline().filter(|due| *due <= until) {
            leases.poll(at(due), &mut Vec::new());
        }
        (1..=9).filter(|key| !leases.is_alive(guid(*key))).collect()
    }

    #[test]
    fn without_assertions_every_finite_lease_ends_and_is_reported_once() {
        let mut leases = leases();
        assert_eq!(lost(&mut leases, LEASE - 1), [0; 0]);
        let mut changes = Vec::new();
        leases.poll(at(LEASE), &mut changes);
        leases.poll(at(9 * LEASE), &mut changes);
        let ended = |key| LivelinessChange { writer: guid(key), is_alive: false };
        assert_eq!(changes, [1, 2, 3, 4].map(ended));
        assert_eq!(leases.deadline(), None);
    }

    #[test]
    fn each_kind_is_asserted_in_its_own_way() {
        let mut leases = leases();
        leases.heard(at(LEASE / 2), PREFIX, &mut Vec::new());
        assert_eq!(lost(&mut leases, LEASE), [2, 3, 4], "by anything of the participant");
        leases.asserted(at(LEASE), PREFIX, &mut Vec::new());
        assert_eq!(lost(&mut leases, LEASE), [3], "by a message of the participant");
        leases.wrote(at(LEASE), guid(3), &mut Vec::new());
        assert_eq!(lost(&mut leases, LEASE), [0; 0], "by a sample of the writer");
        leases.wrote(at(2 * LEASE - 1), guid(4), &mut Vec::new());
        assert_eq!(lost(&mut leases, 2 * LEASE), [1, 3], "by a sample of another writer of the kind");
    }

    #[test]
    fn a_writer_that_is_alive_again_is_reported_once() {
        let mut leases = leases();
        lost(&mut leases, LEASE);
        let mut changes = Vec::new();
        for _ in 0..2 {
            leases.heard(at(LEASE), PREFIX, &mut changes);
            leases.wrote(at(LEASE), guid(2), &mut changes);
            leases.wrote(at(LEASE), guid(3), &mut changes);
        }
        let alive = |key| LivelinessChange { writer: guid(key), is_alive: true };
        assert_eq!(changes, [1, 2, 4, 3].map(alive));
    }

    #[test]
    fn writers_that_go_leave_nothing_and_another_offer_counts_at_once() {
        let mut leases = leases();
        lost(&mut leases, LEASE);
        leases.add(at(LEASE), guid(1), &Qos::default());
        assert!(leases.is_alive(guid(1)));
        (1..=9).for_each(|key| leases.remove(guid(key)));
        assert!(leases.writers.is_empty() && leases.participants.is_empty() && leases.deadline().is_none());
    }
}
