//! The half of a route of calls that goes to the ledger.

use std::sync::Arc;

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;
use tokio::sync::mpsc;

use super::{route::ToLedger, settings::Settings};
use crate::{
    graph::queue::Queue,
    ledger::gateway::Gateway,
    routes::{
        counters::Counters,
        ends::{Inlet, SubmitUpdate},
    },
    shutdown::Shutdown,
};

/// Opens the half of a route of calls that goes to the ledger: each sample is a transaction of its own. `updates` hears which one,
/// by the sample's number.
///
/// # Errors
/// The cause that keeps it from opening.
pub(in crate::routes) async fn half(
    gateway: Arc<dyn Gateway>,
    service: &str,
    calls: Arc<Queue>,
    updates: Option<mpsc::UnboundedSender<SubmitUpdate>>,
    counters: Counters,
) -> Result<impl FnOnce(Shutdown) -> BoxFuture<'static, ()> + use<>, Rejection> {
    let opened = ToLedger::open(gateway, service, Inlet::Calls(calls), &Settings::default(), counters).await?;
    Ok(move |shutdown| opened.of_calls(updates).run(shutdown).boxed())
}
