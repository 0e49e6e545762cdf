//! The last samples of each publisher of a latched topic, such as `/tf_static` or `/robot_description`.
//!
//! All of them go to the ledger in one call whenever one of them changes, and again from time to time. So the last call of
//! the bridge, whose place the ledger knows, has what somebody needs who comes late; and the blocks that nodes keep have it.

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use ledger::transaction::TRANSACTION_BYTES_MAX;
use ledger_base::settings::Section;

use crate::graph::queue::Incoming;

/// The keys of the settings.
pub(in crate::routes) const KEYS: [&str; 2] = ["latched_depth", "latched_again_s"];
/// How long changes of several publishers are gathered.
const GATHER: Duration = Duration::from_millis(100);
/// Pause after a refusal.
const RETRY_PAUSE: Duration = Duration::from_secs(2);
/// Most samples of a call.
pub(super) const SAMPLES_MAX: usize = 512;
/// Most bytes of the samples of a call: those of a transaction without its head, and without what it adds to each sample.
pub(super) const BYTES_MAX: usize = TRANSACTION_BYTES_MAX - 64 * 1024;
const DEPTH_MAX: u64 = 100;
const AGAIN_S_MIN: u64 = 10;
const AGAIN_S_MAX: u64 = 86_400;

/// The settings of a latched topic.
#[derive(Debug, Clone, Copy)]
pub(in crate::routes) struct LatchSettings {
    /// Samples that are kept of each publisher: no discovery tells how many it keeps itself.
    depth: usize,
    again: Duration,
}

impl Default for LatchSettings {
    fn default() -> Self {
        Self { depth: 1, again: Duration::from_secs(3600) }
    }
}

impl LatchSettings {
    /// Reads the settings under [`KEYS`].
    pub(super) fn read(section: &mut Section<'_, '_>) -> Self {
        let mut terms = Self::default();
        let mut again_s = terms.again.as_secs();
        section.integer(KEYS[0], 1..=DEPTH_MAX, &mut terms.depth);
        section.integer(KEYS[1], AGAIN_S_MIN..=AGAIN_S_MAX, &mut again_s);
        terms.again = Duration::from_secs(again_s);
        terms
    }
}

/// The samples.
#[derive(Debug, Default)]
pub(super) struct Latch {
    terms: LatchSettings,
    publishers: BTreeMap<[u8; 16], VecDeque<Incoming>>,
    /// When the samples are to be said.
    due: Option<Instant>,
}

impl Latch {
    pub(super) fn new(terms: LatchSettings) -> Self {
        Self { terms, ..Self::default() }
    }

    /// Keeps a sample in the place of the oldest of its publisher. Answers how many have no room now: the oldest of all, or this one
    /// if it is larger than a call.
    pub(super) fn keep(&mut self, incoming: Incoming, now: Instant) -> u64 {
        if incoming.sample.wire().len() > BYTES_MAX {
            return 1;
        }
        let samples = self.publishers.entry(incoming.source).or_default();
        samples.push_back(incoming);
        while samples.len() > self.terms.depth {
            samples.pop_front();
        }
        let soon = now + GATHER;
        self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
        self.make_room()
    }

    /// When the samples are to be said; none if there are none.
    pub(super) fn due(&self) -> Option<Instant> {
        self.due.filter(|_| !self.publishers.is_empty())
    }

    /// The samples to say now, in the order in which they came. `is_there` tells who still publishes: what others have said before
    /// is forgotten.
    pub(super) fn take(&mut self, is_there: impl Fn(&[u8; 16]) -> bool, now: Instant) -> Vec<Incoming> {
        let since = now.checked_sub(self.terms.again);
        self.publishers.retain(|source, samples| {
            let is_recent = samples.back().is_some_and(|last| since.is_none_or(|since| last.received >= since));
            is_recent || is_there(source)
        });
        self.due = Some(now + self.terms.again);
        let mut samples: Vec<Incoming> = self.publishers.values().flatten().cloned().collect();
        samples.sort_by_key(|incoming| incoming.received);
        samples
    }

    /// They were not accepted: they are to be said again.
    pub(super) fn refused(&mut self, now: Instant) {
        self.due = Some(now + RETRY_PAUSE);
    }

