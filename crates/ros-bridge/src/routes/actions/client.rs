//! The robot's side of actions: goals that pass the gate are set here, and what the robot says of them goes to the ledger.
//!
//! A goal whose right has ended is cancelled, and again each second until the robot says that it has ended. So is a goal that an
//! earlier bridge has left, and one whose server has left and comes back.

mod earlier;
mod feedback;
mod goal_runner;

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::service::Service;

use self::{earlier::EarlierGoals, feedback::FeedbackBuffer, goal_runner::ActionClient};
use super::{
    goals::Goals,
    parts::Parts,
    patience::{RESULT_KEY, RESULT_PATIENCE, RUN_MS_MAX, result_patience},
    topics::{ActionTopic, feedback, status},
};
use crate::{
    graph::{
        dds::Exchange, endpoint::Role, local::InputSettings, loop_filter::LoopFilter, names::Interface, queue::Limits,
    },
    ledger::robot_state::RobotStateQuery,
    routes::{
        calls::{Account, ClientHalves, PATIENCE, Waiting, patience},
        clocks::Clocks,
        delivery::{STALE_AFTER, STALE_KEY, stale_after},
        ends::{CALLS_MAX, Hand},
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        silence::{Cause, Facts, Silence, fault, pause},
    },
};

/// The setting of how long the server is waited for.
const KEY: &str = "server_timeout_ms";
/// The setting of how long a goal may run.
const GOAL_KEY: &str = "goal_timeout_ms";
/// The setting of how often feedback goes to the ledger.
const RATE_KEY: &str = "feedback_rate_hz";
/// Shortest `goal_timeout_ms`.
const GOAL_MS_MIN: u64 = 100;
/// Highest `feedback_rate_hz`.
const RATE_HZ_MAX: u64 = 1000;
const RATE_HZ_DEFAULT: u32 = 10;
/// Most replies and feedback that wait to go to the ledger.
const ANSWERS_MAX: usize = 4 * CALLS_MAX;

/// A client of the robot's own action.
pub(crate) static KIND: Kind = Kind {
    name: "action_client",
    carries: Interface::Action,
    right: "subscribe",
    other_end: Role::Subscriber,
    keys: &[KEY, RESULT_KEY, GOAL_KEY, RATE_KEY, STALE_KEY],
    read: |section: &mut Section<'_, '_>, _| Arc::new(Settings::read(section)),
    discovered: Some(|_terms| {
        Arc::new(Settings {
            patience: PATIENCE,
            results: RESULT_PATIENCE,
            goal: None,
            feedback_every: Duration::from_secs(1) / RATE_HZ_DEFAULT,
            stale_after: STALE_AFTER,
        })
    }),
    silence,
    nearby,
};

/// The settings of this kind.
#[derive(Debug)]
struct Settings {
    /// How long the server is waited for.
    patience: Duration,
    /// How long a result is waited for.
    results: Duration,
    /// How long a goal may run; none for as long as it takes.
    goal: Option<Duration>,
    /// Between two times that feedback goes to the ledger.
    feedback_every: Duration,
    /// Silence of the ledger after which goals are cancelled.
    stale_after: Duration,
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>> {
        self.join(opening).boxed()
    }
}

impl Settings {
    fn read(section: &mut Section<'_, '_>) -> Self {
        let (mut goal_ms, mut rate_hz) = (None, RATE_HZ_DEFAULT);
        section.integer(GOAL_KEY, GOAL_MS_MIN..=RUN_MS_MAX, &mut goal_ms);
        section.integer(RATE_KEY, 1..=RATE_HZ_MAX, &mut rate_hz);
        Self {
            patience: patience(section, KEY),
            results: result_patience(section),
            goal: goal_ms.map(Duration::from_millis),
            feedback_every: Duration::from_secs(1) / rate_hz.max(1),
            stale_after: stale_after(section),
        }
    }

    async fn join(&self, opening: Opening<'_>) -> Result<RouteTask, Rejection> {
        let Opening { route, local, service, topic, mark, counters, shutdown, query, .. } = &opening;
        let (came, clocks) = (Instant::now(), Clocks::start());
        let earlier = EarlierGoals::new(Some(clocks.now().wall));
        let middleware = local.middleware();
        let open = |exchange: Exchange| middleware.client(&exchange, *mark, route.sample_bytes_max);
        let clients = Parts::open(topic, &route.message, open)?;
        let max_age = Duration::from_millis(service.max_age_ms);
        let input = async |told: ActionTopic| {
            let limits = Limits { queue_samples_max: CALLS_MAX, ..route.limits() };
            let filter = Arc::new(LoopFilter::new(*mark, &route.service, max_age, Arc::clone(local.delivered())));
            let ActionTopic { topic, message, qos } = told;
            middleware.input(&InputSettings { topic, message, limits, filter: Some(filter) }, &qos).await
        };
        let (feedback, status) = (input(feedback(topic, &route.message)?).await?, input(status(topic)?).await?);
        let (hand, handed, rests) = Hand::until_rest(clients.matched().clone(), self.stale_after);
        let ClientHalves { answers, carry } = ClientHalves::open(&opening, hand, ANSWERS_MAX).await?;
        let is_used = may_be_used(service.clone(), Arc::clone(query), came);
        let client = ActionClient {
            clients,
            feedback,
            status,
            handed,
            rests,
            known: 0,
            answers,
            waiting: Waiting::new(self.patience),
            results: Waiting::new(self.results),
            goals: Goals::new(self.goal),
            servers: 0,
            earlier,
            clocks,
            said: FeedbackBuffer::new(self.feedback_every),
            account: Account::new(&route.service, counters.clone()),
            service: route.service.clone(),
        };
        let running = futures::future::join(carry(shutdown.clone()), client.run(shutdown.clone(), is_used));
        Ok(RouteTask { in_memory: None, running: running.map(drop).boxed() })
    }
}

/// May goals have been set through the ledger before that moment? Where the voters do not say how the service stands, they may.
async fn may_be_used(service: Service, asker: Arc<RobotStateQuery>, since: Instant) -> bool {
    let is_new = |service: &Service| service.epoch == 0 && service.needs_grant();
    if !is_new(&service) {
        return true;
    }
    let answer = asker.ask(since, &BTreeSet::new()).await;
    let certified = answer.and_then(|answered| answered.standing.service(&service.service));
    !certified.is_ok_and(|certified| is_new(&certified))
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let Facts { service, topic, .. } = facts;
    match cause {
        Cause::Alone => pause("no_subscriber", format!("no action server is there for {topic}")),
        Cause::Refused { line, .. } => fault("gate", format!("the last request has failed: {line}")),
        Cause::NotHeld => pause("no_holder", format!("nobody holds {service}")),
        Cause::NothingCame => pause("no_message", "nobody has set a goal yet".to_owned()),
    }
}

/// The warning about another client.
fn nearby(NearbyEndpoint { topic, is_same_service, .. }: &NearbyEndpoint<'_>) -> Option<String> {
    Some(if *is_same_service {
        format!("another bridge sets goals on {topic} too: each goal is set twice; stop one of both")
    } else {
        format!("a client beside this bridge of {topic}: its goals go around the ledger")
    })
}
