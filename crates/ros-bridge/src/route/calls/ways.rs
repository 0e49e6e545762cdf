//! The ways between callers in the local graph and the ledger, for services and actions alike.

use std::sync::Arc;

use futures::{
    FutureExt,
    future::{BoxFuture, join},
};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::replies;
use ledger_gate::service::Service;
use tokio::sync::mpsc::{self, UnboundedReceiver};

use super::{CALLS_MAX, Hand, Handed, Told};
use crate::{
    count::Counters,
    dds::Matched,
    queue::{Limits, Queue},
    route::{
        Stop,
        kind::{self, Opening},
    },
    service::ask_service,
};

/// The ends at the local graph.
pub(in crate::route) struct Ways {
    /// Requests that go to the ledger.
    pub(in crate::route) requests: Arc<Queue>,
    /// The fate of each at the ledger.
    pub(in crate::route) told: UnboundedReceiver<Told>,
    /// The robot's answers.
    pub(in crate::route) handed: mpsc::Receiver<Handed>,
}

/// The service on which the robot answers. `called` is what is called: a service or an action.
///
/// # Errors
/// As the ledger refuses; without that service nothing can be called.
pub(in crate::route) async fn answers_of(opening: &Opening<'_>, called: &str) -> Result<Service, Rejection> {
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

impl Ways {
    /// Opens both. They carry while the second value runs. `callers`: those in the local graph.
    ///
    /// # Errors
    /// The cause that keeps a half from opening.
    pub(in crate::route) async fn open(
        opening: &Opening<'_>,
        answers: Service,
        callers: &Matched,
    ) -> Result<(Self, impl FnOnce(Stop) -> BoxFuture<'static, ()> + use<>), Rejection> {
        let Opening { route, gateway, service, counters, .. } = opening;
        counters.opened(callers, None);
        counters.lock().live.needs_grant = service.needs_grant() && service.is_command();
        let requests = Queue::new(&Limits { queue_samples_max: CALLS_MAX, ..route.limits() });
        let (tell, told) = mpsc::unbounded_channel();
        let (gateway, calls) = (Arc::clone(gateway), Arc::clone(&requests));
        let to = kind::submitted(gateway, &route.service, calls, Some(tell), counters.clone()).await?;
        let (hand, handed) = Hand::new(callers.clone());
        let from =
            kind::gated(opening, answers, hand, Counters::new(route).traced(opening.counters.tracer.clone())).await?;
        let carry = move |stop: Stop| join(to(stop.clone()), from(stop)).map(drop).boxed();
        Ok((Self { requests, told, handed }, carry))
    }
}
