//! The robot's side of calls: what passes the gate is called here, and the replies go to the ledger.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::gate::Passed;
use tokio::{sync::mpsc, time::sleep_until};

use crate::{
    graph::{
        dds::Exchange,
        endpoint::Role,
        local::{Client, Number, Reply},
        names::Interface,
    },
    routes::{
        calls::{Account, ClientHalves, PATIENCE, Submitter, Waiting, patience},
        ends::{CALLS_MAX, Hand, Handed, TOO_MANY, message_of, reply_to},
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        silence::{Cause, Facts, Silence, fault, pause},
    },
    shutdown::{Shutdown, requested},
};

/// The setting of how long the server is waited for.
const KEY: &str = "server_timeout_ms";

/// A client of the robot's own service.
pub(crate) static KIND: Kind = Kind {
    name: "service_client",
    carries: Interface::Service,
    right: "subscribe",
    other_end: Role::Subscriber,
    keys: &[KEY],
    read: |section: &mut Section<'_, '_>, _| Arc::new(Settings { patience: patience(section, KEY) }),
    discovered: Some(|_terms| Arc::new(Settings { patience: PATIENCE })),
    silence,
    nearby,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long the server is waited for.
    patience: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<RouteTask, Rejection> {
        let Opening { route, local, topic, mark, counters, shutdown, .. } = &opening;
        let exchange = Exchange::new(topic, &route.message);
        let client = local.middleware().client(&exchange, *mark, route.sample_bytes_max)?;
        let (hand, handed) = Hand::new(client.matched().clone());
        let ClientHalves { answers, carry } = ClientHalves::open(&opening, hand, CALLS_MAX).await?;
        let client = ServiceClient {
            client,
            handed,
            answers,
            waiting: Waiting::new(self.patience),
            account: Account::new(&route.service, counters.clone()),
        };
        let running = futures::future::join(carry(shutdown.clone()), client.run(shutdown.clone()));
        Ok(RouteTask { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let Facts { service, topic, .. } = facts;
    match cause {
        Cause::Alone => pause("no_subscriber", format!("nobody serves {topic}")),
        Cause::Refused { line, .. } => fault("gate", format!("the last call has failed: {line}")),
        Cause::NotHeld => pause("no_holder", format!("nobody holds {service}")),
        Cause::NothingCame => pause("no_message", "nobody has called yet".to_owned()),
    }
}

/// The warning about another client.
fn nearby(NearbyEndpoint { topic, is_same_service, .. }: &NearbyEndpoint<'_>) -> Option<String> {
    Some(if *is_same_service {
        format!("another bridge calls {topic} too: each call is made twice; stop one of both")
    } else {
        format!("a client beside this bridge of {topic}: its calls go around the ledger")
    })
}

/// Knows which request each call of the server is for.
struct ServiceClient {
    client: Box<dyn Client>,
    handed: mpsc::Receiver<Handed>,
    answers: Submitter,
    /// The ids of the requests' transactions.
    waiting: Waiting<Number, Hash>,
    account: Account,
}

impl ServiceClient {
    /// Runs until it is told to end, or the middleware ends.
    async fn run(mut self, mut shutdown: Shutdown) {
        loop {
            let due = self.waiting.due();
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => break,
                reply = self.client.next() => match reply {
                    Some(reply) => self.reply(&reply),
                    None => break,
                },
                () = sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => {
                    for _request in self.waiting.expire(Instant::now()) {
                        self.account.refuse("no_reply", "the server has not replied in time");
                    }
                }
                Some(Handed::Passed(passed)) = self.handed.recv() => self.call(&passed),
            }
        }
        self.answers.close();
    }

    fn call(&mut self, Passed { transaction, samples, .. }: &Passed) {
        // A reply names a transaction, so there is one call in each.
        let [sample] = samples.as_slice() else {
            return self.account.refuse("several_calls", "a transaction has more than one call");
        };
        if self.waiting.is_full() {
            return self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} calls wait for the server"));
        }
        let Some(message) = message_of(sample) else {
            return self.account.refuse("bad_payload", "it is no little endian CDR");
        };
        let called = self.client.call(&message);
        if let Some(number) = self.account.handed_over("a call", called) {
            self.waiting.insert(number, *transaction, Instant::now());
        }
    }

    fn reply(&mut self, Reply { number, message }: &Reply) {
        let Some(request) = self.waiting.take(number) else { return };
        if let Ok(sample) = reply_to(request, message) {
            self.answers.submit(sample);
        }
    }
}
