//! The queue between a source of samples and whoever takes them.
//!
//! DDS and iceoryx2 count samples, not bytes. This queue weighs them: when it is full the oldest go
//! first, as in a ROS 2 history, because an old command is worth less than a new one.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime},
};

use tokio::sync::Notify;

use ledger_gate::sample::Sample;

/// The limits of a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest sample taken, in bytes with its header; larger ones are dropped and counted.
    pub sample_bytes_max: usize,
    /// Most bytes waiting to be taken; the oldest samples make room.
    pub queue_bytes_max: usize,
    /// Most samples waiting to be taken; the oldest make room.
    pub queue_samples_max: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { sample_bytes_max: 4 * 1024 * 1024, queue_bytes_max: 16 * 1024 * 1024, queue_samples_max: 10_000 }
    }
}

/// A sample that came in, and where from.
#[derive(Debug, Clone)]
pub struct Incoming {
    /// The message.
    pub sample: Sample,
    /// The publisher: the GUID of the DDS writer, or the origin in shared memory.
    pub source: [u8; 16],
    /// The source's own count of its samples.
    pub sequence: u64,
    /// When it was taken from the middleware.
    pub received: Instant,
    /// The wall clock at that moment: it goes on while the machine is suspended.
    pub wall: SystemTime,
    /// How long it had lain before that, as far as anybody knows.
    pub waited: Duration,
}

impl Incoming {
    /// A message that the bridge itself has made now.
    pub(crate) fn own(sample: Sample, sequence: u64) -> Self {
        let (received, wall) = (Instant::now(), SystemTime::now());
        Self { sample, source: [0; 16], sequence, received, wall, waited: Duration::ZERO }
    }

    /// How old it is, as far as anybody knows: by the clock that has gone further.
    pub(crate) fn age(&self, now: Instant, wall: SystemTime) -> Duration {
        let by_wall = wall.duration_since(self.wall).unwrap_or_default();
        self.waited.saturating_add(now.saturating_duration_since(self.received).max(by_wall))
    }
}

/// Bytes that every queued sample is taken to cost besides its own.
const OVERHEAD_BYTES: usize = 128;

/// The sending half, the receiving half and the counters, shared.
#[derive(Debug, Default)]
pub(crate) struct Queue {
    waiting: Mutex<Waiting>,
    arrived: Notify,
    bytes_max: usize,
    samples_max: usize,
    dropped: AtomicU64,
    closed: AtomicBool,
}

#[derive(Debug, Default)]
struct Waiting {
    samples: VecDeque<Incoming>,
    bytes: usize,
}

impl Queue {
    pub(crate) fn new(limits: &Limits) -> Arc<Self> {
        let (bytes_max, samples_max) = (limits.queue_bytes_max, limits.queue_samples_max.max(1));
        Arc::new(Self { bytes_max, samples_max, ..Self::default() })
    }

    /// Appends a sample; the oldest leave until it fits. One that never fits is dropped itself.
    pub(crate) fn push(&self, incoming: Incoming) {
        let bytes = weight(&incoming);
        if bytes > self.bytes_max {
            self.count_dropped(1);
            return;
        }
        let mut waiting = self.lock();
        while waiting.bytes + bytes > self.bytes_max || waiting.samples.len() >= self.samples_max {
            let Some(oldest) = waiting.samples.pop_front() else { break };
            waiting.bytes = waiting.bytes.saturating_sub(weight(&oldest));
            self.count_dropped(1);
        }
        waiting.bytes += bytes;
        waiting.samples.push_back(incoming);
        drop(waiting);
        self.arrived.notify_one();
    }

    /// Counts a sample that was lost before or in the queue.
    pub(crate) fn count_dropped(&self, count: u64) {
        self.dropped.fetch_add(count, Ordering::Relaxed);
    }

