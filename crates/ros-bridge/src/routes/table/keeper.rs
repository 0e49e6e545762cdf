//! Keeps the routes of a bridge open, each by itself: one that cannot be opened waits and tries again, and the others
//! carry messages meanwhile.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    sync::Arc,
    time::Duration,
};

use futures::future::BoxFuture;
use ledger_api::Context;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_light::Governance;
use tokio::sync::{Mutex, watch};

use super::{
    roster::Roster,
    slot::{Opened, Slot},
};
use crate::{
    graph::{local::LocalGraph, mark::Mark},
    ledger::{gateway::Gateway, robot_state::RobotStateQuery, service::ask_service},
    log::one_line,
    routes::{
        kind::{Opening, RouteConfig, RouteTask},
        terms::topic_for,
    },
    shutdown::{BackgroundTask, Shutdown, requested},
};

/// Pause before a route that could not be opened is tried again.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Everything that routes are opened with.
pub(crate) struct Keeper {
    gateway: Arc<dyn Gateway>,
    context: Context,
    local: LocalGraph,
    /// The beginning of the way to those who govern now; none = the genesis.
    known: Option<Governance>,
    roster: Arc<Roster>,
    queries: Mutex<BTreeMap<String, Arc<RobotStateQuery>>>,
}

/// A route that is kept open. When its task is told to end, what the route has set in motion is stopped.
pub(crate) struct RunningRoute {
    pub(crate) slot: Arc<Slot>,
    pub(crate) task: BackgroundTask,
}

impl RunningRoute {
    /// Ends the route.
    pub(crate) async fn end(self) {
        if let Err(error) = self.task.join().await {
            tracing::error!(%error, service = self.slot.route.service, "a route ended too early");
        }
    }
}

/// Runs until it is told to end, or the middleware ends.
type Running = BoxFuture<'static, ()>;

impl Keeper {
    pub(crate) fn new(
        gateway: Arc<dyn Gateway>,
        context: &Context,
        local: LocalGraph,
        known: Option<Governance>,
        roster: Arc<Roster>,
    ) -> Self {
        Self { gateway, context: context.clone(), local, known, roster, queries: Mutex::default() }
    }

    /// Tries to open a route, and keeps it open from then on. `ending` is told if it ends and nobody stopped it.
    pub(crate) async fn start(self: &Arc<Self>, route: RouteConfig, ending: &watch::Sender<bool>) -> RunningRoute {
        let mark = Mark::new(&self.context.network, &route.service);
        let slot = self.roster.add(route, mark);
        let (stop, shutdown) = watch::channel(false);
        let first = self.open(&slot, &shutdown).await;
        let (keeper, kept, ending) = (Arc::clone(self), Arc::clone(&slot), ending.clone());
        let task = BackgroundTask::with(stop, "a route ended too early", async move {
            keeper.keep(&kept, first, shutdown.clone()).await;
            if !*shutdown.borrow() {
                ending.send_replace(true);
            }
        });
        RunningRoute { slot, task }
    }

    /// Opens a route, or says and remembers why it waits.
    async fn open(&self, slot: &Slot, shutdown: &Shutdown) -> Option<Running> {
        match self.try_open(slot, shutdown).await {
            Ok(running) => Some(running),
            Err(refused) => {
                if self.roster.closed(slot, &refused) {
                    let (service, direction, number) = (&slot.route.service, slot.route.kind.name, slot.number);
                    let (code, reason) = (refused.code.name(), one_line(&refused));
                    let message = &refused.message;
                    tracing::warn!(
                        service,
                        direction,
                        code,
                        reason,
                        "route {number} waits, and the others go on: {message}"
                    );
                }
                None
            }
        }
    }

    async fn try_open(&self, slot: &Slot, shutdown: &Shutdown) -> Result<Running, Rejection> {
        let (service, _) = ask_service(&*self.gateway, 0, &slot.route.service).await?;
        let topic = topic_for(&service, &slot.route)?;
        self.roster.no_circle(slot, &topic)?;
        let query = self.query(&service.robot).await?;
        let is_command = service.is_command();
        let opening = Opening {
            route: &slot.route,
            gateway: Arc::clone(&self.gateway),
            context: &self.context,
            local: &self.local,
            service,
            topic: &topic,
            mark: slot.mark,
            query,
            counters: slot.counters.clone(),
            qos: slot.qos.subscribe(),
            shutdown: shutdown.clone(),
        };
        let RouteTask { in_memory, running } = slot.route.plan.open(opening).await?;
        self.roster.opened(slot, Opened { topic, is_command, in_memory });
        Ok(running)
    }

    /// Routes of one robot share their questions.
    async fn query(&self, robot: &str) -> Result<Arc<RobotStateQuery>, Rejection> {
        let mut queries = self.queries.lock().await;
        Ok(match queries.entry(robot.to_owned()) {
            Entry::Occupied(known) => Arc::clone(known.get()),
            Entry::Vacant(place) => {
                let query = RobotStateQuery::new(Arc::clone(&self.gateway), robot, self.known.as_ref())?;
                Arc::clone(place.insert(Arc::new(query)))
            }
        })
    }

    /// Runs a route until it is told to end, or the middleware ends. `first` is the outcome of the first try.
    async fn keep(&self, slot: &Arc<Slot>, first: Option<Running>, mut shutdown: Shutdown) {
        let mut running = first;
        loop {
            if let Some(running) = running {
                return running.await;
            }
            tokio::select! {
                () = requested(&mut shutdown) => return,
                () = tokio::time::sleep(RETRY_PAUSE) => {}
            }
            running = self.open(slot, &shutdown).await;
            if let Some(open) = slot.open().filter(|_| running.is_some()) {
                let arrow = slot.route.kind.arrow(open.topic(), &slot.route.service);
                tracing::info!(service = slot.route.service, "route {} is open now: {arrow}", slot.number);
            }
        }
    }
}

/// May that which is missing still come, without anybody changing the bridge?
pub(crate) fn is_to_come(refused: &Rejection) -> bool {
    refused.code.class() == Class::Unreachable || matches!(refused.code, Code::UnknownRobot | Code::UnknownService)
}
