//! The clocks, and a timer of the kernel that wakes the task of a domain.
//!
//! The timer is a `timerfd` because bursts of large samples are 0.1 ms apart, and the timers of tokio count whole milliseconds.

use crate::time::Now;
use rustix::time::{ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec};
use rustix::time::{clock_gettime, timerfd_create, timerfd_settime};
use std::io;
use std::os::fd::OwnedFd;
use std::task::{Context, Poll};
use tokio::io::unix::AsyncFd;

const MICROS: u64 = 1_000_000;

/// The clocks at this moment. The steady one is `CLOCK_MONOTONIC`: it goes on while the process is stopped.
pub(super) fn now() -> Now {
    Now { steady: micros(clock_gettime(ClockId::Monotonic)), wall: micros(clock_gettime(ClockId::Realtime)) }
}

fn micros(time: Timespec) -> u64 {
    let [seconds, nanos] = [time.tv_sec, time.tv_nsec].map(|part| u64::try_from(part).unwrap_or(0));
    seconds.saturating_mul(MICROS).saturating_add(nanos / 1000)
}

fn timespec(micros: u64) -> Timespec {
    let part = |part| i64::try_from(part).unwrap_or(i64::MAX);
    Timespec { tv_sec: part(micros / MICROS), tv_nsec: part(micros % MICROS * 1000) }
}

/// Wakes one task at a moment of the steady clock. Any thread may set it.
#[derive(Debug)]
pub(super) struct Timer(AsyncFd<OwnedFd>);

impl Timer {
    /// A timer that is not set. Only within a runtime of tokio.
    pub(super) fn new() -> io::Result<Self> {
        let flags = TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC;
        let timer = timerfd_create(TimerfdClockId::Monotonic, flags)?;
        #[expect(
            deprecated,
            reason = "an `OwnedFd` keeps its descriptor, which is all that the unsafe successor demands"
        )]
        let registered = AsyncFd::new(timer);
        Ok(Self(registered?))
    }

    /// Fires at this moment instead of the one before; at once if it has passed.
    pub(super) fn set(&self, steady: u64) {
        // A moment of zero would stop the timer.
        let it_value = timespec(steady.max(1));
        let once = Itimerspec { it_interval: timespec(0), it_value };
        if let Err(error) = timerfd_settime(self.0.get_ref(), TimerfdTimerFlags::ABSTIME, &once) {
            tracing::error!(%error, "cannot set the timer of a DDS domain");
        }
    }

    /// Ready once after each time that it fired.
    pub(super) fn poll_fired(&self, context: &mut Context<'_>) -> Poll<()> {
        loop {
            let Poll::Ready(Ok(mut guard)) = self.0.poll_read_ready(context) else { return Poll::Pending };
            let read = guard.try_io(|timer| Ok(rustix::io::read(timer.get_ref(), &mut [0; 8])?));
            if let Ok(Ok(_)) = read {
                return Poll::Ready(());
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::future::poll_fn;
    use std::task::Waker;

    #[tokio::test]
    async fn a_timer_fires_once_at_its_moment_and_at_once_if_that_has_passed() {
        let timer = Timer::new().unwrap();
        let moment = now().steady + 300;
        timer.set(moment);
        poll_fn(|context| timer.poll_fired(context)).await;
        assert!(now().steady >= moment);
        assert_eq!(timer.poll_fired(&mut Context::from_waker(Waker::noop())), Poll::Pending);
        timer.set(0);
        poll_fn(|context| timer.poll_fired(context)).await;
    }

    #[test]
    fn microseconds_become_the_same_time() {
        for moment in [0, 999_999, 1_000_000, 1_764_400_000_123_456] {
            assert_eq!(micros(timespec(moment)), moment);
        }
        assert!(timespec(u64::MAX).tv_sec > 0);
    }
}