    /// Samples lost so far.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Nothing will come any more; samples that wait can still be taken.
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.arrived.notify_one();
    }

    pub(crate) fn try_next(&self) -> Option<Incoming> {
        let mut waiting = self.lock();
        let incoming = waiting.samples.pop_front()?;
        waiting.bytes = waiting.bytes.saturating_sub(weight(&incoming));
        Some(incoming)
    }

    /// The oldest sample, as soon as there is one; `None` when closed and empty. Cancelling it
    /// loses nothing. One taker only.
    pub(crate) async fn next(&self) -> Option<Incoming> {
        loop {
            let closed = self.closed.load(Ordering::Acquire);
            if let Some(incoming) = self.try_next() {
                return Some(incoming);
            }
            if closed {
                return None;
            }
            self.arrived.notified().await;
        }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn weight(incoming: &Incoming) -> usize {
    incoming.sample.wire().len().saturating_add(OVERHEAD_BYTES)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::CDR_LE;

    fn incoming(sequence: u64, bytes: usize) -> Incoming {
        Incoming {
            sample: Sample::new(CDR_LE, &vec![0; bytes]).unwrap(),
            source: [0; 16],
            sequence,
            received: Instant::now(),
            wall: SystemTime::now(),
            waited: Duration::ZERO,
        }
    }

    #[test]
    fn a_sample_grows_old_while_the_machine_is_suspended_and_no_younger_by_a_clock_that_is_set_back() {
        let (sample, second) = (incoming(1, 1), Duration::from_secs(1));
        let sample = Incoming { waited: second, ..sample };
        let (later, wall) = (sample.received + second, sample.wall);
        assert_eq!(sample.age(later, wall + second), 2 * second);
        assert_eq!(sample.age(later, wall + 60 * second), 61 * second, "it was suspended");
        assert_eq!(sample.age(later, wall - 60 * second), 2 * second, "its clock was set back");
    }

    fn queue_of(bytes_max: usize) -> Arc<Queue> {
        Queue::new(&Limits { queue_bytes_max: bytes_max, ..Limits::default() })
    }

    #[test]
    fn the_newest_samples_replace_the_oldest_when_nobody_takes_them() {
        let queue = Queue::new(&Limits { queue_samples_max: 2, ..Limits::default() });
        for sequence in 0..5 {
            queue.push(incoming(sequence, 10));
        }
        let left: Vec<u64> = std::iter::from_fn(|| queue.try_next()).map(|i| i.sequence).collect();
        assert_eq!(left, [3, 4]);
        assert_eq!(queue.dropped(), 3);
    }

    #[test]
    fn the_oldest_make_room_and_are_counted() {
        let queue = queue_of(3 * (OVERHEAD_BYTES + 104));
        for sequence in 0..5 {
            queue.push(incoming(sequence, 100));
        }
        let left: Vec<u64> = std::iter::from_fn(|| queue.try_next()).map(|i| i.sequence).collect();
        assert_eq!(left, [2, 3, 4]);
        assert_eq!(queue.dropped(), 2);
    }

    #[test]
    fn tiny_samples_cannot_fill_the_memory_either() {
        let queue = queue_of(10 * OVERHEAD_BYTES);
        for sequence in 0..1000 {
            queue.push(incoming(sequence, 0));
        }
        assert!(std::iter::from_fn(|| queue.try_next()).count() < 10);
    }

    #[test]
    fn a_sample_larger_than_the_queue_is_dropped_alone() {
        let queue = queue_of(1000);
        queue.push(incoming(1, 10));
        queue.push(incoming(2, 10_000));
        assert_eq!(queue.try_next().unwrap().sequence, 1);
        assert_eq!(queue.dropped(), 1);
    }

    #[tokio::test]
    async fn a_closed_queue_gives_what_it_has_and_then_ends() {
        let queue = queue_of(1000);
        queue.push(incoming(1, 10));
        queue.close();
        assert_eq!(queue.next().await.unwrap().sequence, 1);
        assert!(queue.next().await.is_none());
        assert!(queue.next().await.is_none());
    }
}
