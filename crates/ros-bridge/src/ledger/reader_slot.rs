//! The place of a subscriber, where an owner limits their number: taken when the ledger asks for one, and kept while its
//! messages are read. It ends with its lease.

use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_api::{Client, EventStream, Subscription, v1::Delivery};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Acquired, readers};
use ledger_gate::ABAC;
use tokio::time::{sleep, sleep_until};

/// How long a subscription rests that was refused for good: rights may come back.
const REFUSED_REST: Duration = Duration::from_secs(1);
/// A place is renewed when this part of its lease is over.
const RENEW_AT: u32 = 3;

/// A subscription that takes a place where it needs one.
pub(crate) struct SlotSubscription {
    client: Client,
    events: EventStream,
    /// The services whose messages are read.
    services: Vec<String>,
    /// When the places are renewed.
    renew: Option<Instant>,
    /// The renewal under way.
    renewal: Option<BoxFuture<'static, Option<Duration>>>,
    refused: bool,
}

impl SlotSubscription {
    pub(crate) fn start(client: &Client, wanted: Subscription) -> Self {
        let services = wanted.subjects.iter().filter(|subject| subject.contains('/')).cloned().collect();
        let events = client.subscribe(wanted);
        Self { client: client.clone(), events, services, renew: None, renewal: None, refused: false }
    }

    /// The next delivery. An error is followed by more, some time later.
    pub(crate) async fn next(&mut self) -> Result<Delivery, Rejection> {
        if self.refused {
            sleep(REFUSED_REST).await;
        }
        loop {
            let renew = self.renew;
            tokio::select! {
                delivery = self.events.next() => {
                    let lacks_place = matches!(&delivery, Err(refused) if refused.code == Code::NotHolder);
                    if lacks_place && let Some(lease) = acquire(self.client.clone(), self.services.clone()).await {
                        self.held_for(Some(lease));
                        continue;
                    }
                    self.refused = delivery.is_err();
                    return delivery;
                }
                lease = async { self.renewal.as_mut()?.await }, if self.renewal.is_some() => {
                    self.renewal = None;
                    self.held_for(lease);
                }
                () = sleep_until(renew.unwrap_or_else(Instant::now).into()), if renew.is_some() => {
                    self.renew = None;
                    self.renewal = Some(acquire(self.client.clone(), self.services.clone()).boxed());
                }
            }
        }
    }

    /// The places are held for so long, if they are.
    fn held_for(&mut self, lease: Option<Duration>) {
        self.renew = lease.map(|lease| Instant::now() + lease / RENEW_AT);
    }
}

/// Takes or renews the places. Answers with the shortest lease; nothing if one of them is not to be had now.
async fn acquire(client: Client, services: Vec<String>) -> Option<Duration> {
    let mut lease: Option<u64> = None;
    for service in services {
        let done = client.invoke(ABAC, "acquire", vec![Bytes::from(readers(&service))]).await;
        let granted = done.ok().and_then(|done| serde_json::from_slice(&done.response).ok());
        let Some(Acquired::Granted(grant)) = granted else {
            tracing::debug!(service, "no subscriber slot available");
            return None;
        };
        lease = Some(lease.map_or(grant.lease_ms, |lease| lease.min(grant.lease_ms)));
    }
    lease.map(Duration::from_millis)
}
