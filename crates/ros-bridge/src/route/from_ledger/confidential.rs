//! The reader's side of a confidential service: the bridge enters with its reading key, and fetches the content keys that were
//! shared before it came. Those that follow come as events.

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger::transaction::Transaction;
use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;
use ledger_confidential::{Keyring, ReadingKey};
use ledger_contract::{Envelope, Readers};
use ledger_gate::{ABAC, guard::Block};
use serde::Deserialize;

use super::{FromLedger, late::block, told};
use crate::{
    count::line,
    gateway::{Gateway, ask},
};

/// How often it is looked whether the bridge is still a reader, with the certificate that it has now.
const LOOK_EVERY: Duration = Duration::from_secs(60);
/// The same after a message that could not be opened, or a try that failed.
const LOOK_SOON: Duration = Duration::from_secs(1);
/// Most content keys that are fetched at once.
const KEYS_MAX: usize = 16;
/// Arguments of `set` before the messages.
const SET_ARGUMENTS: usize = 3;

/// Blocks with content keys to come.
type Fetching = BoxFuture<'static, Result<Vec<Delivery>, Rejection>>;

/// A reader of a confidential service.
pub(super) struct Reading {
    /// The public half of the bridge's reading key.
    public: String,
    fetching: Option<Fetching>,
    looked: Option<Instant>,
    /// Was there a message that could not be opened?
    is_missing: bool,
}

/// The certificate with which the bridge calls.
#[derive(Deserialize)]
struct Caller {
    id: String,
    serial: String,
}

impl Reading {
    /// A key is missing: it is looked for soon.
    pub(super) fn missing(&mut self) {
        self.is_missing = true;
    }

    /// When to look next; none while it is being looked.
    pub(super) fn due(&self) -> Option<Instant> {
        let pause = if self.is_missing { LOOK_SOON } else { LOOK_EVERY };
        let due = self.looked.map_or_else(Instant::now, |looked| looked + pause);
        self.fetching.is_none().then_some(due)
    }

    /// Enters if that is needed, and fetches the newest content keys.
    pub(super) fn look(&mut self, gateway: Arc<dyn Gateway>, service: String) {
        self.looked = Some(Instant::now());
        self.fetching = Some(enter(gateway, service, self.public.clone()).boxed());
    }

    /// Waits for what is being fetched; for ever if there is nothing.
    pub(super) async fn fetched(&mut self) -> Result<Vec<Delivery>, Rejection> {
        let Some(fetching) = &mut self.fetching else { return std::future::pending().await };
        let fetched = fetching.await;
        self.fetching = None;
        self.is_missing = fetched.is_err();
        fetched
    }
}

impl FromLedger {
    /// Takes what the service is now: a reader's keys are there from when it is confidential.
    pub(super) fn read_confidential(&mut self) -> Result<(), Rejection> {
        if !self.service.confidential || self.reading.is_some() {
            return Ok(());
        }
        let own = ReadingKey::from_secret(&self.context.reading_secret()?)?;
        let name = format!("{}/{}", self.context.organisation, self.context.certificate()?.name()?);
        let keyring = Keyring::new(self.context.network, name, own);
        self.reading = Some(Reading { public: keyring.public_hex(), fetching: None, looked: None, is_missing: false });
        self.guard.read_with(keyring);
        Ok(())
    }

    /// When to look next whether all content keys are here.
    pub(super) fn keys_due(&self) -> Option<Instant> {
        self.reading.as_ref().and_then(Reading::due)
    }

    /// Looks whether all content keys are here.
    pub(super) fn look_for_keys(&mut self) {
        if let Some(reading) = &mut self.reading {
            reading.look(Arc::clone(&self.gateway), self.route.service.clone());
        }
    }

    /// Takes the content keys that were fetched.
    pub(super) async fn take_keys(&mut self, fetched: Result<Vec<Delivery>, Rejection>) {
        let deliveries = match fetched {
            Ok(deliveries) => deliveries,
            Err(refused) => {
                let reason = line(&refused);
                if let Some(not_logged) = self.complaint.worth("keys", Instant::now()) {
                    let service = &self.route.service;
                    tracing::warn!(
                        service,
                        code = refused.code.name(),
                        reason,
                        not_logged,
                        "the bridge cannot read this confidential service"
                    );
                }
                self.counters.lock().live.waiting = Some(format!("no content key of the service: {reason}"));
                return;
            }
        };
        for delivery in deliveries {
            let mut block = Block::latched(delivery.height, delivery.time);
            for event in &delivery.events {
                if let Some(act) = self.guard.told(&mut block, &told(event), self.clocks.now()) {
                    self.carry_out(act).await;
                }
            }
        }
    }
}

/// Waits for the content keys of a reader, if this is one; else for ever.
pub(super) async fn fetched(reading: &mut Option<Reading>) -> Result<Vec<Delivery>, Rejection> {
    match reading {
        Some(reading) => reading.fetched().await,
        None => std::future::pending().await,
    }
}

async fn enter(gateway: Arc<dyn Gateway>, service: String, public: String) -> Result<Vec<Delivery>, Rejection> {
    let height = gateway.height().await?;
    let (me, _): (Caller, u64) = ask(&*gateway, height, ABAC, "GetSubmittingClientIdentity", &[]).await?;
    let (known, _): (Readers, u64) = ask(&*gateway, height, ABAC, "readers", &[&service]).await?;
    let mut readers = known.readers.iter();
    if !readers.any(|reader| reader.reader == me.id && reader.key == public && reader.serial == me.serial) {
        gateway.invoke("reader", vec![Bytes::from(service.clone()), Bytes::from(public)]).await?;
        tracing::info!(service, reader = me.id, "entered as a reader of a confidential service");
    }
    fetch(&*gateway, &service, known.keys.iter().map(|place| place.key).collect()).await
}

/// Fetches the blocks in which content keys were shared, the newest of these heights.
async fn fetch(gateway: &dyn Gateway, service: &str, heights: BTreeSet<u64>) -> Result<Vec<Delivery>, Rejection> {
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
    let mut all = fetch(gateway, service, heights).await?;
    all.extend(messages);
    Ok(all)
}
