//! The bridge as the program that runs it sees it: whether it runs, and how its routes do.
//!
//! It exists before the bridge does, and stays while the bridge waits or starts again.

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ledger_base::rejection::Rejection;

use super::{diagnostics::Status, reporter::Statuses};
use crate::routes::{
    counters::{RouteSummary, Spread},
    table::{Roster, Slot},
};

/// The place where a bridge can be looked at. Clones look at the same one.
#[derive(Clone, Default)]
pub struct BridgeMonitor(Arc<Mutex<State>>);

/// The bridge of a moment.
enum State {
    /// None runs, for this reason; at first for none.
    Waits(Option<Rejection>),
    Runs(Running),
}

/// The parts of a bridge that can be looked at.
pub(crate) struct Running {
    pub(crate) identity: String,
    pub(crate) domain: u16,
    pub(crate) roster: Arc<Roster>,
    pub(crate) statuses: Statuses,
}

/// The bridge as it was seen.
#[derive(Clone, Debug)]
pub enum BridgeView {
    /// No bridge runs, for this reason; none has begun yet if there is none.
    Waits(Option<Rejection>),
    /// The bridge has joined its graph.
    Runs(BridgeStatus),
}

/// How a bridge that runs does.
#[derive(Clone, Debug)]
pub struct BridgeStatus {
    /// Its identity towards the ledger, `Org2/Rover`.
    pub identity: String,
    /// The ROS domain that it has joined.
    pub domain: u16,
    /// The time since the ledger gave a sign of life; none if it never did.
    pub silent: Option<Duration>,
    /// The ledger and each route in words, a second old at most: as on `/diagnostics`.
    pub statuses: Vec<Status>,
    /// Its routes.
    pub routes: Vec<RouteView>,
}

/// How a route does, in figures.
#[derive(Clone, Debug)]
pub struct RouteView {
    /// Its counters.
    pub summary: RouteSummary,
    /// Is it open?
    pub is_open: bool,
    /// Does it take something from the local graph to the service?
    pub takes_in: bool,
    /// Does publishing need a grant?
    pub needs_grant: bool,
    /// Does somebody hold the service? Where something is taken in: the bridge's own identity.
    pub is_held: bool,
    /// Publishers of others on the topic to which the route delivers commands.
    pub beside: usize,
    /// From a sample taken in to its verdict.
    pub commit: Spread,
    /// From the signature of a message to its way to the local graph.
    pub age: Spread,
}

impl BridgeMonitor {
    /// From now on it is this bridge.
    pub(crate) fn runs(&self, bridge: Running) {
        *self.lock() = State::Runs(bridge);
    }

    /// No bridge runs any more, or yet, for this reason.
    pub fn waits(&self, reason: &Rejection) {
        *self.lock() = State::Waits(Some(reason.clone()));
    }

    /// Looks at it.
    pub fn look(&self) -> BridgeView {
        match &*self.lock() {
            State::Waits(reason) => BridgeView::Waits(reason.clone()),
            State::Runs(running) => BridgeView::Runs(running.status()),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for State {
    fn default() -> Self {
        Self::Waits(None)
    }
}

impl Running {
    fn status(&self) -> BridgeStatus {
        BridgeStatus {
            identity: self.identity.clone(),
            domain: self.domain,
            silent: self.roster.last_heard().map(|heard| heard.elapsed()),
            statuses: self.statuses.now(),
            routes: self.roster.slots().iter().map(RouteView::of).collect(),
        }
    }
}

impl RouteView {
    fn of(slot: &Arc<Slot>) -> Self {
        let (summary, is_open) = (slot.summary(), slot.open().is_some());
        let counts = slot.counters.lock();
        let live = &counts.live;
        Self {
            summary,
            is_open,
            takes_in: slot.route.kind.takes_in(),
            needs_grant: live.needs_grant,
            is_held: live.held,
            beside: live.beside,
            commit: counts.commit.clone(),
            age: counts.age.clone(),
        }
    }
}

impl fmt::Debug for BridgeMonitor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("BridgeMonitor").field(&self.look()).finish()
    }
}
