//! The two halves of a route of calls: what the local part submits goes to the ledger, and what passes the gate comes back. They
//! are those of routes of messages. On both sides of services and actions they are opened here.

use futures::{
    FutureExt,
    future::{BoxFuture, join},
};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::replies;
use ledger_gate::service::Service;
use tokio::sync::mpsc::{self, UnboundedReceiver, UnboundedSender};

use super::submitter::Submitter;
use crate::{
    graph::{
        dds::Matched,
        queue::{Limits, Queue},
    },
    ledger::service::ask_service,
    routes::{
        counters::Counters,
        delivery,
        ends::{CALLS_MAX, Hand, Handed, SubmitUpdate},
        kind::Opening,
        submission,
    },
    shutdown::Shutdown,
};

/// Runs both halves until they are told to end.
type Carry = Box<dyn FnOnce(Shutdown) -> BoxFuture<'static, ()> + Send>;

/// Where a server of the local graph meets the ledger.
pub(in crate::routes) struct ServerHalves {
    /// Requests that go to the ledger.
    pub(in crate::routes) requests: Submitter,
    /// The verdict on each at the ledger.
    pub(in crate::routes) updates: UnboundedReceiver<SubmitUpdate>,
    /// The robot's answers.
    pub(in crate::routes) handed: mpsc::Receiver<Handed>,
    /// Carries them.
    pub(in crate::routes) carry: Carry,
}

/// Where a client of the local graph meets the ledger.
pub(in crate::routes) struct ClientHalves {
    /// Answers that go to the ledger.
    pub(in crate::routes) answers: Submitter,
    /// Carries them, and the requests.
    pub(in crate::routes) carry: Carry,
}

/// The half that submits.
struct Submits<'a> {
    service: &'a str,
    waiting_max: usize,
    updates: Option<UnboundedSender<SubmitUpdate>>,
    counters: Counters,
}

/// The half behind the gate.
struct Delivers {
    service: Service,
    hand: Hand,
    counters: Counters,
}

/// The service on which the robot answers. `called` is what is called: a service or an action.
///
/// # Errors
/// As the ledger refuses; without that service nothing can be called.
pub(in crate::routes) async fn answers_of(opening: &Opening<'_>, called: &str) -> Result<Service, Rejection> {
    let asked = ask_service(&*opening.gateway, 0, &replies(&opening.route.service)).await;
    asked.map(|(answers, _)| answers).map_err(|refused| {
        if refused.code != Code::UnknownService {
            return refused;
        }
        refused.next(format!(
            "the owner registers it with the {called}: ledgerctl robot add does so for types of {called}s"
        ))
    })
}

impl ServerHalves {
    /// Requests go to the route's service, and `answers` come from the robot. `callers`: those in the local graph.
    ///
    /// # Errors
    /// The cause that keeps a half from opening.
    pub(in crate::routes) async fn open(
        opening: &Opening<'_>,
        answers: Service,
        callers: &Matched,
    ) -> Result<Self, Rejection> {
        let Opening { route, service, counters, .. } = opening;
        counters.opened(callers, None);
        counters.lock().live.needs_grant = service.needs_grant() && service.is_command();
        let (tell, updates) = mpsc::unbounded_channel();
        let (hand, handed) = Hand::new(callers.clone());
        let submits = Submits {
            service: &route.service,
            waiting_max: CALLS_MAX,
            updates: Some(tell),
            counters: counters.clone(),
        };
        let delivers = Delivers { service: answers, hand, counters: counters.apart() };
        let (requests, carry) = open(opening, submits, delivers).await?;
        Ok(Self { requests, updates, handed, carry })
    }
}

impl ClientHalves {
    /// Requests to the route's service go to `hand`, and at most so many answers wait to go to the ledger.
    ///
    /// # Errors
    /// As [`ServerHalves::open`].
    pub(in crate::routes) async fn open(
        opening: &Opening<'_>,
        hand: Hand,
        waiting_max: usize,
    ) -> Result<Self, Rejection> {
        let Opening { route, service, counters, .. } = opening;
        counters.opened(hand.matched(), None);
        let answered = replies(&route.service);
        let submits = Submits { service: &answered, waiting_max, updates: None, counters: counters.apart() };
        let delivers = Delivers { service: service.clone(), hand, counters: counters.clone() };
        let (answers, carry) = open(opening, submits, delivers).await?;
        Ok(Self { answers, carry })
    }
}

async fn open(
    opening: &Opening<'_>,
    Submits { service, waiting_max, updates, counters }: Submits<'_>,
    delivers: Delivers,
) -> Result<(Submitter, Carry), Rejection> {
    let queue = Queue::new(&Limits { queue_samples_max: waiting_max, ..opening.route.limits() });
    let submitter = Submitter::new(queue.clone());
    let to = submission::half(opening.gateway.clone(), service, queue, updates, counters).await?;
    let from = delivery::half(opening, delivers.service, delivers.hand, delivers.counters).await?;
    let carry = move |stop: Shutdown| join(to(stop.clone()), from(stop)).map(drop).boxed();
    Ok((submitter, Box::new(carry)))
}
