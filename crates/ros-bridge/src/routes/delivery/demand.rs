//! A discovered feed is read only while somebody listens to it: a user's bridge may offer those of a whole fleet.

use std::time::{Duration, Instant};

use tokio::time::sleep_until;

use crate::routes::ends::Outlet;

/// How soon it is noticed that nobody listens any more.
const LEFT_AFTER: Duration = Duration::from_secs(1);
/// How soon a listener in shared memory is noticed; one over DDS is noticed at once.
const CAME_WITHIN: Duration = Duration::from_millis(250);

/// The listeners of a route.
pub(super) struct Demand {
    /// Does it matter whether somebody listens?
    matters: bool,
    is_there: bool,
    looked: Instant,
}

impl Demand {
    pub(super) fn new(matters: bool) -> Self {
        Self { matters, is_there: !matters, looked: Instant::now() }
    }

    /// Are messages wanted?
    pub(super) fn is_there(&self) -> bool {
        self.is_there
    }

    /// Waits until it is time to look.
    pub(super) fn due(&self, outlet: &Outlet) -> impl Future<Output = ()> + use<> {
        let (matters, is_there, looked) = (self.matters, self.is_there, self.looked);
        let (matched, uses_memory) = (outlet.matched().clone(), outlet.in_memory().is_some());
        async move {
            match (matters, is_there) {
                (false, _) => std::future::pending().await,
                (true, true) => sleep_until((looked + LEFT_AFTER).into()).await,
                (true, false) => tokio::select! {
                    true = matched.at_least(1) => {}
                    () = sleep_until((looked + CAME_WITHIN).into()), if uses_memory => {}
                    // DDS has ended: the route notices it by itself.
                    else => std::future::pending().await,
                },
            }
        }
    }

    /// Looks who listens. True if that changes something.
    pub(super) fn look(&mut self, outlet: &Outlet) -> bool {
        self.looked = Instant::now();
        let before = std::mem::replace(&mut self.is_there, !self.matters || outlet.listeners() > 0);
        before != self.is_there
    }
}
