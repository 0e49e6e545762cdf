//! A running bridge: its routes, and what they have done.

#[cfg(test)]
mod tests;

use std::{fmt, path::Path, sync::Arc, time::Duration};

use futures::{
    FutureExt, Stream, StreamExt,
    future::{BoxFuture, OptionFuture},
};
use ledger_api::{Client, Context, home, read_checkpoint};
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use tokio::{
    sync::watch,
    task::{JoinHandle, JoinSet, spawn_blocking},
};

use crate::{
    addresses::Addresses,
    config::{Config, IdentitySource, RouteConfig},
    count::{RouteSummary, line},
    discover::Watch,
    domain::{Domain, ROS_DOMAIN_ID},
    gateway::Gateway,
    grants::Grants,
    keeper::{Keeper, is_to_come},
    reach::Reach,
    renewal::keep_renewed,
    report::{Reporter, Statuses},
    roster::Roster,
    route::local::Local,
    service::{ask_service, topic_for},
    sight::Sight,
    table::{Changed, Table},
};

/// Pause before a bridge that cannot start yet tries again.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

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
    config: Config,
    domain: u16,
    gateway: Arc<dyn Gateway>,
    roster: Arc<Roster>,
    table: Arc<Table>,
    /// Discovers routes, if the configuration asks for it.
    watch: Option<Watching>,
    grants: Option<JoinHandle<()>>,
    reporter: JoinHandle<()>,
    /// The identity towards the ledger, `Org2/Rover`.
    identity: String,
    /// How the ledger and the routes do, as the reporter says it.
    statuses: Statuses,
    stop_reporter: watch::Sender<bool>,
    /// Has a route ended that nobody stopped?
    ended: watch::Receiver<bool>,
    /// Have the addresses of this host changed, so that the graph must be joined anew? Says how.
    outdated: watch::Receiver<Option<String>>,
    /// The task that looks at them.
    _looking: JoinSet<()>,
    #[cfg(test)]
    local: Local,
}

/// A task that discovers routes.
struct Watching {
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Watching {
    fn start(config: &Config, gateway: &Arc<dyn Gateway>, table: &Arc<Table>) -> Option<Self> {
        let watch = Watch::new(config.discover.clone()?, Arc::clone(gateway), Arc::clone(table));
        let (stop, told) = watch::channel(false);
        Some(Self { stop, task: tokio::spawn(watch.run(told)) })
    }

    async fn end(self) {
        self.stop.send_replace(true);
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the discovery of routes ended too early");
        }
    }
}

impl fmt::Debug for Bridge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bridge").field("domain", &self.domain).field("routes", &self.roster).finish_non_exhaustive()
    }
}

/// Runs a bridge by itself until `stop` is ready, and then prints one line of JSON on standard output: the
/// [`Summary`]. It waits, and says so, as long as no node answers or its robot is not registered. If it loses the local graph, it
/// joins it again; the summary counts from there. `changes` brings configurations that are to count from now on, as
/// [`Bridge::reload`] takes them. `sight` shows the bridge of each moment.
///
/// # Errors
/// As [`Client::connect`] and [`Bridge::start`] at the first start, where waiting cannot help.
pub async fn run(
    config: Config,
    changes: impl Stream<Item = Config>,
    stop: impl Future<Output = ()>,
    sight: &Sight,
) -> Result<(), Rejection> {
    match keep_running(config, changes, stop, start, sight).await? {
        Some(summary) => print(&summary),
        None => Ok(()),
    }
}

