//! Keeps the processors awake while a transaction is in flight.
//!
//! A command at 50 Hz meets a machine that has gone to sleep since the last one. Each wait on its way, for the disk and
//! for the next thread, ends with a processor that must wake up first. That takes longer than all the work (see
//! docs/benchmarks.md). So with the profile `low-latency` threads of the class `SCHED_IDLE` (sched(7)) spin, from the
//! moment a transaction is admitted until its block is executed. The kernel runs them only where nothing else wants to
//! run, and puts them aside at once when something does. While nothing is in flight they are parked and cost nothing.
//! Before admission nothing spins: a flood of refused requests must not cost power.
//!
//! They pause often, for some microseconds. A processor takes over work that waits behind another one when it becomes
//! idle, which one that spins never does. Without the pauses a ready thread could wait for the next tick of the
//! scheduler, 4 ms.

use crate::config::Profile;
use rustix::thread::set_current_timer_slack;
use std::hint::spin_loop;
use std::io;
use std::num::NonZeroU64;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{JoinHandle, available_parallelism, park, sleep};
use std::time::{Duration, Instant};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};

/// Processors that are kept awake at most: about as many threads work on one transaction at a time.
const THREADS_MAX: usize = 2;
/// How long they stay awake for one transaction at most.
const LIMIT: Duration = Duration::from_millis(2);
/// How long they stay awake after the last verdict: for the client that reads it and the bridge that publishes.
const LINGER: Duration = Duration::from_micros(300);
/// How long a processor spins until it shows that it is idle.
const SPIN: Duration = Duration::from_micros(100);
/// How long it shows it. The time is long enough that the kernel lets it take over work: it looks for none if a
/// processor is usually idle for less than tens of microseconds. It is too short to fall asleep in earnest.
const PAUSE: Duration = Duration::from_micros(20);
/// Spins between two looks at the clock.
const SPINS_PER_LOOK: u32 = 32;

/// The threads. They end with it.
pub(crate) struct Awake {
    until: Arc<Until>,
    threads: Vec<JoinHandle<()>>,
}

struct Until {
    base: Instant,
    /// Nanoseconds after `base`.
    moment: AtomicU64,
    stop: AtomicBool,
}

impl Awake {
    /// Starts the threads that the profile wants: with [`Profile::Balanced`] there are none.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(profile: Profile) -> io::Result<Self> {
        let until = Arc::new(Until { base: Instant::now(), moment: AtomicU64::new(0), stop: AtomicBool::new(false) });
        let count = match profile {
            Profile::Balanced => 0,
            Profile::LowLatency => available_parallelism().map_or(1, usize::from).min(THREADS_MAX),
        };
        let thread = |_| {
            let until = Arc::clone(&until);
            std::thread::Builder::new().name("awake".into()).spawn(move || until.run())
        };
        let threads = (0..count).map(thread).collect::<io::Result<_>>()?;
        Ok(Self { until, threads })
    }

    /// A transaction is in flight.
    pub(crate) fn keep(&self) {
        if self.threads.is_empty() {
            return;
        }
        let now = self.until.now();
        if self.until.moment.swap(now + nanoseconds(LIMIT), Ordering::Relaxed) <= now {
            self.threads.iter().for_each(|thread| thread.thread().unpark());
        }
    }

    /// Nothing is in flight any more.
    pub(crate) fn rest(&self) {
        if self.threads.is_empty() {
            return;
        }
        let soon = self.until.now() + nanoseconds(LINGER);
        self.until.moment.fetch_min(soon, Ordering::Relaxed);
    }
}

impl Drop for Awake {
    fn drop(&mut self) {
        self.until.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            let _ended = thread.join();
        }
    }
}

impl Until {
    fn now(&self) -> u64 {
        nanoseconds(self.base.elapsed())
    }

    fn run(&self) {
        let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
        if let Err(error) = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle) {
            // Without it they would be in the way of those that they are to help.
            tracing::info!(%error, "processors may sleep: no thread may have the class SCHED_IDLE here");
            return;
        }
        // Else each pause takes as much longer as the kernel may wait for other timers, 50 us.
        let _longer_pauses = set_current_timer_slack(NonZeroU64::new(1));
        while !self.stop.load(Ordering::Relaxed) {
            while self.now() < self.moment.load(Ordering::Relaxed) {
                self.spin();
                sleep(PAUSE);
            }
            park();
        }
    }

    fn spin(&self) {
        let pause = self.now() + nanoseconds(SPIN);
        while self.now() < self.moment.load(Ordering::Relaxed).min(pause) {
            (0..SPINS_PER_LOOK).for_each(|_| spin_loop());
        }
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn moment(awake: &Awake) -> u64 {
        awake.until.moment.load(Ordering::Relaxed)
    }

    #[test]
    fn processors_stay_awake_until_the_verdict_and_for_no_longer_than_the_limit() {
        let awake = Awake::start(Profile::LowLatency).unwrap();
        assert_eq!(moment(&awake), 0, "nothing is in flight");
        let before = awake.until.now();
        awake.keep();
        let (kept, after) = (moment(&awake), awake.until.now());
        assert!((before..=after).contains(&(kept - nanoseconds(LIMIT))), "{before} {kept} {after}");
        awake.rest();
        assert!(moment(&awake) <= awake.until.now() + nanoseconds(LINGER));
        // The threads end with it, whatever they were told last.
        awake.keep();
    }

    #[test]
    fn the_balanced_profile_starts_no_thread() {
        let awake = Awake::start(Profile::Balanced).unwrap();
        assert!(awake.threads.is_empty());
        awake.keep();
        assert_eq!(moment(&awake), 0);
    }
}
