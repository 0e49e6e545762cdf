//! Endpoints on the other end: counted, so that callers wait on a condition instead of a time.

use std::collections::BTreeSet;

use tokio::sync::watch;

use super::prefix;

/// The findings of discovery for one endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Matching {
    /// Endpoints of other participants that are matched now.
    pub matched: usize,
    /// Endpoints of this participant that are matched now. Samples between them are never given out. Without
    /// multicast a participant does not find itself, and this stays zero.
    pub own: usize,
    /// Endpoints that were refused so far because their quality of service does not fit.
    pub incompatible: u64,
}

/// Follows the matching of a reader or writer.
#[derive(Debug, Clone)]
pub struct Matched(watch::Receiver<Matching>);

impl Matched {
    /// The state now.
    pub fn now(&self) -> Matching {
        *self.0.borrow()
    }

    /// Waits until at least `count` endpoints of others are matched; `false` if the reader or writer was closed
    /// before. It waits as long as it takes: put a timeout around it.
    pub async fn at_least(&self, count: usize) -> bool {
        self.0.clone().wait_for(|matching| matching.matched >= count).await.is_ok()
    }

    /// Has DDS ended? Then nothing passes any more.
    pub fn is_ended(&self) -> bool {
        self.0.has_changed().is_err()
    }

    /// Waits until DDS ends, or the reader or writer is dropped.
    pub async fn ended(self) {
        let Self(mut state) = self;
        while state.changed().await.is_ok() {}
    }
}

/// The side that learns of changes.
pub(super) struct Matches {
    own_prefix: [u8; 12],
    endpoints: BTreeSet<[u8; 16]>,
    own: BTreeSet<[u8; 16]>,
    state: watch::Sender<Matching>,
}

impl Matches {
    pub(super) fn new(own_prefix: [u8; 12]) -> (Self, Matched) {
        let (state, receiver) = watch::channel(Matching::default());
        (Self { own_prefix, endpoints: BTreeSet::new(), own: BTreeSet::new(), state }, Matched(receiver))
    }

    /// An endpoint came (`change` above zero) or left.
    pub(super) fn changed(&mut self, guid: rustdds::GUID, change: i32) {
        let endpoints = if prefix(guid) == self.own_prefix { &mut self.own } else { &mut self.endpoints };
        if change > 0 {
            endpoints.insert(guid.to_bytes());
        } else {
            endpoints.remove(&guid.to_bytes());
        }
        self.state.send_modify(|state| {
            state.matched = self.endpoints.len();
            state.own = self.own.len();
        });
    }

    pub(super) fn refused(&mut self) {
        self.state.send_modify(|state| state.incompatible = state.incompatible.saturating_add(1));
    }

    pub(super) fn endpoints(&self) -> &BTreeSet<[u8; 16]> {
        &self.endpoints
    }
}
