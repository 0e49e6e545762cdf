//! Wakes a thread that waits for work.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// One thread waits for it.
#[derive(Default)]
pub(crate) struct Bell {
    call: Mutex<Call>,
    changed: Condvar,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Call {
    #[default]
    None,
    /// There is work.
    Work,
    /// The thread is to end.
    End,
}

impl Bell {
    /// There is work. Nobody holds anything while the thread is woken.
    pub(crate) fn ring(&self) {
        let mut call = self.lock();
        let new = *call == Call::None;
        if new {
            *call = Call::Work;
        }
        drop(call);
        if new {
            self.changed.notify_one();
        }
    }

    /// The thread is to end.
    pub(super) fn end(&self) {
        *self.lock() = Call::End;
        self.changed.notify_one();
    }

    /// Waits for work, for `least` at least and `most` at most. False if the thread is to end.
    pub(super) fn wait(&self, least: Duration, most: Duration) -> bool {
        let start = Instant::now();
        let mut call = self.lock();
        loop {
            let time = match *call {
                Call::End => return false,
                Call::Work => least,
                Call::None => most,
            };
            let left = time.saturating_sub(start.elapsed());
            if left.is_zero() {
                *call = Call::None;
                return true;
            }
            call = self.changed.wait_timeout(call, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn lock(&self) -> MutexGuard<'_, Call> {
        self.call.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Longer than anybody waits.
    const LONG: Duration = Duration::from_secs(3600);

    #[test]
    fn a_thread_that_waits_is_woken_by_each_ring_and_ends_when_it_is_told() {
        let bell = Arc::new(Bell::default());
        let (worked, done) = std::sync::mpsc::channel();
        let own = Arc::clone(&bell);
        let thread = std::thread::spawn(move || {
            while own.wait(Duration::ZERO, LONG) {
                worked.send(()).unwrap();
            }
        });
        for _ in 0..1000 {
            bell.ring();
            done.recv().unwrap();
        }
        bell.end();
        thread.join().unwrap();
        assert!(done.try_recv().is_err(), "one round for each ring");
    }

    #[test]
    fn what_rang_before_anybody_waited_is_not_lost() {
        let bell = Bell::default();
        bell.ring();
        bell.ring();
        assert!(bell.wait(Duration::ZERO, LONG));
        assert_eq!(*bell.lock(), Call::None);
        bell.end();
        bell.ring();
        assert!(!bell.wait(LONG, LONG), "the end goes before work");
    }

    #[test]
    fn without_a_ring_the_longest_time_counts() {
        assert!(Bell::default().wait(Duration::ZERO, Duration::ZERO));
    }
}