    /// The oldest leave until all fit into one call. Answers how many.
    fn make_room(&mut self) -> u64 {
        let mut left_out = 0;
        loop {
            let all = || self.publishers.values().flatten();
            let bytes: usize = all().map(|incoming| incoming.sample.wire().len()).sum();
            if bytes <= BYTES_MAX && all().count() <= SAMPLES_MAX {
                return left_out;
            }
            let oldest = |(_, samples): &(&[u8; 16], &VecDeque<Incoming>)| samples.front().map(|first| first.received);
            let Some(source) = self.publishers.iter().min_by_key(oldest).map(|(source, _)| *source) else {
                return left_out;
            };
            if let Some(samples) = self.publishers.get_mut(&source) {
                samples.pop_front();
            }
            self.publishers.retain(|_, samples| !samples.is_empty());
            left_out += 1;
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::{CDR_LE, HEADER_BYTES, Sample};

    fn said(source: u8, number: u8, bytes: usize, received: Instant) -> Incoming {
        let mut body = vec![0; bytes];
        *body.first_mut().unwrap() = number;
        Incoming {
            sample: Sample::new(CDR_LE, &body).unwrap(),
            source: [source; 16],
            sequence: 0,
            received,
            wall: std::time::SystemTime::now(),
            waited: Duration::ZERO,
        }
    }

    fn numbers(samples: &[Incoming]) -> Vec<u8> {
        samples.iter().map(|incoming| *incoming.sample.body().first().unwrap()).collect()
    }

    #[test]
    fn the_last_samples_of_all_publishers_are_said_together_soon_and_again() {
        let (mut latch, start) =
            (Latch::new(LatchSettings { depth: 2, again: Duration::from_secs(60) }), Instant::now());
        assert_eq!(latch.due(), None);
        for (number, source) in [(1, 1), (2, 2), (3, 1), (4, 1)] {
            let at = start + Duration::from_millis(u64::from(number));
            latch.keep(said(source, number, 9, at), at);
        }
        assert_eq!(latch.due(), Some(start + Duration::from_millis(1) + GATHER), "not put off by what comes after");
        let now = start + GATHER;
        assert_eq!(numbers(&latch.take(|_| true, now)), [2, 3, 4]);
        assert_eq!(latch.due(), Some(now + Duration::from_secs(60)));
        let later = now + Duration::from_secs(60);
        assert_eq!(numbers(&latch.take(|source| *source == [2; 16], later)), [2], "the other has left");
        latch.refused(later);
        assert_eq!(latch.due(), Some(later + RETRY_PAUSE));
        assert_eq!(numbers(&latch.take(|_| false, later)), [0; 0]);
        assert_eq!(latch.due(), None);
    }

    #[test]
    fn the_oldest_make_room_in_the_one_call_and_are_counted() {
        let (mut latch, start) = (Latch::default(), Instant::now());
        for number in 0..5 {
            let at = start + Duration::from_millis(u64::from(number));
            let left_out = latch.keep(said(number, number, BYTES_MAX / 4, at), at);
            assert_eq!(left_out, u64::from(number > 2), "three have room");
        }
        let said = latch.take(|_| true, start);
        assert_eq!(numbers(&said), [2, 3, 4]);
        assert!(said.iter().map(|incoming| incoming.sample.wire().len()).sum::<usize>() <= BYTES_MAX);
    }

    #[test]
    fn a_sample_is_kept_if_a_transaction_can_hold_it_and_is_never_crowded_out_by_itself() {
        let (mut latch, start) = (Latch::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        // A map of 1000 by 1000 cells.
        assert_eq!(latch.keep(said(1, 1, 1_000_100, at(1)), at(1)), 0);
        assert_eq!(numbers(&latch.take(|_| true, at(2))), [1]);
        // With its header it is as large as can be.
        assert_eq!(latch.keep(said(2, 2, BYTES_MAX - HEADER_BYTES, at(3)), at(3)), 1, "the map makes room");
        assert_eq!(numbers(&latch.take(|_| true, at(4))), [2]);
        assert_eq!(latch.keep(said(3, 3, BYTES_MAX, at(5)), at(5)), 1, "it has no room itself");
        assert_eq!(numbers(&latch.take(|_| true, at(6))), [2]);
    }
}
