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
use tokio::{
    sync::{Mutex, watch},
    task::JoinHandle,
};

use crate::{
    config::RouteConfig,
    count::line,
    gateway::Gateway,
    mark::Mark,
    roster::{Roster, Slot, Watched},
    route::{
        Stop,
        kind::{Opened, Opening},
        local::Local,
        stopped,
    },
    service::{ask_service, topic_for},
    standing::Asker,
};

/// Pause before a route that could not be opened is tried again.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Everything that routes are opened with.
pub(crate) struct Keeper {
    gateway: Arc<dyn Gateway>,
    context: Context,
    local: Local,
    /// The beginning of the way to those who govern now; none = the genesis.
    known: Option<Governance>,
    roster: Arc<Roster>,
    askers: Mutex<BTreeMap<String, Arc<Asker>>>,
}

/// A route that is kept open.
pub(crate) struct Kept {
    pub(crate) slot: Arc<Slot>,
    pub(crate) stop: watch::Sender<bool>,
    pub(crate) task: JoinHandle<()>,
}

impl Kept {
    /// Ends the route: what it has set in motion is stopped.
    pub(crate) async fn end(self) {
        self.stop.send_replace(true);
        if let Err(error) = self.task.await {
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
        local: Local,
        known: Option<Governance>,
        roster: Arc<Roster>,
    ) -> Self {
        Self { gateway, context: context.clone(), local, known, roster, askers: Mutex::default() }
    }

    /// Tries to open a route, and keeps it open from then on. `ending` is told if it ends and nobody stopped it.
    pub(crate) async fn start(self: &Arc<Self>, route: RouteConfig, ending: &watch::Sender<bool>) -> Kept {
        let mark = Mark::new(&self.context.network, &route.service);
        let slot = self.roster.add(route, mark);
        let (stop, told) = watch::channel(false);
        let first = self.open(&slot, &told).await;
        let (keeper, kept, ending) = (Arc::clone(self), Arc::clone(&slot), ending.clone());
        let task = tokio::spawn(async move {
            keeper.keep(&kept, first, told.clone()).await;
            if !*told.borrow() {
                ending.send_replace(true);
            }
        });
        Kept { slot, stop, task }
    }

    /// Opens a route, or says and remembers why it waits.
    async fn open(&self, slot: &Slot, stop: &Stop) -> Option<Running> {
        match self.try_open(slot, stop).await {
            Ok(running) => Some(running),
            Err(refused) => {
                if self.roster.closed(slot, &refused) {
                    let (service, direction, number) = (&slot.route.service, slot.route.kind.name, slot.number);
                    let (code, reason) = (refused.code.name(), line(&refused));
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

    async fn try_open(&self, slot: &Slot, stop: &Stop) -> Result<Running, Rejection> {
        let (service, _) = ask_service(&*self.gateway, 0, &slot.route.service).await?;
        let topic = topic_for(&service, &slot.route)?;
        self.roster.no_circle(slot, &topic)?;
        let asker = self.asker(&service.robot).await?;
        let is_command = service.is_command();
        let opening = Opening {
            route: &slot.route,
            gateway: Arc::clone(&self.gateway),
            context: &self.context,
            local: &self.local,
            service,
            topic: &topic,
            mark: slot.mark,
            asker,
            counters: slot.counters.clone(),
            qos: slot.qos.subscribe(),
            stop: stop.clone(),
        };
        let Opened { in_memory, running } = slot.route.plan.open(opening).await?;
        let (route, counters, mark) = (slot.route.clone(), slot.counters.clone(), slot.mark);
        let (number, qos) = (slot.number, slot.qos.clone());
        let watched = Watched { number, route, topic, mark, is_command, counters, in_memory, qos };
        self.roster.opened(slot, watched);
        Ok(running)
    }

    /// Routes of one robot share their questions.
    async fn asker(&self, robot: &str) -> Result<Arc<Asker>, Rejection> {
        let mut askers = self.askers.lock().await;
        Ok(match askers.entry(robot.to_owned()) {
            Entry::Occupied(known) => Arc::clone(known.get()),
            Entry::Vacant(place) => {
                let asker = Asker::new(Arc::clone(&self.gateway), robot, self.known.as_ref())?;
                Arc::clone(place.insert(Arc::new(asker)))
            }
        })
    }

    /// Runs a route until it is told to end, or the middleware ends. `first` is the outcome of the first try.
    async fn keep(&self, slot: &Slot, first: Option<Running>, mut stop: Stop) {
        let mut running = first;
        loop {
            if let Some(running) = running {
                return running.await;
            }
            tokio::select! {
                () = stopped(&mut stop) => return,
                () = tokio::time::sleep(RETRY_PAUSE) => {}
            }
            running = self.open(slot, &stop).await;
            if let Some(watched) = slot.open().filter(|_| running.is_some()) {
                let arrow = watched.route.kind.arrow(&watched.topic, &watched.route.service);
                tracing::info!(service = slot.route.service, "route {} is open now: {arrow}", slot.number);
            }
        }
    }
}

/// May that which is missing still come, without anybody changing the bridge?
pub(crate) fn is_to_come(refused: &Rejection) -> bool {
    refused.code.class() == Class::Unreachable || matches!(refused.code, Code::UnknownRobot | Code::UnknownService)
}
