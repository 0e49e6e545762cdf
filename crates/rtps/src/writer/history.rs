//! The newest samples of a writer, in the order of their numbers.

use crate::limits::{HISTORY_BYTES_MAX, HISTORY_SAMPLES_MAX};
use crate::qos::History as Depth;
use crate::time::Ticks;
use crate::wire::submessage::{InlineQos, Payload};
use std::collections::VecDeque;

/// Bytes that a sample counts beyond its payload: so that empty samples are bounded too.
pub(super) const SAMPLE_OVERHEAD: usize = 192;

/// A sample that was written.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) sequence: i64,
    /// By the steady clock: the lifespan counts from here, also when the wall clock jumps.
    pub(super) written: u64,
    pub(super) timestamp: Option<Ticks>,
    pub(super) inline_qos: InlineQos,
    pub(super) payload: Payload,
    /// The size of its fragments for local readers. Fixed when it is first sent: a reader that has some of its fragments can
    /// use no others.
    pub(super) fragment_bytes: u16,
    /// Bytes that were written before it.
    bytes_before: u64,
}

impl Sample {
    /// The bytes that it counts.
    fn bytes(&self) -> usize {
        SAMPLE_OVERHEAD.saturating_add(self.content().map_or(0, bytes::Bytes::len))
    }

    pub(super) fn content(&self) -> Option<&bytes::Bytes> {
        match &self.payload {
            Payload::None => None,
            Payload::Data(bytes) | Payload::Key(bytes) => Some(bytes),
        }
    }

    fn ends_an_instance(&self) -> bool {
        self.inline_qos.status != 0
    }
}

/// Why the oldest sample goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Excess {
    /// The depth of KEEP_LAST.
    Depth,
    /// The limits of bytes and samples.
    Room,
}

/// The samples that are kept. At most `depth` of them and [`HISTORY_BYTES_MAX`] bytes; the newest one is always kept.
#[derive(Debug)]
pub(super) struct History {
    samples: VecDeque<Sample>,
    /// Which of them end an instance, ascending.
    ends: VecDeque<i64>,
    depth: usize,
    /// Is it the depth that was asked for?
    is_keep_last: bool,
    bytes: usize,
    /// The number of the newest sample that was written.
    last: i64,
    /// Bytes that were ever written.
    written: u64,
}

impl History {
    pub(super) fn new(depth: Depth) -> Self {
        let asked = match depth {
            Depth::KeepLast(depth) => usize::try_from(depth).unwrap_or(usize::MAX).max(1),
            Depth::KeepAll => usize::MAX,
        };
        let depth = asked.min(HISTORY_SAMPLES_MAX);
        Self {
            samples: VecDeque::new(),
            ends: VecDeque::new(),
            depth,
            is_keep_last: asked == depth,
            bytes: 0,
            last: 0,
            written: 0,
        }
    }

    /// Adds a sample under the next number. Then [`History::pop_excess`] has to be called until nothing goes.
    pub(super) fn push(
        &mut self,
        written: u64,
        timestamp: Option<Ticks>,
        inline_qos: InlineQos,
        payload: Payload,
    ) -> i64 {
        self.last = self.last.saturating_add(1);
        let (sequence, bytes_before) = (self.last, self.written);
        let sample = Sample { sequence, written, timestamp, inline_qos, payload, fragment_bytes: 0, bytes_before };
        self.bytes = self.bytes.saturating_add(sample.bytes());
        self.written = self.written.saturating_add(u64::try_from(sample.bytes()).unwrap_or(u64::MAX));
        if sample.ends_an_instance() {
            self.ends.push_back(sequence);
        }
        self.samples.push_back(sample);
        sequence
    }

    /// Beyond depth or bytes the oldest sample goes, whoever still lacks it.
    pub(super) fn pop_excess(&mut self) -> Option<(i64, Excess)> {
        let excess = match self.samples.len() {
            0 | 1 => return None,
            _ if self.bytes > HISTORY_BYTES_MAX => Excess::Room,
            samples if samples > self.depth && self.is_keep_last => Excess::Depth,
            samples if samples > self.depth => Excess::Room,
            _ => return None,
        };
        let sequence = self.first();
        self.pop_oldest();
        Some((sequence, excess))
    }

    /// The number of the newest sample that was ever written; 0 if none.
    pub(super) fn last(&self) -> i64 {
        self.last
    }

    /// The oldest number that is kept; that of the next sample if none is.
    pub(super) fn first(&self) -> i64 {
        self.samples.front().map_or(self.last.saturating_add(1), |sample| sample.sequence)
    }

    pub(super) fn get(&self, sequence: i64) -> Option<&Sample> {
        self.at_or_after(sequence).filter(|sample| sample.sequence == sequence)
    }

    /// The oldest sample with this number or a higher one.
    pub(super) fn at_or_after(&self, sequence: i64) -> Option<&Sample> {
        self.samples.get(self.index(sequence))
    }

    /// Fixes the size of the fragments of a sample.
    pub(super) fn set_fragment_bytes(&mut self, sequence: i64, fragment_bytes: u16) {
        let index = self.index(sequence);
        if let Some(sample) = self.samples.get_mut(index).filter(|sample| sample.sequence == sequence) {
            sample.fragment_bytes = fragment_bytes;
        }
    }

    /// Removes one sample. Its number becomes a hole, or is below the first one.
    pub(super) fn remove(&mut self, sequence: i64) {
        self.take(sequence);
        if let Ok(index) = self.ends.binary_search(&sequence) {
            self.ends.remove(index);
        }
    }

    /// Removes all samples up to this number.
    pub(super) fn remove_until(&mut self, sequence: i64) {
        while self.samples.front().is_some_and(|sample| sample.sequence <= sequence) {
            self.pop_oldest();
        }
    }

    /// Removes the ends of instances up to this number.
    pub(super) fn remove_ends_until(&mut self, sequence: i64) {
        while let Some(end) = self.ends.front().copied().filter(|end| *end <= sequence) {
            self.ends.pop_front();
            self.take(end);
        }
    }

    /// Removes what was written before this moment.
    pub(super) fn remove_older_than(&mut self, steady: u64) {
        while self.samples.front().is_some_and(|sample| sample.written < steady) {
            self.pop_oldest();
        }
    }

    /// Bytes that were written behind this number, from the oldest one that is kept.
    pub(super) fn bytes_behind(&self, sequence: i64) -> usize {
        let before = self.at_or_after(sequence.saturating_add(1)).map_or(self.written, |sample| sample.bytes_before);
        usize::try_from(self.written.saturating_sub(before)).unwrap_or(usize::MAX)
    }

    fn index(&self, sequence: i64) -> usize {
        self.samples.partition_point(|sample| sample.sequence < sequence)
    }

    fn take(&mut self, sequence: i64) {
        let index = self.index(sequence);
        if self.samples.get(index).is_some_and(|sample| sample.sequence == sequence)
            && let Some(sample) = self.samples.remove(index)
        {
            self.bytes = self.bytes.saturating_sub(sample.bytes());
        }
    }

    fn pop_oldest(&mut self) {
        if let Some(sample) = self.samples.pop_front() {
            self.bytes = self.bytes.saturating_sub(sample.bytes());
            if self.ends.front() == Some(&sample.sequence) {
                self.ends.pop_front();
            }
        }
    }

    #[cfg(test)]
    pub(super) fn bytes_kept(&self) -> usize {
        self.bytes
    }

    #[cfg(test)]
    pub(super) fn numbers(&self) -> Vec<i64> {
        self.samples.iter().map(|sample| sample.sequence).collect()
    }
}
