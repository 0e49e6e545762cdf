//! Requests that wait for the reader of their replies. DDS finds the two ends of a client one after the other, and a reply that
//! is written before its reader is found is never delivered.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// Most requests or replies that wait to be taken; more are dropped.
pub(super) const WAITING_MAX: usize = 64;
/// Longest wait. Then the request is served, whether or not somebody hears the reply.
const WAIT_MAX: Duration = Duration::from_secs(1);

/// The requests that wait, in the order in which they came.
pub(super) struct WaitingRequests<T>(VecDeque<(Instant, T)>);

impl<T> WaitingRequests<T> {
    pub(super) fn new() -> Self {
        Self(VecDeque::new())
    }

    /// Takes a request in. If too many wait, the oldest waits no longer: it is given back.
    pub(super) fn push(&mut self, request: T, now: Instant) -> Option<T> {
        let oldest = if self.0.len() < WAITING_MAX { None } else { self.0.pop_front() };
        self.0.push_back((now, request));
        oldest.map(|(_, oldest)| oldest)
    }

    /// Takes out those that wait no longer: a reply to them would be heard, or they have waited long enough.
    pub(super) fn release(&mut self, now: Instant, is_heard: impl Fn(&T) -> bool) -> Vec<T> {
        let (go, stay) = std::mem::take(&mut self.0)
            .into_iter()
            .partition(|(since, request)| now.duration_since(*since) >= WAIT_MAX || is_heard(request));
        let go: VecDeque<(Instant, T)> = go;
        self.0 = stay;
        go.into_iter().map(|(_, request)| request).collect()
    }

    /// The moment at which the first one has waited long enough; none if nothing waits.
    pub(super) fn until(&self) -> Option<Instant> {
        self.0.front().and_then(|(since, _)| since.checked_add(WAIT_MAX))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_request_waits_until_its_reply_is_heard() {
        let (mut held, start) = (WaitingRequests::new(), Instant::now());
        for request in [1, 2, 3] {
            assert_eq!(held.push(request, start), None);
        }
        assert_eq!(held.release(start, |request| *request == 2), [2]);
        assert_eq!(held.release(start, |_| false), [0; 0]);
        assert_eq!(held.release(start, |_| true), [1, 3]);
        assert_eq!(held.until(), None);
    }

    #[test]
    fn a_request_waits_at_most_a_second() {
        let (mut held, start) = (WaitingRequests::new(), Instant::now());
        held.push(1, start);
        let end = held.until().unwrap();
        assert_eq!(end, start + WAIT_MAX);
        assert_eq!(held.release(end - Duration::from_millis(1), |_| false), [0; 0]);
        assert_eq!(held.release(end, |_| false), [1]);
    }

    #[test]
    fn if_too_many_wait_the_oldest_waits_no_longer() {
        let (mut held, start) = (WaitingRequests::new(), Instant::now());
        for request in 0..WAITING_MAX {
            assert_eq!(held.push(request, start), None);
        }
        assert_eq!(held.push(WAITING_MAX, start), Some(0));
        assert_eq!(held.release(start, |_| true).len(), WAITING_MAX);
    }
}
