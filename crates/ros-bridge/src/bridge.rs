//! A running bridge: its routes, and what they have done.

#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::Path,
    sync::Arc,
    time::Duration,
};

use ledger_api::{Client, Context, home, read_checkpoint};
use ledger_gate::service::Service;
use ledger_rejection::{Class, Code, Rejection};
use serde::Serialize;
use tokio::{sync::watch, task::JoinHandle};

use crate::{
    config::{Config, IdentitySource, RouteConfig, circle},
    count::{Counters, RouteSummary, line},
    domain::{Domain, ROS_DOMAIN_ID},
    gateway::Gateway,
    mark::Mark,
    names::TopicName,
    reach::Reach,
    renewal::keep_renewed,
    report::{Reporter, Watched},
    route::{
        kind::{Opened, Opening},
        local::Local,
    },
    service::{ask_service, topic_for},
    standing::Asker,
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
#[derive(Debug)]
pub struct Bridge {
    stop: watch::Sender<bool>,
    /// Has a route ended?
    ended: watch::Receiver<bool>,
    tasks: Vec<JoinHandle<()>>,
    domain: u16,
    counters: Vec<Counters>,
}

/// Runs a bridge by itself until `stop` is ready, and then prints one line of JSON on standard output: the
/// [`Summary`]. It waits, and says so, as long as no node answers or its robot is not registered.
///
/// # Errors
/// As [`Client::connect`] and [`Bridge::start`], where waiting cannot help;
/// [`Code::MiddlewareFailed`] if the local graph is lost.
pub async fn run(config: Config, stop: impl Future<Output = ()>) -> Result<(), Rejection> {
    let mut stop = std::pin::pin!(stop);
    let mut told = String::new();
    let (bridge, client) = loop {
        let refused = tokio::select! {
            () = &mut stop => return Ok(()),
            started = start(&config) => match started {
                Ok(started) => break started,
                Err(refused) if is_to_come(&refused) => refused,
                Err(refused) => return Err(refused),
            },
        };
        // The same reason once, not every two seconds.
        if told != refused.message {
            let (code, reason) = (refused.code.name(), line(&refused));
            tracing::warn!(code, reason, "the bridge waits: {}", refused.message);
            told = refused.message;
        }
        tokio::select! {
            () = &mut stop => return Ok(()),
            () = tokio::time::sleep(RETRY_PAUSE) => {}
        }
    };
    let outcome = tokio::select! {
        () = &mut stop => Ok(()),
        () = keep_renewed(&config, &client) => Ok(()),
        lost = bridge.ended() => Err(lost),
    };
    print(&bridge.stop().await)?;
    outcome
}

impl Bridge {
    /// Joins the local graph and starts all routes, or none. Must be called inside a tokio runtime.
    ///
    /// The client decides through which nodes the bridge works. Network and organisations come from the context that
    /// the configuration names, which was stored at enrolment and needs no trust in a node.
    ///
    /// # Errors
    /// [`Code::NoContext`]; [`Code::BadConfiguration`] if two routes close a circle, or `ROS_DOMAIN_ID` names no
    /// domain; [`Code::UnknownRobot`] and [`Code::UnknownService`]; [`Code::WrongType`] if a route has another type
    /// than its service; [`Code::MiddlewareFailed`]; the ledger's refusal if it does not answer.
    pub async fn start(config: Config, client: Client) -> Result<Self, Rejection> {
        let context = context_of(&config)?;
        Self::start_with(config, Arc::new(client), &context).await
    }

    async fn start_with(config: Config, gateway: Arc<dyn Gateway>, context: &Context) -> Result<Self, Rejection> {
        let mut services = Vec::with_capacity(config.routes.len());
        for route in &config.routes {
            let (service, _) = ask_service(&*gateway, 0, &route.service).await?;
            let topic = topic_for(&service, route)?;
            services.push((service, topic));
        }
        no_circle(&config.routes, &services)?;
        let domain = Domain::choose(config.domain_id, std::env::var(ROS_DOMAIN_ID).ok().as_deref())?;
        let reach = Reach::choose(&config.reach, |name| std::env::var(name).ok())?;
        let local = Local::open(domain.id, &reach, &config.node_name, config.shared_memory).await?;
        let checkpoint =
            config.checkpoint.as_deref().map(|path| read_checkpoint(&context.network, path)).transpose()?;
        let known = checkpoint.map(|checkpoint| checkpoint.governance);
        let mut askers = BTreeMap::new();
        let mut watched = Vec::with_capacity(config.routes.len());
        let (stop, told) = watch::channel(false);
        let mut routes: Vec<futures::future::BoxFuture<'static, ()>> = Vec::new();
        let mut counters = Vec::new();
        for (route, (service, topic)) in config.routes.iter().zip(services) {
            let mark = Mark::new(&context.network, &route.service);
            let is_command = service.is_command();
            let (gateway, stop) = (Arc::clone(&gateway), told.clone());
            let asker = match askers.entry(service.robot.clone()) {
                Entry::Occupied(known) => Arc::clone(known.get()),
                Entry::Vacant(place) => {
                    let (gateway, stored) = (Arc::clone(&gateway), Arc::clone(&context.msps));
                    let asker = Asker::new(gateway, &service.robot, stored, known.as_ref())?;
                    Arc::clone(place.insert(Arc::new(asker)))
                }
            };
            let opening = Opening { route, gateway, context, local: &local, service, topic: &topic, mark, asker, stop };
            let Opened { counters: counted, in_memory, running } = route.plan.open(opening).await?;
            routes.push(running);
            counters.push(counted.clone());
            watched.push(Watched { route: route.clone(), topic, mark, is_command, counters: counted, in_memory });
        }
        let reporter = Reporter::ready(&config, context, (domain, &reach), gateway, local, watched);
        routes.push(Box::pin(reporter.run(told)));
        let (ending, ended) = watch::channel(false);
        let tasks = routes.into_iter().map(|route| {
            let ending = ending.clone();
            tokio::spawn(async move {
                route.await;
                ending.send_replace(true);
            })
        });
        Ok(Self { tasks: tasks.collect(), domain: domain.id, stop, ended, counters })
    }

    /// Waits until a route ends that nobody stopped, and says why: the middleware has ended. Then start another bridge.
    pub async fn ended(&self) -> Rejection {
        // An error means that every route has ended.
        drop(self.ended.clone().wait_for(|ended| *ended).await);
        Rejection::new(Code::MiddlewareFailed, "the local ROS 2 graph is lost")
            .found("DDS has ended: one of its threads is gone")
            .wanted("a running DDS")
            .next("start the bridge again, or let a service unit do it")
    }

    /// The counters of the routes so far.
    pub fn summary(&self) -> Summary {
        Summary { domain: self.domain, routes: self.counters.iter().map(Counters::summary).collect() }
    }

    /// Stops what robots are moving, ends all routes, and leaves the graph.
    pub async fn stop(self) -> Summary {
        self.stop.send_replace(true);
        for task in self.tasks {
            if let Err(error) = task.await {
                tracing::error!(%error, "a route ended too early");
            }
        }
        Summary { domain: self.domain, routes: self.counters.iter().map(Counters::summary).collect() }
    }
}

/// Refuses a pair of routes between which each message would go round.
fn no_circle(routes: &[RouteConfig], services: &[(Service, TopicName)]) -> Result<(), Rejection> {
    let routes = || (1..).zip(routes.iter().zip(services));
    for (one, (up, (_, topic))) in routes().filter(|(_, (route, _))| route.kind.takes_in()) {
        for (two, (down, (_, other))) in routes().filter(|(_, (route, _))| !route.kind.takes_in()) {
            if up.service == down.service && topic == other {
                return Err(circle(&up.service, topic.as_str(), [(one, up.kind), (two, down.kind)]));
            }
        }
    }
    Ok(())
}

async fn start(config: &Config) -> Result<(Bridge, Client), Rejection> {
    let client = Client::connect(&context_of(config)?).await?;
    Ok((Bridge::start(config.clone(), client.clone()).await?, client))
}

/// May that which is missing still come, without anybody changing the bridge?
fn is_to_come(refused: &Rejection) -> bool {
    refused.code.class() == Class::Unreachable || matches!(refused.code, Code::UnknownRobot | Code::UnknownService)
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
