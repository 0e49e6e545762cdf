//! The answers of a reader to a writer, and what it asks for: ACKNACK and NACK_FRAG (§8.3.8.1, §8.3.8.10).

use super::reliable::ReliableProxy;
use super::timing::{FIRST_HEARTBEAT_MICROS, Request, STALLED_MICROS};
use crate::endpoint::Outgoing;
use crate::guid::{EntityId, SequenceNumber};
use crate::limits::SET_BITS_MAX;
use crate::wire::submessage::{AckNack, NackFrag, NumberSet, Submessage};

/// Least time between two requests for the same, microseconds.
const REQUEST_MICROS_MIN: u64 = 10_000;
/// Time after which a request without effect is repeated without a HEARTBEAT, microseconds. It doubles up to the longest one.
const REQUEST_MICROS: u64 = 20_000;
/// Longest time between two requests, microseconds.
const REQUEST_MICROS_MAX: u64 = 1_000_000;
/// Most NACK_FRAGs at once.
const NACK_FRAGS_MAX: usize = 4;

impl ReliableProxy {
    pub(super) fn due(&self) -> Option<u64> {
        self.timing.due
    }

    pub(super) fn count(&self) -> i32 {
        self.timing.count
    }

    /// Sends what is due.
    pub(super) fn poll(&mut self, now: u64, reader: EntityId, out: &mut Vec<Outgoing>) {
        if self.timing.due.is_none_or(|due| due > now) {
            return;
        }
        self.timing.due = None;
        if !self.is_synchronized {
            // Fast DDS takes a base of 0 for "has nothing", and only that makes it forget what a reader had acknowledged before it was
            // lost. Others want a valid set (§8.3.5.5).
            let base = i64::from(!self.peer.is_fast_dds);
            self.send(reader, NumberSet::new(base), &[], false, out);
            let mut interval = FIRST_HEARTBEAT_MICROS;
            if !self.store.is_empty() {
                interval = self.timing.interval;
                self.timing.interval = interval.saturating_mul(2).min(FIRST_HEARTBEAT_MICROS);
            }
            self.timing.schedule(now.saturating_add(interval));
            return;
        }
        self.notice_stalled(now);
        self.reopen(now);
        if now < self.tight_until {
            self.timing.schedule(self.tight_until);
        }
        let (missing, fragments) = self.missing(now);
        let is_missing = !fragments.is_empty() || !missing.is_empty();
        let is_asked = self.timing.is_asked;
        let is_unchanged = |request: &Request| request.next == self.next && request.came == self.timing.came;
        if is_missing && let Some(request) = self.timing.request.filter(is_unchanged) {
            let wait = if is_asked { REQUEST_MICROS_MIN } else { self.timing.interval };
            let earliest = request.at.saturating_add(wait);
            if earliest > now {
                self.timing.schedule(earliest);
                return;
            }
            self.timing.interval = self.timing.interval.saturating_mul(2).min(REQUEST_MICROS_MAX);
        } else {
            self.timing.interval = REQUEST_MICROS;
        }
        if is_missing || is_asked {
            self.timing.is_asked = false;
            self.send(reader, missing, &fragments, !is_missing, out);
        }
        if is_missing {
            self.timing.request = Some(Request { at: now, next: self.next, came: self.timing.came });
            self.timing.schedule(now.saturating_add(self.timing.interval));
        }
    }

    /// A sample whose fragments stopped coming is requested as if a HEARTBEAT had announced it: that may have been lost.
    fn notice_stalled(&mut self, now: u64) {
        let Some(highest) = self.store.highest_assembly().filter(|highest| *highest > self.last) else { return };
        let stalled = self.timing.fragment_at.saturating_add(STALLED_MICROS);
        if stalled <= now {
            self.last = highest;
        } else {
            self.timing.schedule(stalled);
        }
    }

    /// The samples of which nothing has come, and the fragments of those that came in part.
    fn missing(&self, now: u64) -> (NumberSet, Vec<(i64, NumberSet)>) {
        // Never above what the writer has: Fast DDS would ignore it. What was delivered it has, also if an old HEARTBEAT came late.
        let previous = self.next.saturating_sub(1);
        let base =
            if self.delivered.contains(previous) { self.next } else { self.next.min(self.last.saturating_add(1)) };
        let mut missing = NumberSet::new(base);
        let mut fragments = Vec::new();
        // The next one always finds room, unless other writers need it.
        let least = if now < self.tight_until { 0 } else { self.next };
        let room_until = self.room_until.saturating_sub(1).max(least);
        let until = self.last.min(room_until).min(base.saturating_add(i64::from(SET_BITS_MAX) - 1));
        for number in self.next..=until {
            if let Some(set) = self.store.missing_fragments(number) {
                if fragments.len() < NACK_FRAGS_MAX {
                    fragments.push((number, set));
                }
            } else if number >= self.start
                && !self.store.is_whole(number)
                && self.gaps.end_of(number).is_none()
                && !self.delivered.contains(number)
            {
                missing.insert(number);
            }
        }
        (missing, fragments)
    }

    fn send(
        &mut self,
        reader: EntityId,
        missing: NumberSet,
        fragments: &[(i64, NumberSet)],
        is_final: bool,
        out: &mut Vec<Outgoing>,
    ) {
        let writer = self.peer.guid.entity;
        let count = self.timing.next_count();
        let mut submessages = vec![Submessage::AckNack(AckNack { reader, writer, missing, count, is_final })];
        for (number, missing) in fragments {
            let (sequence, missing, count) = (SequenceNumber(*number), missing.clone(), self.timing.next_count());
            submessages.push(Submessage::NackFrag(NackFrag { reader, writer, sequence, missing, count }));
        }
        out.push(Outgoing {
            to: self.peer.unicast.clone(),
            destination: self.peer.guid.prefix,
            timestamp: None,
            submessages,
        });
    }
}
