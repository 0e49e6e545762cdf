//! Endpoints on the other end: counted, so that callers wait on a condition instead of a time.

use std::{collections::BTreeSet, time::Duration};

use tokio::sync::watch;

use super::guid::prefix;

/// How often a reader or writer looks whether DDS is still there.
pub(super) const ALIVE_EVERY: Duration = Duration::from_secs(1);

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
pub struct Matched(watch::Receiver<State>);

#[derive(Debug, Default)]
struct State {
    matching: Matching,
    /// The endpoints of others.
    endpoints: BTreeSet<[u8; 16]>,
    /// The endpoints of this participant.
    own: BTreeSet<[u8; 16]>,
}

impl Matched {
    /// The state now.
    pub fn now(&self) -> Matching {
        self.0.borrow().matching
    }

    /// Is this endpoint of another participant matched now?
    pub(super) fn has(&self, guid: &[u8; 16]) -> bool {
        self.0.borrow().endpoints.contains(guid)
    }

    /// The endpoints of one other participant that are matched now.
    pub(super) fn of_participant(&self, prefix: &[u8]) -> usize {
        self.0.borrow().endpoints.iter().filter(|guid| guid.starts_with(prefix)).count()
    }

    /// Waits for a change.
    ///
    /// # Errors
    /// If the reader or writer was closed.
    pub(super) async fn changed(&mut self) -> Result<(), watch::error::RecvError> {
        self.0.changed().await
    }

    /// Waits until at least `count` endpoints of others are matched; `false` if the reader or writer was closed
    /// before. It waits as long as it takes: put a timeout around it.
    pub async fn at_least(&self, count: usize) -> bool {
        self.0.clone().wait_for(|state| state.matching.matched >= count).await.is_ok()
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
    state: watch::Sender<State>,
}

impl Matches {
    pub(super) fn new(own_prefix: [u8; 12]) -> (Self, Matched) {
        let (state, receiver) = watch::channel(State::default());
        (Self { own_prefix, state }, Matched(receiver))
    }

    /// An endpoint came (`change` above zero) or left.
    pub(super) fn changed(&mut self, guid: rustdds::GUID, change: i32) {
        let is_own = prefix(guid) == self.own_prefix;
        self.state.send_modify(|State { matching, endpoints, own }| {
            let side = if is_own { &mut *own } else { &mut *endpoints };
            if change > 0 {
                side.insert(guid.to_bytes());
            } else {
                side.remove(&guid.to_bytes());
            }
            (matching.matched, matching.own) = (endpoints.len(), own.len());
        });
    }

    pub(super) fn refused(&mut self) {
        self.state.send_modify(|state| state.matching.incompatible = state.matching.incompatible.saturating_add(1));
    }

    /// Calls with the endpoints of others that are matched now.
    pub(super) fn with_endpoints<T>(&self, look: impl FnOnce(&BTreeSet<[u8; 16]>) -> T) -> T {
        look(&self.state.borrow().endpoints)
    }
}
