//! The reader's side of a confidential service: the bridge enters with its reading key, and fetches the content keys that were
//! shared before it came. Those that follow come as events.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;
use ledger_contract::Readers;
use ledger_gate::ABAC;
use serde::Deserialize;

use super::blocks;
use crate::ledger::gateway::{Gateway, ask};

/// How often it is looked whether the bridge is still a reader, with the certificate that it has now.
const LOOK_EVERY: Duration = Duration::from_secs(60);
/// The same after a message that could not be opened, or a try that failed.
const LOOK_SOON: Duration = Duration::from_secs(1);

/// Blocks with content keys to come.
type Fetching = BoxFuture<'static, Result<Vec<Delivery>, Rejection>>;

/// A reader of a confidential service.
pub(super) struct ReaderKeys {
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

impl ReaderKeys {
    /// With the public half of the bridge's reading key. Nothing is fetched yet.
    pub(super) fn new(public: String) -> Self {
        Self { public, fetching: None, looked: None, is_missing: false }
    }

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

/// Waits for the content keys of a reader, if this is one; else for ever.
pub(super) async fn fetched(reading: &mut Option<ReaderKeys>) -> Result<Vec<Delivery>, Rejection> {
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
    blocks::keys(&*gateway, &service, known.keys.iter().map(|place| place.key).collect()).await
}