/// A bridge, and what ends it as `stop` does: its certificate is a new one.
type Started = (Bridge, BoxFuture<'static, ()>);

/// Runs bridges that `start` starts, one after another, until `stop` is ready. Answers with the summary of the last one, if one
/// ever ran.
async fn keep_running(
    mut config: Config,
    changes: impl Stream<Item = Config>,
    stop: impl Future<Output = ()>,
    start: impl AsyncFn(&Config) -> Result<Started, Rejection>,
    sight: &Sight,
) -> Result<Option<Summary>, Rejection> {
    let (mut stop, mut changes) = (std::pin::pin!(stop), std::pin::pin!(changes));
    let (mut told, mut last) = (String::new(), None);
    loop {
        let refused = tokio::select! {
            () = &mut stop => return Ok(last),
            started = start(&config) => match started {
                Ok((mut bridge, mut renewed)) => {
                    told.clear();
                    sight.runs(&bridge);
                    let lost = loop {
                        tokio::select! {
                            () = &mut stop => break None,
                            () = &mut renewed => break None,
                            lost = bridge.ended() => break Some(lost),
                            Some(changed) = changes.next() => {
                                config = changed;
                                bridge.reload(config.clone()).await;
                            }
                        }
                    };
                    let summary = bridge.stop().await;
                    let Some(lost) = lost else { return Ok(Some(summary)) };
                    let counters = serde_json::to_string(&summary).unwrap_or_default();
                    tracing::error!(summary = counters, "the local graph is lost, and is joined again");
                    last = Some(summary);
                    lost
                }
                Err(refused) if last.is_some() || is_to_come(&refused) => refused,
                Err(refused) => return Err(refused),
            },
        };
        sight.waits(&refused);
        // The same reason once, not every two seconds.
        if told != refused.message {
            let (code, reason) = (refused.code.name(), line(&refused));
            tracing::warn!(code, reason, "the bridge waits: {}", refused.message);
            told = refused.message;
        }
        tokio::select! {
            () = &mut stop => return Ok(last),
            Some(changed) = changes.next() => config = changed,
            () = tokio::time::sleep(RETRY_PAUSE) => {}
        }
    }
}

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

    async fn start_with(config: Config, gateway: Arc<dyn Gateway>, context: &Context) -> Result<Self, Rejection> {
        // A bridge that discovers may have to wait for its first route.
        if config.discover.is_none() {
            can_begin(&*gateway, &config.routes).await?;
        }
        let domain = Domain::choose(config.domain_id, std::env::var(ROS_DOMAIN_ID).ok().as_deref())?;
        let reach = Reach::choose(&config.reach, |name| std::env::var(name).ok())?;
        let looked = reach.clone();
        let addresses = spawn_blocking(move || Addresses::now(&looked)).await.map_err(|error| {
            Rejection::new(Code::Internal, format!("the addresses of this host cannot be read: {error}"))
        })?;
        let local = Local::open(domain.id, &reach, &config.node_name, config.shared_memory).await?;
        let checkpoint =
            config.checkpoint.as_deref().map(|path| read_checkpoint(&context.network, path)).transpose()?;
        let known = checkpoint.map(|checkpoint| checkpoint.governance);
        let roster = Arc::new(Roster::traced(config.tracer.clone()));
        let keeper = Arc::new(Keeper::new(Arc::clone(&gateway), context, local.clone(), known, Arc::clone(&roster)));
        let (ending, ended) = watch::channel(false);
        let table = Arc::new(Table::new(keeper, Arc::clone(&roster), ending));
        table.begin(config.routes.clone()).await;
        let refused = all_refused(roster.slots().iter().map(|slot| slot.waits()));
        if let Some(refused) = refused.filter(|_| config.discover.is_none()) {
            return Err(refused);
        }
        let (stop_reporter, told) = watch::channel(false);
        let grants = config.grant_services.then(|| {
            let (gateway, local, roster) = (Arc::clone(&gateway), local.clone(), Arc::clone(&roster));
            tokio::spawn(Grants { gateway, local, roster, network: context.network }.run(told.clone()))
        });
        #[cfg(test)]
        let kept = local.clone();
        let reporter =
            Reporter::ready(&config, context, (domain, &reach), Arc::clone(&gateway), local, Arc::clone(&roster));
        let statuses = reporter.statuses().clone();
        let reporter = tokio::spawn(reporter.run(told));
        let watch = Watching::start(&config, &gateway, &table);
        let (tell, outdated) = watch::channel(None);
        let mut looking = JoinSet::new();
        looking.spawn(async move {
            tell.send_replace(Some(addresses.outdated().await));
        });
        Ok(Self {
            config,
            domain: domain.id,
            gateway,
            roster,
            table,
            watch,
            grants,
            reporter,
            identity: format!("{}/{}", context.organisation, context.name),
            statuses,
            stop_reporter,
            ended,
            outdated,
            _looking: looking,
            #[cfg(test)]
            local: kept,
        })
    }

    /// Takes over the routes of another configuration: those that are gone end, new ones start, and all others go on
    /// untouched. Other settings count from the next start on; a warning says so if they differ.
    pub async fn reload(&mut self, config: Config) {
        if !config.is_same_beside_routes(&self.config) {
            tracing::warn!("only routes change while the bridge runs: start it again to use the other settings");
        }
        if !config.discovers_as(&self.config) {
            if let Some(watch) = self.watch.take() {
                watch.end().await;
            }
            if config.discover.is_none() {
                self.table.discovered(Vec::new()).await;
            }
            self.watch = Watching::start(&config, &self.gateway, &self.table);
        }
        let Changed { ended, started } = self.table.configured(config.routes.clone()).await;
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
        let (mut ended, mut outdated) = (self.ended.clone(), self.outdated.clone());
        tokio::select! {
            // An error means that every route has ended.
            _ = ended.wait_for(|ended| *ended) => Rejection::new(Code::MiddlewareFailed, "the local ROS 2 graph is lost")
                .found("DDS has ended: one of its threads is gone")
                .wanted("a running DDS")
                .next("it is joined again by itself; look at the interfaces of this machine if that does not help"),
            Ok(found) = outdated.wait_for(Option::is_some) => {
                let found = found.clone().unwrap_or_default();
                Rejection::new(Code::MiddlewareFailed, "the addresses of this host have changed")
                    .found(found)
                    .wanted("the addresses with which DDS began")
                    .next("the graph is joined again by itself, with the new ones")
            }
        }
    }

    /// The counters of the routes so far.
    pub fn summary(&self) -> Summary {
        Summary { domain: self.domain, routes: self.roster.summaries() }
    }

    /// The identity towards the ledger, `Org2/Rover`.
    pub(crate) fn identity(&self) -> &str {
        &self.identity
    }

    /// The ROS domain that it has joined.
    pub(crate) fn domain(&self) -> u16 {
        self.domain
    }

    /// Its routes.
    pub(crate) fn roster(&self) -> &Arc<Roster> {
        &self.roster
    }

    /// How the ledger and its routes do.
    pub(crate) fn statuses(&self) -> &Statuses {
        &self.statuses
    }

    /// Stops what robots are moving, ends all routes, and leaves the graph.
    pub async fn stop(self) -> Summary {
        self.stop_reporter.send_replace(true);
        self.table.closes();
        if let Some(watch) = self.watch {
            watch.end().await;
        }
        self.table.close().await;
        if let Some(Err(error)) = OptionFuture::from(self.grants).await {
            tracing::error!(%error, "the services for grants ended too early");
        }
        if let Err(error) = self.reporter.await {
            tracing::error!(%error, "the reports of the bridge ended too early");
        }
        Summary { domain: self.domain, routes: self.roster.summaries() }
    }
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

async fn start(config: &Config) -> Result<Started, Rejection> {
    let client = Client::connect(&context_of(config)?).await?;
    let bridge = Bridge::start(config.clone(), client.clone()).await?;
    let config = config.clone();
    Ok((bridge, async move { keep_renewed(&config, &client).await }.boxed()))
}

/// The identity of a bridge towards the ledger, as its configuration names it.
///
/// # Errors
/// As [`Context::load`].
pub fn context_of(config: &Config) -> Result<Context, Rejection> {
    match &config.identity {
        IdentitySource::Selected => Context::load(&home()?, None),
        IdentitySource::Context(name) => Context::load(&home()?, Some(name)),
        IdentitySource::Directory(path) => {
            let contexts = path.parent();
            let name = path.file_name().and_then(|name| name.to_str());
            match (name, contexts, contexts.and_then(Path::parent)) {
                (Some(name), Some(contexts), Some(home)) if contexts.ends_with("contexts") => {
                    Context::load(home, Some(name))
                }
                _ => Err(Rejection::new(Code::BadConfiguration, "context_dir is not usable")
                    .found(path.display().to_string())
                    .wanted("the directory of a context: <home>/contexts/<NAME>")
                    .next("ledgerctl enroll makes one below LEDGERD_HOME")),
            }
        }
    }
}

#[expect(clippy::print_stdout, reason = "the summary is the output of the program")]
fn print(summary: &Summary) -> Result<(), Rejection> {
    let text = serde_json::to_string(summary)
        .map_err(|error| Rejection::new(Code::Internal, format!("the summary cannot be written: {error}")))?;
    println!("{text}");
    Ok(())
}
