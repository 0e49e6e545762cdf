//! For those who come late to a latched feed: the last messages of its publishers, as they are in their blocks.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use futures::{FutureExt, StreamExt, future::BoxFuture};
use ledger_api::{Subscription, v1::Delivery};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Latest;
use ledger_gate::{ABAC, guard::Block};
use tokio::time::timeout;

use super::{FromLedger, confidential::with_keys, told};
use crate::{
    config::HEARTBEAT_MS,
    count::line,
    gateway::{Gateway, ask},
    qos::Durability,
};

/// Most blocks that are fetched: one for each publisher, the newest.
const BLOCKS_MAX: usize = 16;
/// How long each may take.
const BLOCK_TIME_MAX: Duration = Duration::from_secs(5);

impl FromLedger {
    /// Where somebody listens to a latched feed: fetches the last messages of its publishers.
    pub(super) fn fetch_late(&self) -> Option<BoxFuture<'static, Result<Vec<Delivery>, Rejection>>> {
        let is_latched = self.qos.borrow().durability == Durability::TransientLocal;
        let is_wanted = is_latched && self.demand.is_there() && !self.service.is_command();
        is_wanted.then(|| fetch(Arc::clone(&self.gateway), self.route.service.clone()).boxed())
    }

    /// Hands out what was fetched, as far as the gate lets it pass.
    pub(super) async fn deliver_late(&mut self, fetched: Result<Vec<Delivery>, Rejection>) {
        let service = &self.route.service;
        let deliveries = fetched.inspect_err(|refused| {
            let reason = line(refused);
            tracing::warn!(
                service,
                code = refused.code.name(),
                reason,
                "the last messages are not to be had: the next ones come as they are said"
            );
        });
        for delivery in deliveries.unwrap_or_default() {
            let mut block = Block::latched(delivery.height, delivery.time);
            for event in &delivery.events {
                if let Some(act) = self.guard.told(&mut block, &told(event), self.clocks.now()) {
                    self.carry_out(act).await;
                }
            }
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

/// The events of a service with that name in one block; none if there are none.
///
/// # Errors
/// The ledger's refusal; [`Code::Timeout`].
pub(super) async fn block(
    gateway: &dyn Gateway,
    service: &str,
    name: &str,
    height: u64,
) -> Result<Option<Delivery>, Rejection> {
    timeout(BLOCK_TIME_MAX, events(gateway, service, name, height)).await.map_err(|_| {
        Rejection::new(Code::Timeout, format!("block {height} does not come"))
            .found(format!("nothing within {} s", BLOCK_TIME_MAX.as_secs()))
            .wanted(format!("the events {name:?} of {service}"))
    })?
}

async fn events(gateway: &dyn Gateway, service: &str, name: &str, height: u64) -> Result<Option<Delivery>, Rejection> {
    let mut deliveries = gateway.subscribe(Subscription {
        from_height: height,
        chaincode: ABAC.to_owned(),
        subjects: vec![service.to_owned()],
        names: vec![name.to_owned()],
        heartbeat: HEARTBEAT_MS,
        ..Subscription::default()
    });
    while let Some(delivery) = deliveries.next().await {
        let delivery = delivery?;
        // A sign of life may come from before.
        if delivery.height >= height && !delivery.events.is_empty() {
            return Ok(Some(delivery).filter(|delivery| delivery.height == height));
        }
    }
    Ok(None)
}
