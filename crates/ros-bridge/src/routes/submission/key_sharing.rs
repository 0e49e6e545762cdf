//! The content key of a confidential service: shared with its readers, and again whenever they change.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, future::BoxFuture};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_confidential::Sealer;
use ledger_contract::{Keyed, Readers};
use ledger_gate::ABAC;

use super::own_grant::OwnGrant;
use crate::ledger::{
    gateway::{Gateway, ask, read},
    service::ask_service,
};

/// After a try that failed the next one waits so long.
const RETRY_PAUSE: Duration = Duration::from_millis(500);
/// A key that is not older is not replaced because readers come or go: it is good for longer.
const FRESH: Duration = Duration::from_millis(500);
/// Most tries in a row: readers may change between the question and the share.
const TRIES_MAX: usize = 4;

/// The content key to come; none if the service is not confidential.
type Making = BoxFuture<'static, Result<Option<Sealer>, Rejection>>;

/// Encrypts what goes to a confidential service.
pub(super) struct KeySharing {
    gateway: Arc<dyn Gateway>,
    network: Hash,
    is_confidential: bool,
    sealer: Option<Sealer>,
    making: Option<Making>,
    /// When the newest key was made.
    made_at: Option<Instant>,
    /// Why the last try led to no key, if it was refused.
    refusal: Option<Rejection>,
    /// When the last try led to no key.
    without: Option<Instant>,
}

impl KeySharing {
    /// For a service of which that is known.
    pub(super) fn new(gateway: Arc<dyn Gateway>, network: Hash, is_confidential: bool) -> Self {
        Self {
            gateway,
            network,
            is_confidential,
            sealer: None,
            making: None,
            made_at: None,
            refusal: None,
            without: None,
        }
    }

    /// The key to encrypt with, or none for a service that is not confidential.
    ///
    /// # Errors
    /// Why there is no key: [`Code::ReadersChanged`] while one is made, or as the ledger has refused it.
    pub(super) fn sealer(&self) -> Result<Option<&Sealer>, Rejection> {
        match &self.sealer {
            Some(sealer) => Ok(Some(sealer)),
            None if !self.is_confidential => Ok(None),
            None => Err(self.refusal.clone().unwrap_or_else(|| {
                Rejection::new(Code::ReadersChanged, "the content key is not shared yet")
                    .found("a confidential service")
                    .wanted("a content key that its readers have")
                    .next("wait; the bridge shares one as soon as it may")
            })),
        }
    }

    /// The name of the key to encrypt with.
    pub(super) fn key(&self) -> Option<u64> {
        self.sealer.as_ref().map(Sealer::key)
    }

    /// The ledger has refused messages that were encrypted under that key: its readers may have changed, or the service is
    /// confidential now, or not any more. A refusal of what was sent under an older key says nothing of this one.
    pub(super) fn refused(&mut self, publishing: &OwnGrant, refused: &Rejection, key: Option<u64>) {
        let is_without = self.is_confidential && key.is_none();
        let is_curable = is_without || matches!(refused.code, Code::ReadersChanged | Code::BadArgument);
        if is_curable && key == self.key() {
            self.renew(publishing);
        }
    }

    /// Makes a key for those who read now, unless one is being made, or there was none just now. A share asks for the right to
    /// publish.
    fn renew(&mut self, publishing: &OwnGrant) {
        let is_pause = self.without.is_some_and(|without| without.elapsed() < RETRY_PAUSE);
        if self.making.is_none() && !is_pause {
            let OwnGrant { service, me, epoch, as_of, .. } = publishing;
            let making = make(Arc::clone(&self.gateway), self.network, (service.clone(), me.clone()), (*epoch, *as_of));
            self.making = Some(making.boxed());
        }
    }

    /// Makes a key for those who read now, if the service is confidential and there is no fresh one. Readers that come and go all the
    /// time must not cost more than that.
    pub(super) fn renew_if_confidential(&mut self, publishing: &OwnGrant) {
        let is_fresh = self.made_at.is_some_and(|made| made.elapsed() < FRESH);
        if self.is_confidential && !is_fresh {
            self.renew(publishing);
        }
    }

    /// Waits for the key that is being made; for ever if there is none.
    pub(super) async fn made(&mut self) -> Result<(), Rejection> {
        let Some(making) = &mut self.making else { return std::future::pending().await };
        let made = making.await;
        self.making = None;
        self.without = (!matches!(made, Ok(Some(_)))).then(Instant::now);
        self.refusal = made.as_ref().err().cloned();
        let sealer = made?;
        self.is_confidential = sealer.is_some();
        self.made_at = sealer.as_ref().map(|_| Instant::now());
        self.sealer = sealer;
        Ok(())
    }
}

async fn make(
    gateway: Arc<dyn Gateway>,
    network: Hash,
    (service, me): (String, String),
    (epoch, height): (u64, u64),
) -> Result<Option<Sealer>, Rejection> {
    let (described, mut height) = ask_service(&*gateway, height, &service).await?;
    if !described.confidential {
        return Ok(None);
    }
    let mut tries = 0;
    loop {
        let (readers, at): (Readers, u64) = ask(&*gateway, height, ABAC, "readers", &[&service]).await?;
        height = at;
        let (share, fresh) = Sealer::share(&network, &me, &readers)?;
        let share = serde_json::to_vec(&share).unwrap_or_default();
        let args = vec![Bytes::from(service.clone()), Bytes::from(epoch.to_string()), Bytes::from(share)];
        match gateway.invoke("share", args).await {
            Ok(response) => {
                let keyed: Keyed = read("abac share", &response)?;
                tracing::info!(service, key = keyed.key, readers = keyed.readers, "content key shared");
                return Ok(Some(fresh.shared_at(keyed.key)));
            }
            Err(refused) if refused.code == Code::ReadersChanged && tries < TRIES_MAX => tries += 1,
            Err(refused) => return Err(refused),
        }
    }
}
