//! The grant from ROS: `/<robot>/acquire`, `/<robot>/release` and `/<robot>/stop` as services of type `std_srvs/srv/Trigger`, for
//! nodes without a ledger client. They act with the bridge's own identity.
//!
//! They are about the services that this bridge takes something to, and that ask for a grant. A grant that was acquired so is
//! renewed until it is released, ends otherwise, or the bridge ends.

mod answer;
mod kept;
mod robot;

use std::{collections::BTreeMap, sync::Arc};

use futures::future::{BoxFuture, FutureExt};
use ledger_base::hash::Hash;
use tokio::task::JoinSet;

use self::{answer::Answer, robot::RobotGrants};
use crate::{
    error::Result,
    graph::{
        dds::Exchange,
        local::{LocalGraph, Server},
        mark::Mark,
        names::{TopicName, TypeName},
    },
    ledger::gateway::Gateway,
    routes::table::Roster,
    shutdown::{Shutdown, requested},
};

const TYPE: &str = "std_srvs/srv/Trigger";
/// Largest request; the type has none of its own.
const REQUEST_BYTES_MAX: usize = 1024;

/// Serves the robots of a bridge.
pub(crate) struct Grants {
    gateway: Arc<dyn Gateway>,
    local: LocalGraph,
    roster: Arc<Roster>,
    network: Hash,
}

/// The action that a request asks for.
type Act = fn(Arc<RobotGrants>) -> BoxFuture<'static, Answer>;

const ACTS: [(&str, Act); 3] = [
    ("acquire", |robot_grants| async move { robot_grants.acquire().await }.boxed()),
    ("release", |robot_grants| async move { robot_grants.release().await }.boxed()),
    ("stop", |robot_grants| async move { robot_grants.stop().await }.boxed()),
];

impl Grants {
    /// Serves the robots of these routes.
    pub(crate) fn new(gateway: Arc<dyn Gateway>, local: LocalGraph, roster: Arc<Roster>, network: Hash) -> Self {
        Self { gateway, local, roster, network }
    }

    /// Runs until it is told to end.
    pub(crate) async fn run(self, mut shutdown: Shutdown) {
        let mut routes = self.roster.topics();
        // By the robots' names in ROS. A robot whose servers are dropped leaves the graph.
        let mut served: BTreeMap<String, (String, JoinSet<()>)> = BTreeMap::new();
        loop {
            let robots = self.roster.robots();
            served.retain(|_, (robot, _)| robots.contains(robot));
            for robot in robots {
                let Some(name) = TopicName::near(&format!("/{robot}")) else {
                    tracing::warn!(robot, "robot name is not a ROS name; its grant is not available from ROS");
                    continue;
                };
                match served.get(name.as_str()) {
                    Some((same, _)) if *same == robot => {}
                    Some((other, _)) => {
                        tracing::warn!(robot, other, "two robots would be {name} in ROS: one is served")
                    }
                    None => match self.serve(&robot, &name) {
                        Ok(tasks) => {
                            tracing::info!(robot, "{name}/acquire, {name}/release and {name}/stop are served");
                            served.insert(name.as_str().to_owned(), (robot, tasks));
                        }
                        Err(error) => tracing::warn!(robot, %error, "grant of this robot not available from ROS"),
                    },
                }
            }
            tokio::select! {
                () = requested(&mut shutdown) => return,
                changed = routes.changed() => if changed.is_err() { return },
            }
        }
    }

    fn serve(&self, robot: &str, name: &TopicName) -> Result<JoinSet<()>> {
        let robot_grants = Arc::new(RobotGrants::new(Arc::clone(&self.gateway), Arc::clone(&self.roster), robot, name));
        let (mark, of) = (Mark::new(&self.network, robot), TypeName::parse(TYPE)?);
        let mut tasks = JoinSet::new();
        for (act, does) in ACTS {
            let exchange = Exchange::new(&TopicName::parse(&format!("{name}/{act}"))?, &of);
            let server = self.local.middleware().server(&exchange, mark, REQUEST_BYTES_MAX)?;
            tasks.spawn(serve(server, Arc::clone(&robot_grants), does));
        }
        tasks.spawn(async move { robot_grants.keep().await });
        Ok(tasks)
    }
}

/// Answers one request after the other: a stop never waits for an acquisition, which has a server of its own.
async fn serve(mut server: Box<dyn Server>, robot_grants: Arc<RobotGrants>, act: Act) {
    while let Some(request) = server.next().await {
        let answer = act(Arc::clone(&robot_grants)).await;
        if let Err(error) = server.reply(&request.caller, &answer.encode()) {
            tracing::warn!(%error, "cannot deliver the answer about a grant");
        }
    }
}
