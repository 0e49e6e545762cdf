//! A bridge that has joined its graph.

use std::{fmt, sync::Arc};

use futures::future::OptionFuture;
use ledger_base::rejection::Rejection;
use serde::Serialize;

use super::graph_loss::GraphLoss;
#[cfg(test)]
use crate::graph::local::LocalGraph;
use crate::{
    config::Config,
    ledger::gateway::Gateway,
    monitor::{BridgeMonitor, Running, Statuses},
    routes::{
        counters::RouteSummary,
        discovery::Discovery,
        table::{Roster, RouteTable, TableChange},
    },
    shutdown::BackgroundTask,
};

/// The counters of all routes of a bridge.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The ROS domain.
    pub domain: u16,
    /// One entry for each route, in the order of the configuration.
    pub routes: Vec<RouteSummary>,
}

/// A running bridge. Dropped without [`Bridge::stop`], its routes end as well, but nobody waits for them.
pub struct Bridge {
    pub(super) config: Config,
    pub(super) gateway: Arc<dyn Gateway>,
    /// The ROS domain that it has joined.
    pub(super) domain: u16,
    /// The identity towards the ledger, `Org2/Rover`.
    pub(super) identity: String,
    pub(super) roster: Arc<Roster>,
    pub(super) table: Arc<RouteTable>,
    /// Discovers routes, if the configuration asks for it.
    pub(super) discovery: Option<BackgroundTask>,
    /// Serves grants in the local graph, if the configuration asks for it.
    pub(super) grants: Option<BackgroundTask>,
    pub(super) reporter: BackgroundTask,
    /// How the ledger and the routes do, as the reporter says it.
    pub(super) statuses: Statuses,
    pub(super) loss: GraphLoss,
    #[cfg(test)]
    pub(super) local: LocalGraph,
}

/// Starts to discover routes, if the configuration asks for it.
pub(super) fn discover(config: &Config, gateway: &Arc<dyn Gateway>, table: &Arc<RouteTable>) -> Option<BackgroundTask> {
    let discovery = Discovery::new(config.discover.clone()?, Arc::clone(gateway), Arc::clone(table));
    Some(BackgroundTask::spawn("the discovery of routes ended too early", |shutdown| discovery.run(shutdown)))
}

impl Bridge {
    /// Takes over the routes of another configuration: those that are gone end, new ones start, and all others go on
    /// untouched. Other settings count from the next start on; a warning says so if they differ.
    pub async fn reload(&mut self, config: Config) {
        if !config.is_same_beside_routes(&self.config) {
            tracing::warn!("only routes can be reloaded; restart the bridge to apply other settings");
        }
        if !config.discovers_as(&self.config) {
            if let Some(discovery) = self.discovery.take() {
                discovery.end().await;
            }
            if config.discover.is_none() {
                self.table.discovered(Vec::new()).await;
            }
            self.discovery = discover(&config, &self.gateway, &self.table);
        }
        let TableChange { ended, started } = self.table.configured(config.routes.clone()).await;
        (self.config.routes, self.config.discover) = (config.routes, config.discover);
        let routes = self.roster.slots().len();
        tracing::info!(
            ended,
            started,
            routes,
            "the configuration was read again: {ended} routes ended, {started} started"
        );
    }

    /// Waits until the local graph is lost, and says why: a route has ended that nobody stopped, so the middleware has ended; or
    /// the addresses of this host are others. Then stop the bridge, and start another one.
    pub async fn ended(&self) -> Rejection {
        self.loss.reason().await
    }

    /// The counters of the routes so far.
    pub fn summary(&self) -> Summary {
        Summary { domain: self.domain, routes: self.roster.summaries() }
    }

    /// From now on the monitor shows this bridge.
    pub fn show_on(&self, monitor: &BridgeMonitor) {
        monitor.runs(Running {
            identity: self.identity.clone(),
            domain: self.domain,
            roster: Arc::clone(&self.roster),
            statuses: self.statuses.clone(),
        });
    }

    /// Stops what robots are moving, ends all routes, and leaves the graph.
    pub async fn stop(self) -> Summary {
        self.reporter.signal();
        self.grants.iter().for_each(BackgroundTask::signal);
        self.table.closes();
        OptionFuture::from(self.discovery.map(BackgroundTask::end)).await;
        self.table.close().await;
        OptionFuture::from(self.grants.map(BackgroundTask::end)).await;
        self.reporter.end().await;
        Summary { domain: self.domain, routes: self.roster.summaries() }
    }
}

impl fmt::Debug for Bridge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bridge").field("domain", &self.domain).field("routes", &self.roster).finish_non_exhaustive()
    }
}
