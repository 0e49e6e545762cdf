//! The half of a route of calls that comes from the ledger.

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;
use ledger_gate::{gate::Settings as GateSettings, service::Service};
use tokio::sync::watch;

use super::{
    route::{FromLedger, Outputs},
    settings::Settings,
};
use crate::{
    routes::{
        counters::Counters,
        ends::{Hand, Outlet, REPLY_BYTES},
        kind::{Opening, RouteConfig},
        shown::HolderTopic,
    },
    shutdown::Shutdown,
};

/// Opens the half of a route of calls that comes from the ledger: what passes the gate is handed over.
///
/// # Errors
/// The cause that keeps it from opening.
pub(in crate::routes) async fn half(
    opening: &Opening<'_>,
    service: Service,
    hand: Hand,
    counters: Counters,
) -> Result<impl FnOnce(Shutdown) -> BoxFuture<'static, ()> + use<>, Rejection> {
    let Opening { route, context, local, topic, mark, .. } = opening;
    let usual = Settings::default();
    let settings = Settings { stale_after: hand.stale_after().unwrap_or(usual.stale_after), ..usual };
    let gate = GateSettings {
        network: context.network,
        sample_bytes_max: route.sample_bytes_max.saturating_add(REPLY_BYTES),
        max_age: settings.max_age,
        stale_after: settings.stale_after,
        command_timeout: None,
    };
    let route = RouteConfig { service: service.service.clone(), ..(*route).clone() };
    // There is nothing to follow.
    let (_none, qos) = watch::channel(route.qos);
    let outputs = async {
        let points = settings.points.open(local, topic, *mark).await?;
        let holder = HolderTopic::open(None, std::iter::empty(), local, *mark).await?;
        Ok(Outputs { outlet: Outlet::Calls(hand), qos, points, holder })
    };
    let opened = FromLedger::open(opening, (route, settings.clone()), gate, service, counters, outputs).await?;
    Ok(move |shutdown| opened.run(shutdown).boxed())
}
