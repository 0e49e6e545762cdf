//! The samples that wait for the user of a reader, bounded in bytes and number.

use crate::interface::{IncomingSample, LossReason};
use bytes::Bytes;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// A sample up to this size is copied into memory of its own, bytes. Otherwise it would keep the datagram in which it came, with
/// everything else that came in it.
const COPIED_BYTES_MAX: usize = 4 * 1024;
/// Bytes that a waiting sample counts besides its payload.
const OVERHEAD_BYTES: usize = 128;

/// How many samples may wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimits {
    /// Most bytes.
    pub bytes: usize,
    /// Most samples.
    pub samples: usize,
}

/// Samples that the user of a reader will not get.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Those that did not reach the queue.
    pub lost: BTreeMap<LossReason, u64>,
    /// Those that newer ones pushed out of the queue, and those that were larger than the queue.
    pub dropped: u64,
}

/// Events of a reader since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReaderCounters {
    /// Deadlines within which no sample came.
    pub deadlines_missed: u64,
    /// How often the numbers of a writer began again, or were forged.
    pub resynchronized: u64,
}

/// The end of a queue from which samples are taken.
#[derive(Debug)]
pub(super) struct SampleQueue(Arc<Shared>);

/// The end of a queue to which samples are added. The queue is closed when it is dropped.
#[derive(Debug)]
pub(super) struct SampleSender(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    limits: QueueLimits,
    waiting: Mutex<Waiting>,
    arrived: Notify,
}

#[derive(Debug, Default)]
struct Waiting {
    samples: VecDeque<IncomingSample>,
    /// The sum of `cost` of the samples; at most `limits.bytes`.
    bytes: usize,
    losses: Losses,
    counters: ReaderCounters,
    is_closed: bool,
}

/// An empty queue.
pub(super) fn queue(limits: QueueLimits) -> (SampleSender, SampleQueue) {
    let shared = Arc::new(Shared { limits, waiting: Mutex::default(), arrived: Notify::new() });
    (SampleSender(Arc::clone(&shared)), SampleQueue(shared))
}

impl SampleSender {
    /// Appends a sample. The oldest make room; one that never fits is dropped itself.
    pub(super) fn push(&self, mut sample: IncomingSample) {
        let QueueLimits { bytes: bytes_max, samples: samples_max } = self.0.limits;
        let mut guard = self.0.lock();
        let waiting = &mut *guard;
        let bytes = cost(&sample);
        if bytes > bytes_max || samples_max == 0 {
            waiting.losses.dropped += 1;
            return;
        }
        while waiting.bytes + bytes > bytes_max || waiting.samples.len() >= samples_max {
            let Some(oldest) = waiting.samples.pop_front() else { break };
            waiting.bytes -= cost(&oldest);
            waiting.losses.dropped += 1;
        }
        if sample.payload.len() <= COPIED_BYTES_MAX {
            sample.payload = Bytes::copy_from_slice(&sample.payload);
        }
        waiting.bytes += bytes;
        waiting.samples.push_back(sample);
        drop(guard);
        self.0.arrived.notify_one();
    }

    /// Counts samples that will not come.
    pub(super) fn lost(&self, count: u64, reason: LossReason) {
        let mut waiting = self.0.lock();
        let lost = waiting.losses.lost.entry(reason).or_default();
        *lost = lost.saturating_add(count);
    }

    /// Counts an event.
    pub(super) fn count(&self, change: impl FnOnce(&mut ReaderCounters)) {
        change(&mut self.0.lock().counters);
    }
}

impl Drop for SampleSender {
    fn drop(&mut self) {
        self.0.lock().is_closed = true;
        self.0.arrived.notify_one();
    }
}

impl SampleQueue {
    /// The next sample; none if the queue is empty and closed. Cancelling it loses nothing.
    pub(super) async fn next(&mut self) -> Option<IncomingSample> {
        loop {
            let arrived = self.0.arrived.notified();
            {
                let mut waiting = self.0.lock();
                if let Some(sample) = waiting.pop() {
                    return Some(sample);
                }
                if waiting.is_closed {
                    return None;
                }
            }
            arrived.await;
        }
    }

    /// The next sample if one waits.
    pub(super) fn try_next(&mut self) -> Option<IncomingSample> {
        self.0.lock().pop()
    }

    /// The events so far.
    pub(super) fn counters(&self) -> ReaderCounters {
        self.0.lock().counters
    }

    /// The samples that did not come through so far.
    pub(super) fn losses(&self) -> Losses {
        self.0.lock().losses.clone()
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn pop(&mut self) -> Option<IncomingSample> {
        let sample = self.samples.pop_front()?;
        self.bytes -= cost(&sample);
        Some(sample)
    }
}

fn cost(sample: &IncomingSample) -> usize {
    sample.payload.len().saturating_add(OVERHEAD_BYTES)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::guid::{Guid, SequenceNumber};

    fn sample(number: i64, payload: Bytes) -> IncomingSample {
        let (writer, sequence) = (Guid::default(), SequenceNumber(number));
        IncomingSample { writer, sequence, timestamp: None, related: None, payload }
    }

    fn small(number: i64) -> IncomingSample {
        sample(number, Bytes::from_static(b"data"))
    }

    #[tokio::test]
    async fn the_oldest_samples_make_room_and_are_counted() {
        let (sender, mut queue) = queue(QueueLimits { bytes: 100_000, samples: 2 });
        (1..=3).for_each(|number| sender.push(small(number)));
        assert_eq!(queue.next().await.unwrap().sequence, SequenceNumber(2));
        sender.push(sample(4, Bytes::from(vec![0; 99_000])));
        sender.push(sample(5, Bytes::from(vec![0; 200_000])));
        sender.lost(3, LossReason::BestEffort);
        assert_eq!(queue.try_next().unwrap().sequence, SequenceNumber(3));
        assert_eq!(queue.try_next().unwrap().sequence, SequenceNumber(4));
        assert_eq!(queue.try_next(), None);
        assert_eq!(queue.losses(), Losses { lost: [(LossReason::BestEffort, 3)].into(), dropped: 2 });
    }

    #[tokio::test]
    async fn the_bytes_of_samples_that_were_taken_are_free_again() {
        let (sender, mut queue) = queue(QueueLimits { bytes: 100_000, samples: 10 });
        for number in 1..=20 {
            sender.push(sample(number, Bytes::from(vec![0; 60_000])));
            assert_eq!(queue.next().await.unwrap().sequence, SequenceNumber(number));
        }
        assert_eq!(queue.losses().dropped, 0);
    }

    #[tokio::test]
    async fn a_queue_that_is_closed_gives_out_what_waits_and_then_ends() {
        let (sender, mut queue) = queue(QueueLimits { bytes: 1000, samples: 10 });
        sender.push(small(1));
        drop(sender);
        assert!(queue.next().await.is_some());
        assert!(queue.next().await.is_none());
    }

    #[tokio::test]
    async fn a_small_sample_does_not_keep_its_datagram_in_memory() {
        let (sender, mut queue) = queue(QueueLimits { bytes: 100_000, samples: 10 });
        let datagram = Bytes::from(vec![0; 60_000]);
        sender.push(sample(1, datagram.slice(10..20)));
        let waiting = queue.next().await.unwrap();
        assert!(datagram.is_unique() && waiting.payload.len() == 10);
    }
}
