//! A queue from many threads to one.
//!
//! The channels of the standard library wake their reader while they hold a lock that the reader takes next. Where more
//! threads want processors than there are, the reader often runs at once in place of the thread that woke it, and finds
//! the lock taken. Both wait until that thread has a processor again: milliseconds, under overload. Here nobody holds
//! anything while a thread is woken, and the reader takes everything that waits at once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{Thread, current, park, park_timeout};
use std::time::Duration;

/// The queue. One thread reads: the first that waits.
pub(super) struct Inbox<T> {
    content: Mutex<Content<T>>,
    /// The reader waits, or is about to.
    asleep: AtomicBool,
    reader: OnceLock<Thread>,
}

struct Content<T> {
    items: Vec<T>,
    closed: bool,
}

/// See [`Inbox::close_at_end`].
pub(super) struct CloseAtEnd<'a, T>(&'a Inbox<T>);

impl<T> Drop for CloseAtEnd<'_, T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

impl<T> Inbox<T> {
    pub(super) fn new() -> Self {
        let content = Mutex::new(Content { items: Vec::new(), closed: false });
        Self { content, asleep: AtomicBool::new(false), reader: OnceLock::new() }
    }

    /// Puts items in.
    pub(super) fn put(&self, items: impl IntoIterator<Item = T>) {
        self.content().items.extend(items);
        self.wake();
    }

    /// Puts an item in unless so many wait already. False if they do, or if the inbox is closed.
    pub(super) fn try_put(&self, item: T, waiting_max: usize) -> bool {
        {
            let mut content = self.content();
            if content.closed || content.items.len() >= waiting_max {
                return false;
            }
            content.items.push(item);
        }
        self.wake();
        true
    }

    /// Closes the inbox when the answer is dropped, however the thread that has it ends. The reader gets what is left,
    /// and nobody is told that more was taken in.
    pub(super) fn close_at_end(&self) -> CloseAtEnd<'_, T> {
        CloseAtEnd(self)
    }

    /// Takes nothing in any more, and wakes the reader.
    pub(super) fn close(&self) {
        self.content().closed = true;
        self.wake();
    }

    pub(super) fn is_closed(&self) -> bool {
        self.content().closed
    }

    pub(super) fn is_empty(&self) -> bool {
        self.content().items.is_empty()
    }

    /// Everything that waits, in order. Never blocks.
    pub(super) fn take(&self) -> Vec<T> {
        std::mem::take(&mut self.content().items)
    }

    /// Everything that waits, as soon as there is something; nothing once the inbox is closed and empty.
    pub(super) fn next(&self) -> Vec<T> {
        while !self.ready() {
            self.sleep(park);
        }
        self.take()
    }

    /// Returns when something waits or the time is over, sometimes before.
    pub(super) fn wait(&self, time: Duration) {
        if !time.is_zero() && !self.ready() {
            self.sleep(|| park_timeout(time));
        }
    }

    fn sleep(&self, park: impl FnOnce()) {
        self.reader.get_or_init(current);
        self.asleep.store(true, Ordering::SeqCst);
        // Whoever put something in before that did not see that somebody sleeps.
        if !self.ready() {
            park();
        }
        self.asleep.store(false, Ordering::Relaxed);
    }

    fn wake(&self) {
        if self.asleep.swap(false, Ordering::SeqCst)
            && let Some(reader) = self.reader.get()
        {
            reader.unpark();
        }
    }

    fn ready(&self) -> bool {
        let content = self.content();
        content.closed || !content.items.is_empty()
    }

    fn content(&self) -> MutexGuard<'_, Content<T>> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::thread::spawn;
    use std::time::Instant;

    /// Longer than any machine takes, shorter than anybody waits.
    const LONG: Duration = Duration::from_secs(600);

    #[test]
    fn everything_put_in_comes_out_once_and_in_each_senders_order() {
        const SENDERS: u32 = 4;
        const EACH: u32 = 20_000;
        let inbox = Arc::new(Inbox::new());
        let senders: Vec<_> = (0..SENDERS)
            .map(|sender| {
                let inbox = Arc::clone(&inbox);
                spawn(move || (0..EACH).for_each(|number| inbox.put([(sender, number)])))
            })
            .collect();
        let reader = spawn({
            let inbox = Arc::clone(&inbox);
            move || std::iter::from_fn(|| Some(inbox.next()).filter(|items| !items.is_empty())).flatten().collect()
        });
        senders.into_iter().for_each(|sender| sender.join().unwrap());
        drop(inbox.close_at_end());
        let received: Vec<(u32, u32)> = reader.join().unwrap();
        for sender in 0..SENDERS {
            let of_sender = received.iter().filter(|(from, _)| *from == sender).map(|(_, number)| *number);
            assert!(of_sender.eq(0..EACH), "sender {sender}");
        }
        assert_eq!(received.len(), (SENDERS * EACH) as usize);
    }

    #[test]
    fn a_reader_that_waits_is_woken_each_time() {
        let (there, back) = (Arc::new(Inbox::new()), Arc::new(Inbox::new()));
        let echo = spawn({
            let (there, back) = (Arc::clone(&there), Arc::clone(&back));
            move || {
                while let Some(number) = there.next().pop() {
                    back.put([number]);
                }
            }
        });
        let start = Instant::now();
        for number in 0..20_000 {
            there.put([number]);
            while back.is_empty() {
                back.wait(LONG);
            }
            assert_eq!(back.take(), [number]);
        }
        assert!(start.elapsed() < LONG, "a wake-up was lost");
        drop(there.close_at_end());
        echo.join().unwrap();
    }

    #[test]
    fn a_full_or_closed_inbox_takes_nothing_and_gives_what_it_has() {
        let inbox = Inbox::new();
        assert!(inbox.try_put(1, 2) && inbox.try_put(2, 2));
        assert!(!inbox.try_put(3, 2), "it is full");
        inbox.put([4]);
        assert_eq!(inbox.take(), [1, 2, 4]);
        assert!(inbox.try_put(5, 2), "there is space again");
        drop(inbox.close_at_end());
        assert!(!inbox.try_put(6, 2), "it is closed");
        assert_eq!(inbox.next(), [5]);
        assert!(inbox.next().is_empty());
    }

    #[test]
    fn waiting_ends_with_the_time() {
        let inbox = Inbox::<()>::new();
        inbox.wait(Duration::ZERO);
        inbox.wait(Duration::from_millis(1));
        assert!(inbox.is_empty());
    }
}
