//! For those who come late to a latched feed: the last messages of its publishers, as they are in their blocks.

use std::{collections::BTreeSet, sync::Arc};

use futures::{FutureExt, future::BoxFuture};
use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;
use ledger_contract::Latest;
use ledger_gate::{ABAC, guard::Block};

use super::FromLedger;
use crate::{
    graph::qos::Durability,
    ledger::gateway::{Gateway, ask},
    log::one_line,
    routes::delivery::blocks::{block, with_keys},
};

/// Most blocks that are fetched: one for each publisher, the newest.
const BLOCKS_MAX: usize = 16;

impl FromLedger {
    /// Where somebody listens to a latched feed: fetches the last messages of its publishers.
    pub(super) fn fetch_late(&self) -> Option<BoxFuture<'static, Result<Vec<Delivery>, Rejection>>> {
        let is_latched = self.outputs.qos.borrow().durability == Durability::TransientLocal;
        let is_wanted = is_latched && self.demand.is_there() && !self.service.is_command();
        is_wanted.then(|| fetch(Arc::clone(&self.gateway), self.route.service.clone()).boxed())
    }

    /// Hands out what was fetched, as far as the gate lets it pass.
    pub(super) async fn deliver_late(&mut self, fetched: Result<Vec<Delivery>, Rejection>) {
        let service = &self.route.service;
        let deliveries = fetched.inspect_err(|refused| {
            let reason = one_line(refused);
            tracing::warn!(
                service,
                code = refused.code.name(),
                reason,
                "the last messages are not to be had: the next ones come as they are said"
            );
        });
        for delivery in deliveries.unwrap_or_default() {
            self.judge(Block::latched(delivery.height, delivery.time), &delivery).await;
        }
    }
}

/// Fetches the blocks, in their order. The node may show older ones, or none: the gate decides on each message.
///
/// # Errors
/// The ledger's refusal: a node may keep no blocks that are so old.
async fn fetch(gateway: Arc<dyn Gateway>, service: String) -> Result<Vec<Delivery>, Rejection> {
    let height = gateway.height().await?;
    let (latest, _): (Vec<Latest>, u64) = ask(&*gateway, height, ABAC, "latest", &[&service]).await?;
    let heights: BTreeSet<u64> = latest.iter().take(BLOCKS_MAX).map(|latest| latest.height).collect();
    let mut fetched = Vec::with_capacity(heights.len());
    for height in heights {
        fetched.extend(block(&*gateway, &service, "message", height).await?);
    }
    with_keys(&*gateway, &service, fetched).await
}
