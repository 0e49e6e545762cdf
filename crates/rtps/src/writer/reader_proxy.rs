//! The state of a writer for one matched reader (§8.4.9.2, `ReaderProxy`).

use crate::endpoint::Peer;
use crate::wire::submessage::NumberSet;

/// Most samples of which a reader can have fragments requested at once. The others are requested again after the next HEARTBEAT.
pub(super) const FRAGMENT_REQUESTS_MAX: usize = 8;
/// A count that does not grow is accepted after this time without one that does, microseconds: the reader has restarted, or a forged
/// count was too high.
pub(super) const COUNT_VALID_MICROS: u64 = 1_000_000;

/// A matched reader. Its size does not depend on what was written, or on what it requests; see the test of its bytes.
#[derive(Debug)]
pub(super) struct ReaderProxy {
    pub(super) peer: Peer,
    /// Samples up to this number are not for it: they were written before the match.
    pub(super) start: i64,
    /// It has everything up to this number, or has given it up. Neither below `start` nor above what was pushed.
    pub(super) acknowledged: i64,
    acknack_count: Count,
    nack_frag_count: Count,
    /// The newest request. It replaces older ones: each lists all that the reader lacks.
    pub(super) requested: Option<NumberSet>,
    /// The sample of the request that was sent in part, and the fragment with which it goes on.
    pub(super) resumed: Option<(i64, u32)>,
    /// Samples and their requested fragments.
    pub(super) fragments: Vec<(i64, NumberSet)>,
    /// Kept samples that a late best-effort reader gets, which cannot request them.
    pub(super) replay: Option<Replay>,
    /// It asks for a HEARTBEAT.
    pub(super) wants_heartbeat: bool,
    /// It stands in the queue of those that get an answer.
    pub(super) is_queued: bool,
}

/// Where the sending of kept samples stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Replay {
    pub(super) next: i64,
    pub(super) fragment: u32,
    pub(super) until: i64,
}

impl ReaderProxy {
    pub(super) fn new(peer: Peer, start: i64) -> Self {
        Self {
            peer,
            start,
            acknowledged: start,
            acknack_count: Count::default(),
            nack_frag_count: Count::default(),
            requested: None,
            resumed: None,
            fragments: Vec::new(),
            replay: None,
            wants_heartbeat: false,
            is_queued: false,
        }
    }

    /// Takes an ACKNACK: true if it is newer than the last one. `pushed`: the newest number that the reader can have.
    ///
    /// Acknowledged samples can be requested again: a reader that had given this writer up, and matches it again, begins
    /// from nothing.
    pub(super) fn take_acknack(
        &mut self,
        now: u64,
        count: i32,
        missing: &NumberSet,
        is_final: bool,
        pushed: i64,
    ) -> bool {
        if !self.acknack_count.take(now, count) {
            return false;
        }
        self.acknowledged = missing.base.saturating_sub(1).min(pushed).max(self.start);
        self.requested = missing.iter().any(|number| number <= pushed).then(|| missing.clone());
        self.wants_heartbeat |= !is_final;
        true
    }

    /// Takes a NACK_FRAG: true if it is newer than the last one.
    pub(super) fn take_nack_frag(&mut self, now: u64, count: i32, sequence: i64, missing: &NumberSet) -> bool {
        if !self.nack_frag_count.take(now, count) {
            return false;
        }
        self.fragments.retain(|(of, _)| *of != sequence);
        if self.fragments.len() < FRAGMENT_REQUESTS_MAX {
            self.fragments.push((sequence, missing.clone()));
        }
        true
    }
}

/// The count of the submessages of one kind of a reader.
#[derive(Debug, Default)]
struct Count {
    /// The last one that was taken, and when.
    last: Option<(i32, u64)>,
}

impl Count {
    /// Is this one newer? Counts wrap around.
    fn take(&mut self, now: u64, count: i32) -> bool {
        let is_newer = self
            .last
            .is_none_or(|(last, at)| count.wrapping_sub(last) > 0 || now.saturating_sub(at) >= COUNT_VALID_MICROS);
        if is_newer {
            self.last = Some((count, now));
        }
        is_newer
    }
}
