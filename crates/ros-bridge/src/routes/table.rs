//! The table of the routes that a bridge is to have: those of its configuration, and those that it has discovered. Routes
//! come and go with it, and all others go on untouched.

mod keeper;
mod roster;
mod slot;

use std::{
    collections::BTreeSet,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use tokio::sync::{self, watch};

use self::keeper::RunningRoute;
pub(crate) use self::{
    keeper::{Keeper, is_to_come},
    roster::Roster,
    slot::{OpenRoute, Slot},
};
use super::kind::RouteConfig;

/// The table.
pub(crate) struct RouteTable {
    keeper: Arc<Keeper>,
    roster: Arc<Roster>,
    /// Told if a route ends that nobody stopped.
    ending: watch::Sender<bool>,
    entries: sync::Mutex<Entries>,
    is_closing: AtomicBool,
}

#[derive(Default)]
struct Entries {
    configured: Vec<RouteConfig>,
    discovered: Vec<RouteConfig>,
    /// The routes that run.
    kept: Vec<RunningRoute>,
}

/// Routes that came and went.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TableChange {
    pub(crate) ended: usize,
    pub(crate) started: usize,
}

impl RouteTable {
    pub(crate) fn new(keeper: Keeper, roster: Arc<Roster>, ending: watch::Sender<bool>) -> Self {
        Self {
            keeper: Arc::new(keeper),
            roster,
            ending,
            entries: sync::Mutex::default(),
            is_closing: AtomicBool::new(false),
        }
    }

    /// Starts the routes of the configuration. The starter of the bridge tells which they are.
    pub(crate) async fn begin(&self, routes: Vec<RouteConfig>) {
        let mut entries = self.entries.lock().await;
        entries.configured = routes;
        self.follow(&mut entries).await;
    }

    /// These are the routes of the configuration now.
    pub(crate) async fn configured(&self, routes: Vec<RouteConfig>) -> TableChange {
        let mut entries = self.entries.lock().await;
        entries.configured = routes;
        self.follow_and_tell(&mut entries).await
    }

    /// These are the routes that were discovered now.
    pub(crate) async fn discovered(&self, routes: Vec<RouteConfig>) -> TableChange {
        let mut entries = self.entries.lock().await;
        entries.discovered = routes;
        let changed = self.follow_and_tell(&mut entries).await;
        let (TableChange { ended, started }, routes) = (changed, entries.kept.len());
        if ended + started > 0 {
            tracing::info!(ended, started, routes, "discovered: {ended} routes ended, {started} started");
        }
        changed
    }

    async fn follow_and_tell(&self, entries: &mut Entries) -> TableChange {
        let changed = self.follow(entries).await;
        let new = entries.kept.len().saturating_sub(changed.started);
        entries.kept.iter().skip(new).filter_map(|kept| kept.slot.open()).for_each(|open| open.tell());
        changed
    }

    /// Ends the routes that are gone, and starts those that are new: they are the last ones then.
    async fn follow(&self, entries: &mut Entries) -> TableChange {
        let wanted = entries.wanted();
        let mut changed = TableChange::default();
        let texts: BTreeSet<String> = wanted.iter().map(RouteConfig::text).collect();
        let (stay, gone): (Vec<_>, Vec<_>) =
            std::mem::take(&mut entries.kept).into_iter().partition(|kept| texts.contains(&kept.slot.route.text()));
        let running: BTreeSet<String> = stay.iter().map(|kept| kept.slot.route.text()).collect();
        entries.kept = stay;
        for kept in gone {
            let (number, service) = (kept.slot.number, kept.slot.route.service.clone());
            kept.end().await;
            self.roster.remove(number);
            tracing::info!(service, "route {number} has ended: it is wanted no longer");
            changed.ended += 1;
        }
        for route in wanted.into_iter().filter(|route| !running.contains(&route.text())) {
            if self.is_closing.load(Ordering::Relaxed) {
                break;
            }
            entries.kept.push(self.keeper.start(route, &self.ending).await);
            changed.started += 1;
        }
        changed
    }

    /// No route is started any more.
    pub(crate) fn closes(&self) {
        self.is_closing.store(true, Ordering::Relaxed);
    }

    /// Ends all routes, all at once.
    pub(crate) async fn close(&self) {
        self.closes();
        let kept = std::mem::take(&mut self.entries.lock().await.kept);
        for kept in &kept {
            kept.task.signal();
        }
        for kept in kept {
            kept.end().await;
        }
    }

    /// The ledger gave a sign of life, to nobody's route.
    pub(crate) fn heard(&self, now: Instant) {
        self.roster.heard(now);
    }
}

impl Entries {
    /// The configuration counts before what was discovered: for each service in its direction, and for each topic.
    fn wanted(&self) -> Vec<RouteConfig> {
        let is_taken = |found: &RouteConfig| {
            self.configured.iter().any(|set| {
                let same_way = set.service == found.service && std::ptr::eq(set.kind, found.kind);
                same_way || (set.topic.is_some() && set.topic == found.topic)
            })
        };
        let discovered = self.discovered.iter().filter(|found| !is_taken(found));
        self.configured.iter().chain(discovered).cloned().collect()
    }
}
