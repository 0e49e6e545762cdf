//! The last samples of each publisher of a latched topic, such as `/tf_static` or `/robot_description`.
//!
//! All of them go to the ledger in one call whenever one of them changes, and again from time to time. So the last call of
//! the bridge, whose place the ledger knows, has what somebody needs who comes late; and the blocks that nodes keep have it.

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use ledger_settings::Section;

use crate::queue::Incoming;

/// The keys of the settings.
pub(super) const KEYS: [&str; 2] = ["latched_depth", "latched_again_s"];
/// How long changes of several publishers are gathered.
const GATHER: Duration = Duration::from_millis(100);
/// Pause after a refusal.
const RETRY_PAUSE: Duration = Duration::from_secs(2);
/// Most samples of a call.
const SAMPLES_MAX: usize = 512;
/// Most bytes of a call: all publishers say theirs again with each change.
const BYTES_MAX: usize = 1024 * 1024 - 64 * 1024;
const DEPTH_MAX: u64 = 100;
const AGAIN_S_MIN: u64 = 10;
const AGAIN_S_MAX: u64 = 86_400;

/// The settings of a latched topic.
#[derive(Debug, Clone, Copy)]
pub(super) struct Terms {
    /// Samples that are kept of each publisher: no discovery tells how many it keeps itself.
    depth: usize,
    again: Duration,
}

impl Default for Terms {
    fn default() -> Self {
        Self { depth: 1, again: Duration::from_secs(3600) }
    }
}

impl Terms {
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
    terms: Terms,
    publishers: BTreeMap<[u8; 16], VecDeque<Incoming>>,
    /// When the samples are to be said.
    due: Option<Instant>,
    /// Have samples been left out, because there is no room for them?
    crowded: bool,
}

impl Latch {
    pub(super) fn new(terms: Terms) -> Self {
        Self { terms, ..Self::default() }
    }

    /// Keeps a sample in the place of the oldest of its publisher.
    pub(super) fn keep(&mut self, incoming: Incoming, now: Instant) {
        let samples = self.publishers.entry(incoming.source).or_default();
        samples.push_back(incoming);
        while samples.len() > self.terms.depth {
            samples.pop_front();
        }
        self.make_room();
        let soon = now + GATHER;
        self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
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

    /// Were samples left out since the last time?
    pub(super) fn was_crowded(&mut self) -> bool {
        std::mem::take(&mut self.crowded)
    }

    /// The oldest leave until all fit into one call.
    fn make_room(&mut self) {
        loop {
            let all = || self.publishers.values().flatten();
            let bytes: usize = all().map(|incoming| incoming.sample.wire().len()).sum();
            if bytes <= BYTES_MAX && all().count() <= SAMPLES_MAX {
                return;
            }
            let oldest = |(_, samples): &(&[u8; 16], &VecDeque<Incoming>)| samples.front().map(|first| first.received);
            let Some(source) = self.publishers.iter().min_by_key(oldest).map(|(source, _)| *source) else { return };
            if let Some(samples) = self.publishers.get_mut(&source) {
                samples.pop_front();
            }
            self.publishers.retain(|_, samples| !samples.is_empty());
            self.crowded = true;
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::{CDR_LE, Sample};

    fn said(source: u8, number: u8, bytes: usize, received: Instant) -> Incoming {
        let mut body = vec![0; bytes];
        *body.first_mut().unwrap() = number;
        Incoming { sample: Sample::new(CDR_LE, &body).unwrap(), source: [source; 16], sequence: 0, received }
    }

    fn numbers(samples: &[Incoming]) -> Vec<u8> {
        samples.iter().map(|incoming| *incoming.sample.body().first().unwrap()).collect()
    }

    #[test]
    fn the_last_samples_of_all_publishers_are_said_together_soon_and_again() {
        let (mut latch, start) = (Latch::new(Terms { depth: 2, again: Duration::from_secs(60) }), Instant::now());
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
    fn the_oldest_make_room_in_the_one_call_and_that_is_told() {
        let (mut latch, start) = (Latch::default(), Instant::now());
        for number in 0..5 {
            let at = start + Duration::from_millis(u64::from(number));
            latch.keep(said(number, number, BYTES_MAX / 4, at), at);
        }
        assert!(latch.was_crowded() && !latch.was_crowded());
        let said = latch.take(|_| true, start);
        assert_eq!(numbers(&said), [2, 3, 4]);
        assert!(said.iter().map(|incoming| incoming.sample.wire().len()).sum::<usize>() <= BYTES_MAX);
    }
}
