//! The user's side of calls: the bridge is the server of the local graph. Requests go to the ledger, and a reply of the robot goes
//! to who has called.
//!
//! A reply counts only if the gate lets it pass, the robot's own identity has signed it, and it names a request of this bridge.
//! ROS 2 has no word for a refusal by somebody between: then the caller gets no reply, and the log says why.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::{
    gate::Passed,
    sample::{CDR_LE, Sample},
};
use tokio::{
    sync::mpsc::{self, UnboundedReceiver},
    time::sleep_until,
};

use crate::{
    graph::{
        dds::Exchange,
        endpoint::Role,
        local::{Caller, Request, Server},
        names::Interface,
    },
    routes::{
        calls::{Account, PATIENCE, PendingRequests, ServerHalves, Submitter, answers_of, patience},
        ends::{CALLS_MAX, Handed, SubmitUpdate, TOO_MANY, split},
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        silence::{self, Cause, Facts, Silence, pause},
    },
    shutdown::{Shutdown, requested},
};

/// The setting of how long a reply is waited for.
const KEY: &str = "reply_timeout_ms";

/// The local server of a robot's service.
pub(crate) static KIND: Kind = Kind {
    name: "service_server",
    carries: Interface::Service,
    right: "publish",
    other_end: Role::Publisher,
    keys: &[KEY],
    read: |section: &mut Section<'_, '_>, _| Arc::new(Settings { patience: patience(section, KEY) }),
    discovered: Some(|_terms| Arc::new(Settings { patience: PATIENCE })),
    silence,
    nearby,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long a reply is waited for.
    patience: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<RouteTask, Rejection> {
        let answers = answers_of(&opening, "service").await?;
        let Opening { route, local, service, topic, mark, counters, shutdown, .. } = &opening;
        let exchange = Exchange::new(topic, &route.message);
        let server = local.middleware().server(&exchange, *mark, route.sample_bytes_max)?;
        let halves = ServerHalves::open(&opening, answers, server.matched()).await?;
        let ServerHalves { requests, updates, handed, carry } = halves;
        let server = ServiceServer {
            robot: service.robot.clone(),
            server,
            requests,
            updates,
            handed,
            pending: PendingRequests::new([self.patience]),
            account: Account::new(&route.service, counters.clone()),
        };
        let running = futures::future::join(carry(shutdown.clone()), server.run(shutdown.clone()));
        Ok(RouteTask { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let topic = facts.topic;
    let alone = pause("no_publisher", format!("nobody is there who calls {topic}"));
    silence::of_sending(facts, cause, (alone, "the last call has failed", format!("nobody has called {topic} yet")))
}

/// The warning about another server.
fn nearby(NearbyEndpoint { topic, .. }: &NearbyEndpoint<'_>) -> Option<String> {
    Some(format!("another node serves {topic} beside this bridge: a caller gets the reply of the quicker one"))
}

/// Knows who has called.
struct ServiceServer {
    robot: String,
    server: Box<dyn Server>,
    requests: Submitter,
    updates: UnboundedReceiver<SubmitUpdate>,
    handed: mpsc::Receiver<Handed>,
    pending: PendingRequests<Caller, 1>,
    account: Account,
}

impl ServiceServer {
    /// Runs until it is told to end, or the middleware ends.
    async fn run(mut self, mut shutdown: Shutdown) {
        loop {
            let due = self.pending.due();
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break,
                // Before replies: the id of a request is known before its reply can come. ROS 2 has no word for a rejection.
                Some(update) = self.updates.recv() => {
                    let _rejected = self.pending.update(update);
                }
                Some(Handed::Passed(passed)) = self.handed.recv() => self.reply(&passed),
                () = sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => self.expire(),
                request = self.server.next() => match request {
                    Some(request) => self.request(request),
                    None => break,
                },
            }
        }
        self.requests.close();
    }

    fn request(&mut self, Request { message, caller }: Request) {
        if self.pending.is_full(0) {
            return self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} calls wait for their replies"));
        }
        let Ok(sample) = Sample::new(CDR_LE, &message) else { return };
        let number = self.requests.submit(sample);
        self.pending.insert(0, number, caller, Instant::now());
    }

    /// Hands replies over to those who have called here; others are for other bridges.
    fn reply(&mut self, Passed { creator, samples, .. }: &Passed) {
        if self.account.refuses(creator, &self.robot) {
            return;
        }
        for (id, message) in samples.iter().filter_map(split) {
            if let Some(caller) = self.pending.replied(&id) {
                let replied = self.server.reply(&caller, &message);
                self.account.handed_over("a reply", replied);
            }
        }
    }

    /// Forgets the calls that have no reply.
    fn expire(&mut self) {
        for _caller in self.pending.expire(Instant::now()) {
            self.account.refuse("no_reply", "the robot has not replied in time");
        }
    }
}
