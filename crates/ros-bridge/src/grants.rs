//! The grant from ROS: `/<robot>/acquire`, `/<robot>/release` and `/<robot>/stop` as services of type `std_srvs/srv/Trigger`, for
//! nodes without a ledger client. They act with the bridge's own identity.
//!
//! They are about the services that this bridge takes something to, and that ask for a grant. A grant that was acquired so is
//! renewed until it is released, ends otherwise, or the bridge ends.

mod answer;
mod desk;
mod keeping;

use std::{collections::BTreeMap, sync::Arc};

use futures::future::{BoxFuture, FutureExt};
use ledger_base::hash::Hash;
use tokio::task::JoinSet;

use self::{answer::Answer, desk::Desk};
use crate::{
    dds::{Exchange, Server},
    error::Result,
    gateway::Gateway,
    mark::Mark,
    names::{TopicName, TypeName},
    roster::Roster,
    route::{Stop, local::Local, stopped},
};

const TYPE: &str = "std_srvs/srv/Trigger";
/// Largest request; the type has none of its own.
const REQUEST_BYTES_MAX: usize = 1024;

/// Serves the robots of a bridge.
pub(crate) struct Grants {
    pub(crate) gateway: Arc<dyn Gateway>,
    pub(crate) local: Local,
    pub(crate) roster: Arc<Roster>,
    pub(crate) network: Hash,
}

/// The action that a request asks for.
type Act = fn(Arc<Desk>) -> BoxFuture<'static, Answer>;

const ACTS: [(&str, Act); 3] = [
    ("acquire", |desk| async move { desk.acquire().await }.boxed()),
    ("release", |desk| async move { desk.release().await }.boxed()),
    ("stop", |desk| async move { desk.stop().await }.boxed()),
];

impl Grants {
    /// Runs until it is told to end.
    pub(crate) async fn run(self, mut stop: Stop) {
        let mut routes = self.roster.topics();
        // By the robots' names in ROS. A robot whose servers are dropped leaves the graph.
        let mut served: BTreeMap<String, (String, JoinSet<()>)> = BTreeMap::new();
        loop {
            let robots = self.roster.robots();
            served.retain(|_, (robot, _)| robots.contains(robot));
            for robot in robots {
                let Some(name) = TopicName::near(&format!("/{robot}")) else {
                    tracing::warn!(robot, "the name of this robot is none for ROS: its grant cannot be had from there");
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
                        Err(error) => tracing::warn!(robot, %error, "the grant of this robot cannot be had from ROS"),
                    },
                }
            }
            tokio::select! {
                () = stopped(&mut stop) => return,
                changed = routes.changed() => if changed.is_err() { return },
            }
        }
    }

    fn serve(&self, robot: &str, name: &TopicName) -> Result<JoinSet<()>> {
        let desk = Arc::new(Desk::new(Arc::clone(&self.gateway), Arc::clone(&self.roster), robot, name));
        let (mark, of) = (Mark::new(&self.network, robot), TypeName::parse(TYPE)?);
        let mut tasks = JoinSet::new();
        for (act, does) in ACTS {
            let exchange = Exchange::new(&TopicName::parse(&format!("{name}/{act}"))?, &of);
            let server = self.local.participant().server(&exchange, mark, REQUEST_BYTES_MAX)?;
            tasks.spawn(serve(server, Arc::clone(&desk), does));
        }
        tasks.spawn(async move { desk.keep().await });
        Ok(tasks)
    }
}

/// Answers one request after the other: a stop never waits for an acquisition, which has a server of its own.
async fn serve(mut server: Server, desk: Arc<Desk>, act: Act) {
    while let Some(request) = server.next().await {
        let answer = act(Arc::clone(&desk)).await;
        if let Err(error) = server.reply(&request.caller, &answer.encode()) {
            tracing::warn!(%error, "an answer about a grant was not handed over");
        }
    }
}
