//! A bridge as those see it who watch it: does it run, and how do its routes do?
//!
//! It is there before the bridge is, and stays while the bridge waits or begins anew.

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ledger_base::rejection::Rejection;

use crate::{
    bridge::Bridge,
    count::{RouteSummary, Spread},
    report::{Status, Statuses},
    roster::{Roster, Slot},
};

/// The place where a bridge can be looked at. Clones look at the same one.
#[derive(Clone, Default)]
pub struct Sight(Arc<Mutex<Seen>>);

/// The bridge of a moment.
enum Seen {
    /// None runs, for this reason; at first for none.
    Waits(Option<Rejection>),
    Runs(Running),
}

/// The parts of a bridge that can be looked at.
struct Running {
    identity: String,
    domain: u16,
    roster: Arc<Roster>,
    statuses: Statuses,
}

/// The bridge as it was seen.
#[derive(Clone, Debug)]
pub enum View {
    /// No bridge runs, for this reason; none has begun yet if there is none.
    Waits(Option<Rejection>),
    /// The bridge has joined its graph.
    Runs(Standing),
}

/// How a bridge that runs does.
#[derive(Clone, Debug)]
pub struct Standing {
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

impl Sight {
    /// From now on it is this bridge.
    pub fn runs(&self, bridge: &Bridge) {
        *self.lock() = Seen::Runs(Running {
            identity: bridge.identity().to_owned(),
            domain: bridge.domain(),
            roster: Arc::clone(bridge.roster()),
            statuses: bridge.statuses().clone(),
        });
    }

    /// No bridge runs any more, or yet, for this reason.
    pub fn waits(&self, reason: &Rejection) {
        *self.lock() = Seen::Waits(Some(reason.clone()));
    }

    /// Looks at it.
    pub fn look(&self) -> View {
        match &*self.lock() {
            Seen::Waits(reason) => View::Waits(reason.clone()),
            Seen::Runs(running) => View::Runs(running.standing()),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Seen> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for Seen {
    fn default() -> Self {
        Self::Waits(None)
    }
}

impl Running {
    fn standing(&self) -> Standing {
        Standing {
            identity: self.identity.clone(),
            domain: self.domain,
            silent: self.roster.last_heard().map(|heard| heard.elapsed()),
            statuses: self.statuses.now(),
            routes: self.roster.slots().iter().map(|slot| RouteView::of(slot)).collect(),
        }
    }
}

impl RouteView {
    fn of(slot: &Slot) -> Self {
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

impl fmt::Debug for Sight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Sight").field(&self.look()).finish()
    }
}
