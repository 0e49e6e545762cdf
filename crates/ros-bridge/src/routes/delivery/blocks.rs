//! Single blocks of the past: messages, and the content keys of what is encrypted in them.

use std::{collections::BTreeSet, time::Duration};

use futures::StreamExt;
use ledger::transaction::Transaction;
use ledger_api::{Subscription, v1::Delivery};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Envelope;
use ledger_gate::ABAC;
use tokio::time::timeout;

use crate::ledger::gateway::{Gateway, HEARTBEAT_MS};

/// How long a block may take.
const BLOCK_TIME_MAX: Duration = Duration::from_secs(5);
/// Most content keys that are fetched at once.
const KEYS_MAX: usize = 16;
/// Arguments of `set` before the messages.
const SET_ARGUMENTS: usize = 3;

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
            .next("look at ledgerctl status")
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

/// Fetches the blocks in which content keys were shared, the newest of these heights.
pub(super) async fn keys(
    gateway: &dyn Gateway,
    service: &str,
    heights: BTreeSet<u64>,
) -> Result<Vec<Delivery>, Rejection> {
    let mut fetched = Vec::new();
    for height in heights.into_iter().rev().take(KEYS_MAX) {
        fetched.extend(block(gateway, service, "keyed", height).await?);
    }
    Ok(fetched)
}

/// These blocks of messages, and before them the blocks with the content keys of what is encrypted in them.
///
/// # Errors
/// Those of [`block`].
pub(super) async fn with_keys(
    gateway: &dyn Gateway,
    service: &str,
    messages: Vec<Delivery>,
) -> Result<Vec<Delivery>, Rejection> {
    let heights = messages.iter().flat_map(|delivery| &delivery.events).flat_map(|event| {
        let decoded = Transaction::decode(event.transaction.clone()).ok();
        let args = decoded.map(|transaction| transaction.body().args.clone()).unwrap_or_default();
        args.into_iter().skip(SET_ARGUMENTS).filter_map(|payload| Some(Envelope::parse(&payload)?.key))
    });
    let heights = heights.collect();
    let mut all = keys(gateway, service, heights).await?;
    all.extend(messages);
    Ok(all)
}
