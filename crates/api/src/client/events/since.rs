//! Where a stream begins, by the word of the node that it is connected to now.

use super::ACCEPT_MAX;
use crate::client::uplink::Uplink;
use crate::v1;
use ledger_base::rejection::Rejection;
use tokio::time::{Instant, timeout};
use tonic::{Response, Status};

/// A block may carry a time this much before the moment at which it was ordered, microseconds: clocks differ, and the order takes
/// its time.
const EARLIER_MAX: u64 = 2_000_000;

/// The height of the newest block that the node has executed.
///
/// # Errors
/// Why it does not say.
pub(super) async fn height(up: &Uplink) -> Result<u64, Rejection> {
    match timeout(ACCEPT_MAX, up.gateway().status(v1::StatusRequest {})).await {
        Ok(Ok(status)) => Ok(status.into_inner().height),
        Ok(Err(refused)) => Err(up.connection.refusal(&refused)),
        Err(_) => Err(crate::connect::unreachable(&up.connection.address, "no answer to a status request")),
    }
}

/// The height of a current state, which has every committed block; none if no leader confirms it in time.
pub(super) async fn committed(up: &Uplink) -> Option<u64> {
    // Any function will do: a refusal tells the height as well.
    let question = v1::QueryRequest { chaincode: "msp".into(), function: "rules".into(), ..Default::default() };
    Some(in_time(up.gateway().query(question)).await?.height)
}

/// The first block that was ordered after a moment, or a little before it; `committed`: the newest one. By the clock of the node and
/// by block time, so that nothing depends on what another node has said. None if the node does not answer.
pub(super) async fn first_since(up: &Uplink, moment: Instant, committed: u64) -> Option<u64> {
    let status = in_time(up.gateway().status(v1::StatusRequest {})).await?;
    let age = u64::try_from(moment.elapsed().as_micros()).unwrap_or(u64::MAX);
    let since = status.clock.saturating_sub(age).saturating_sub(EARLIER_MAX);
    // The first one is in `from..=to`; a node does not give the blocks below `first_height` any more.
    let (mut from, mut to) = (status.first_height.max(1), committed.saturating_add(1));
    while from < to {
        let middle = from + (to - from) / 2;
        let block = in_time(up.gateway().get_block(v1::GetBlockRequest { height: middle })).await?;
        match block.time < since {
            true => from = middle + 1,
            false => to = middle,
        }
    }
    Some(from)
}

async fn in_time<A>(answer: impl Future<Output = Result<Response<A>, Status>>) -> Option<A> {
    Some(timeout(ACCEPT_MAX, answer).await.ok()?.ok()?.into_inner())
}
