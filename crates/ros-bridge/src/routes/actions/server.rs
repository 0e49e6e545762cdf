//! The local server of a robot's action: goals go to the ledger, and what the robot says of them comes back.
//!
//! ROS 2 knows the answer no to a goal and to a cancelling. So whoever may not set a goal hears that at once.

mod goal_server;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;

use self::goal_server::ActionServer;
use super::{
    goals::Goals,
    parts::Parts,
    patience::{RESULT_KEY, RESULT_PATIENCE, result_patience},
    topics::{ActionTopic, feedback, status},
};
use crate::{
    graph::{dds::Exchange, endpoint::Role, local::OutputSettings, names::Interface},
    routes::{
        calls::{Account, PATIENCE, PendingRequests, ServerHalves, answers_of, patience},
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        silence::{self, Cause, Facts, Silence, pause},
    },
};

/// The setting of how long a reply is waited for.
const KEY: &str = "reply_timeout_ms";
/// A sign of life is given so often within a lease, while goals run.
const ALIVE_IN_LEASE: u32 = 3;
/// Longest time between two signs of life.
const ALIVE_EVERY_MAX: Duration = Duration::from_secs(1);
/// Shortest time between two signs of life.
const ALIVE_EVERY_MIN: Duration = Duration::from_millis(100);

/// The local server of a robot's action.
pub(crate) static KIND: Kind = Kind {
    name: "action_server",
    carries: Interface::Action,
    right: "publish",
    other_end: Role::Publisher,
    keys: &[KEY, RESULT_KEY],
    read: |section: &mut Section<'_, '_>, _| {
        Arc::new(Settings { patience: patience(section, KEY), results: result_patience(section) })
    },
    discovered: Some(|_terms| Arc::new(Settings { patience: PATIENCE, results: RESULT_PATIENCE })),
    silence,
    nearby,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long a reply is waited for.
    patience: Duration,
    /// How long a result is waited for.
    results: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<RouteTask, Rejection> {
        let answers = answers_of(&opening, "action").await?;
        let Opening { route, local, service, topic, mark, counters, shutdown, .. } = &opening;
        let middleware = local.middleware();
        let open = |exchange: Exchange| middleware.server(&exchange, *mark, route.sample_bytes_max);
        let servers = Parts::open(topic, &route.message, open)?;
        let output = async |told: ActionTopic| {
            let ActionTopic { topic, message, qos } = told;
            middleware.output(&OutputSettings { topic, message, mark: Some(*mark) }, &qos).await
        };
        let (feedback, status) = (output(feedback(topic, &route.message)?).await?, output(status(topic)?).await?);
        let halves = ServerHalves::open(&opening, answers, servers.matched()).await?;
        let ServerHalves { requests, updates, handed, carry } = halves;
        let lease = Duration::from_millis(service.lease_ms);
        let server = ActionServer {
            robot: service.robot.clone(),
            servers,
            feedback,
            status,
            requests,
            updates,
            handed,
            pending: PendingRequests::new([self.patience, self.results]),
            goals: Goals::new(None),
            callers: BTreeMap::new(),
            alive_every: (lease / ALIVE_IN_LEASE).clamp(ALIVE_EVERY_MIN, ALIVE_EVERY_MAX),
            account: Account::new(&route.service, counters.clone()),
        };
        let running = futures::future::join(carry(shutdown.clone()), server.run(shutdown.clone()));
        Ok(RouteTask { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let topic = facts.topic;
    let alone = pause("no_publisher", format!("nobody is there who sets goals on {topic}"));
    let nothing = format!("nobody has set a goal on {topic} yet");
    silence::of_sending(facts, cause, (alone, "the last request has failed", nothing))
}

/// The warning about another server.
fn nearby(NearbyEndpoint { topic, .. }: &NearbyEndpoint<'_>) -> Option<String> {
    Some(format!("another node serves {topic} beside this bridge: a client hears both"))
}
