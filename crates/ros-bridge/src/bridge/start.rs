//! Construction of a bridge: the local graph, its routes, and what goes on beside them.

use std::sync::Arc;

use ledger_api::{Client, Context, read_checkpoint};
use ledger_base::rejection::Rejection;
use ledger_light::Governance;
use tokio::sync::watch;

use super::{
    graph_loss::GraphLoss,
    running::{Bridge, discover},
};
use crate::{
    config::{Config, context_of},
    grants::Grants,
    graph::{
        addresses::Addresses,
        choice::MiddlewareChoice,
        domain::{Domain, ROS_DOMAIN_ID},
        environment::OutOfReach,
        local::LocalGraph,
        reach::Reach,
    },
    ledger::{gateway::Gateway, service::ask_service},
    monitor::Reporter,
    routes::{
        kind::RouteConfig,
        table::{Keeper, Roster, RouteTable, is_to_come},
        topic_for,
    },
    shutdown::BackgroundTask,
};

impl Bridge {
    /// Joins the local graph and starts the routes. One that cannot start waits, says why, and is tried again; only if
    /// none can start, the bridge does not. Must be called inside a tokio runtime.
    ///
    /// The client decides through which nodes the bridge works. Network and organisations come from the context that
    /// the configuration names, which was stored at enrolment and needs no trust in a node.
    ///
    /// # Errors
    /// [`Code::NoContext`]; [`Code::BadConfiguration`] if `ROS_DOMAIN_ID` names no domain; [`Code::MiddlewareFailed`].
    /// If no route can start, the reason of one: [`Code::UnknownRobot`] and [`Code::UnknownService`];
    /// [`Code::WrongType`] if it has another type than its service; the ledger's refusal if it does not answer.
    pub async fn start(config: Config, client: Client) -> Result<Self, Rejection> {
        let context = context_of(&config)?;
        Self::start_with(config, Arc::new(client), &context).await
    }

    pub(super) async fn start_with(
        config: Config,
        gateway: Arc<dyn Gateway>,
        context: &Context,
    ) -> Result<Self, Rejection> {
        // A bridge that discovers may have to wait for its first route.
        let must_carry = config.discover.is_none();
        if must_carry {
            can_begin(&*gateway, &config.routes).await?;
        }
        let domain = Domain::choose(config.domain_id, std::env::var(ROS_DOMAIN_ID).ok().as_deref())?;
        let reach = Reach::choose(&config.reach, |name| std::env::var(name).ok())?;
        config.middleware.check(&reach)?;
        let addresses = match config.middleware {
            MiddlewareChoice::Dds => {
                for found in OutOfReach::find(|name| std::env::var(name).ok()) {
                    tracing::warn!(remedy = found.remedy, "{found}");
                }
                Some(Addresses::read(&reach).await?)
            }
            // zenoh connects again by itself.
            MiddlewareChoice::Zenoh(_) => None,
        };
        let (choice, name) = (&config.middleware, &config.node_name);
        let local = LocalGraph::join(domain.id, (choice, &reach), name, config.shared_memory).await?;

        let roster = Arc::new(Roster::traced(config.tracer.clone()));
        let known = checkpoint(&config, context)?;
        let keeper = Keeper::new(Arc::clone(&gateway), context, local.clone(), known, Arc::clone(&roster));
        let (ending, ended) = watch::channel(false);
        let table = Arc::new(RouteTable::new(keeper, Arc::clone(&roster), ending));
        table.begin(config.routes.clone()).await;
        let refused = all_refused(roster.slots().iter().map(|slot| slot.waits()));
        if let Some(refused) = refused.filter(|_| must_carry) {
            return Err(refused);
        }

        let grants = config.grant_services.then(|| {
            let grants = Grants::new(Arc::clone(&gateway), local.clone(), Arc::clone(&roster), context.network);
            BackgroundTask::spawn("the services for grants ended too early", |shutdown| grants.run(shutdown))
        });
        let reporter = Reporter::ready(
            &config,
            context,
            (domain, &reach),
            Arc::clone(&gateway),
            local.clone(),
            Arc::clone(&roster),
        )
        .await;
        let statuses = reporter.statuses().clone();
        let reporter =
            BackgroundTask::spawn("the reports of the bridge ended too early", |shutdown| reporter.run(shutdown));
        let discovery = discover(&config, &gateway, &table);
        Ok(Self {
            config,
            gateway,
            domain: domain.id,
            identity: format!("{}/{}", context.organisation, context.name),
            roster,
            table,
            discovery,
            grants,
            reporter,
            statuses,
            loss: GraphLoss::watch(ended, addresses),
            #[cfg(test)]
            local,
        })
    }
}

/// The beginning of the way to those who govern now; none = the genesis.
fn checkpoint(config: &Config, context: &Context) -> Result<Option<Governance>, Rejection> {
    let read = |path: &std::path::PathBuf| read_checkpoint(&context.network, path);
    let checkpoint = config.checkpoint.as_ref().map(read).transpose()?;
    Ok(checkpoint.map(|checkpoint| checkpoint.governance))
}

/// Refuses to begin while no route can: each service is looked up before the graph is joined.
async fn can_begin(gateway: &dyn Gateway, routes: &[RouteConfig]) -> Result<(), Rejection> {
    let mut refused = Vec::with_capacity(routes.len());
    for route in routes {
        let found = ask_service(gateway, 0, &route.service).await;
        refused.push(found.and_then(|(service, _)| topic_for(&service, route)).err());
    }
    all_refused(refused.into_iter()).map_or(Ok(()), Err)
}

/// Why no route at all is possible: what somebody must repair, before what may still come.
fn all_refused(refused: impl Iterator<Item = Option<Rejection>>) -> Option<Rejection> {
    let refused: Option<Vec<Rejection>> = refused.collect();
    refused?.into_iter().min_by_key(is_to_come)
}
