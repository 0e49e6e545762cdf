//! The user's side of calls: the bridge is the server of the local graph. Requests go to the ledger, and a reply of the robot goes
//! to who has called.
//!
//! A reply counts only if the gate lets it pass, the robot's own identity has signed it, and it names a request of this bridge.
//! ROS 2 has no word for a refusal by somebody between: then the caller gets no reply, and the log says why.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::{
    gate::Passed,
    sample::{CDR_LE, Sample},
};
use tokio::time::sleep_until;

use super::{
    Stop,
    calls::{Account, CALLS_MAX, Handed, PATIENCE, TOO_MANY, Told, Waiting, Ways, answers_of, patience, split},
    kind::{Beside, Kind, Opened, Opening, Plan},
    silence::{self, Cause, Facts, Silence, pause},
    stopped,
};
use crate::{
    dds::{Caller, Exchange, Request, Role, Server},
    names::Interface,
    queue::Incoming,
};

/// The setting of how long a reply is waited for.
const KEY: &str = "reply_timeout_ms";

/// The local server of a robot's service.
pub(super) static KIND: Kind = Kind {
    name: "service_server",
    carries: Interface::Service,
    right: "publish",
    other_end: Role::Publisher,
    keys: &[KEY],
    read: |section: &mut Section<'_, '_>, _| Arc::new(Settings { patience: patience(section, KEY) }),
    discovered: Some(|_terms| Arc::new(Settings { patience: PATIENCE })),
    silence,
    beside,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long a reply is waited for.
    patience: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<Opened, Rejection> {
        let answers = answers_of(&opening, "service").await?;
        let Opening { route, local, service, topic, mark, counters, stop, .. } = &opening;
        let exchange = Exchange::new(topic, &route.message);
        let server = local.participant().server(&exchange, *mark, route.sample_bytes_max)?;
        let (ways, carry) = Ways::open(&opening, answers, server.matched()).await?;
        let desk = Desk {
            robot: service.robot.clone(),
            server,
            ways,
            waiting: Waiting::new(self.patience),
            ids: BTreeMap::new(),
            last: 0,
            account: Account::new(&route.service, counters.clone()),
        };
        let running = futures::future::join(carry(stop.clone()), desk.run(stop.clone()));
        Ok(Opened { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let topic = facts.topic;
    let alone = pause("no_publisher", format!("nobody is there who calls {topic}"));
    silence::of_sending(facts, cause, (alone, "the last call has failed", format!("nobody has called {topic} yet")))
}

/// The warning about another server.
fn beside(Beside { topic, .. }: &Beside<'_>) -> Option<String> {
    Some(format!("another node serves {topic} beside this bridge: a caller gets the reply of the quicker one"))
}

/// A call of somebody in the local graph.
struct Call {
    caller: Caller,
    /// The transaction in which it goes to the ledger.
    id: Option<Hash>,
}

/// Knows who has called.
struct Desk {
    robot: String,
    server: Server,
    ways: Ways,
    waiting: Waiting<u64, Call>,
    /// The numbers of the calls by the ids of their transactions.
    ids: BTreeMap<Hash, u64>,
    /// The number of the last call.
    last: u64,
    account: Account,
}

impl Desk {
    /// Runs until it is told to end, or the middleware ends.
    async fn run(mut self, mut stop: Stop) {
        loop {
            let due = self.waiting.due();
            tokio::select! {
                biased;
                () = stopped(&mut stop) => break,
                // Before replies: the id of a request is known before its reply can come.
                Some(told) = self.ways.told.recv() => self.hear(told),
                Some(Handed::Passed(passed)) = self.ways.handed.recv() => self.reply(&passed),
                () = sleep_until(due.unwrap_or_else(Instant::now).into()), if due.is_some() => self.expire(),
                request = self.server.next() => match request {
                    Some(request) => self.request(request),
                    None => break,
                },
            }
        }
        self.ways.requests.close();
    }

    fn request(&mut self, Request { message, caller }: Request) {
        if self.waiting.is_full() {
            return self.account.refuse(TOO_MANY, &format!("{CALLS_MAX} calls wait for their replies"));
        }
        let Ok(sample) = Sample::new(CDR_LE, &message) else { return };
        let sequence = self.last.saturating_add(1);
        self.last = sequence;
        self.waiting.insert(sequence, Call { caller, id: None }, Instant::now());
        self.ways.requests.push(Incoming::own(sample, sequence));
    }

    fn hear(&mut self, told: Told) {
        match told {
            Told::Submitted(number, id) => {
                if let Some(call) = self.waiting.get_mut(&number) {
                    call.id = Some(id);
                    self.ids.insert(id, number);
                }
            }
            Told::Refused(number) => {
                if let Some(Call { id: Some(id), .. }) = self.waiting.take(&number) {
                    self.ids.remove(&id);
                }
            }
        }
    }

    /// Hands replies over to those who have called here; others are for other bridges.
    fn reply(&mut self, Passed { creator, samples, .. }: &Passed) {
        if self.account.refuses(creator, &self.robot) {
            return;
        }
        for (id, message) in samples.iter().filter_map(split) {
            let call = self.ids.remove(&id).and_then(|number| self.waiting.take(&number));
            let Some(Call { caller, .. }) = call else { continue };
            match self.server.reply(&caller, &message) {
                Ok(()) => self.account.published(),
                Err(error) => self.account.unpublished("a reply", &error),
            }
        }
    }

    /// Forgets the calls that nobody has answered.
    fn expire(&mut self) {
        for Call { id, .. } in self.waiting.expire(Instant::now()) {
            if let Some(id) = id {
                self.ids.remove(&id);
            }
            self.account.refuse("no_reply", "the robot has not replied in time");
        }
    }
}
