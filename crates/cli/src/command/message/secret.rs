//! Messages of confidential services: encrypted before they are sent, and opened by who is a reader.

use super::Senders;
use crate::answer;
use crate::session::{ABAC, Session, argument};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::{Subscription, v1};
use ledger_base::rejection::{Code, Rejection};
use ledger_confidential::{Keyring, ReadingKey, Sealer, Unreadable};
use ledger_contract::{Envelope, Keyed, Readers, ServiceState, Share};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::timeout;

/// The event of a content key that was shared.
pub(crate) const KEYED: &str = "keyed";
/// Most tries in a row to share a content key: readers may change between the question and the share.
const TRIES_MAX: usize = 5;
/// How long a block with a content key is waited for.
const BLOCK_TIME_MAX: Duration = Duration::from_secs(5);
/// How often the node says that it is alive meanwhile, in milliseconds.
const HEARTBEAT_MS: u32 = 500;

/// A publisher of a service, which may be confidential.
pub(crate) struct Sealing<'s> {
    session: &'s Session,
    service: String,
    epoch: u64,
    sealer: Option<Sealer>,
}

impl<'s> Sealing<'s> {
    /// Shares a content key with the readers, if the service is confidential.
    ///
    /// # Errors
    /// Those of `share`.
    pub(crate) async fn begin(session: &'s Session, service: &ServiceState, epoch: u64) -> Result<Self, Rejection> {
        let mut sealing = Self { session, service: service.service.clone(), epoch, sealer: None };
        if service.sharing.is_confidential() {
            sealing.share().await?;
        }
        Ok(sealing)
    }

    /// The message as it is sent.
    ///
    /// # Errors
    /// [`Code::Internal`] if the operating system gives no random bytes.
    pub(crate) fn seal(&self, sequence: u64, message: &Bytes) -> Result<Bytes, Rejection> {
        match &self.sealer {
            Some(sealer) => sealer.seal(self.epoch, sequence, message),
            None => Ok(message.clone()),
        }
    }

    /// May the message be sent again under another key, now that it was refused? Then that key is shared.
    ///
    /// # Errors
    /// Those of `share`.
    pub(crate) async fn renewed(&mut self, refused: &Rejection) -> Result<bool, Rejection> {
        let is_curable = refused.code == Code::ReadersChanged && self.sealer.is_some();
        if is_curable {
            self.share().await?;
        }
        Ok(is_curable)
    }

    async fn share(&mut self) -> Result<(), Rejection> {
        let (network, me) = (self.session.context().network, self.session.identity()?.id());
        let mut tries = 0;
        loop {
            let named = vec![Bytes::from(self.service.clone())];
            let readers: Readers = answer::parse(&self.session.ask(ABAC, "readers", named).await?, "readers")?;
            let (share, fresh) = Sealer::share(&network, &me, &readers)?;
            let args = vec![Bytes::from(self.service.clone()), Bytes::from(self.epoch.to_string()), argument(&share)?];
            match self.session.call(ABAC, "share", args).await {
                Ok(done) => {
                    let keyed: Keyed = answer::parse(&done.response, "a shared key")?;
                    self.sealer = Some(fresh.shared_at(keyed.key));
                    return Ok(());
                }
                Err(refused) if refused.code == Code::ReadersChanged && tries < TRIES_MAX => tries += 1,
                Err(refused) => return Err(refused),
            }
        }
    }
}

/// A reader of services, of which some are or were confidential.
pub(crate) struct Opening<'s> {
    session: &'s Session,
    /// None if no service is confidential.
    keyring: Option<Keyring>,
    /// Services and heights whose content keys were fetched, or are not to be had.
    fetched: BTreeSet<(String, u64)>,
}

impl<'s> Opening<'s> {
    /// Enters as a reader of those that are confidential.
    ///
    /// # Errors
    /// Those of `reader`; [`Code::BadFile`] if the context has no place for a reading key.
    pub(crate) async fn enter(
        session: &'s Session,
        services: impl Iterator<Item = &ServiceState>,
    ) -> Result<Self, Rejection> {
        let mut opening = Self { session, keyring: None, fetched: BTreeSet::new() };
        for service in services.filter(|service| service.sharing.is_confidential()) {
            opening.keyring = Some(match opening.keyring.take() {
                Some(keyring) => keyring,
                None => keyring(session)?,
            });
            enter(session, &service.service).await?;
        }
        Ok(opening)
    }

    /// Takes a content key that a publisher has shared.
    ///
    /// # Errors
    /// The fault of a signature or of its certificate.
    pub(crate) fn keyed(
        &mut self,
        height: u64,
        event: &v1::EventRecord,
        senders: &mut Senders<'_>,
    ) -> Result<(), Rejection> {
        let Some(keyring) = &mut self.keyring else { return Ok(()) };
        let transaction = Transaction::decode(event.transaction.clone())?;
        let publisher = senders.check(&transaction, &event.certificate)?.id();
        let body = transaction.body();
        let is_share = *body.network == keyring.network().0 && body.chaincode == ABAC && body.function == "share";
        if let Some(share) = body.args.get(2).filter(|_| is_share)
            && let Ok(share) = serde_json::from_slice::<Share>(share)
        {
            keyring.learn(&event.subject, &publisher, height, &share);
        }
        Ok(())
    }

    /// The message as its publisher wrote it, or why it cannot be read.
    ///
    /// # Errors
    /// The node's, while a content key is fetched.
    pub(crate) async fn open(
        &mut self,
        (service, sender): (&str, &str),
        (epoch, sequence): (u64, u64),
        payload: &Bytes,
        senders: &mut Senders<'_>,
    ) -> Result<Result<Bytes, String>, Rejection> {
        let Some(envelope) = Envelope::parse(payload) else { return Ok(Ok(payload.clone())) };
        if self.keyring.as_ref().is_some_and(|keyring| !keyring.has(service, sender, envelope.key))
            && self.fetched.insert((service.to_owned(), envelope.key))
        {
            self.fetch(service, envelope.key, senders).await?;
        }
        let unread = || Unreadable::NoKey(envelope.key);
        let keyring = self.keyring.as_ref().ok_or_else(unread);
        let opened = keyring.and_then(|keyring| keyring.open(service, sender, epoch, sequence, payload));
        Ok(opened.map_err(|unreadable| unreadable.to_string()))
    }

    /// Fetches the content keys that were shared at this height, before the stream began.
    async fn fetch(&mut self, service: &str, height: u64, senders: &mut Senders<'_>) -> Result<(), Rejection> {
        let mut stream = self.session.client.subscribe(Subscription {
            from_height: height,
            chaincode: ABAC.to_owned(),
            subjects: vec![service.to_owned()],
            names: vec![KEYED.to_owned()],
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        let first = async {
            loop {
                let delivery = stream.next().await?;
                if delivery.height >= height && !delivery.events.is_empty() {
                    return Ok::<_, Rejection>(delivery);
                }
            }
        };
        // A height without a key, or a node without the block: then the message stays unread.
        let Ok(Ok(delivery)) = timeout(BLOCK_TIME_MAX, first).await else { return Ok(()) };
        for event in delivery.events.iter().filter(|_| delivery.height == height) {
            self.keyed(height, event, senders)?;
        }
        Ok(())
    }
}

/// The own reading key, and no content key yet.
fn keyring(session: &Session) -> Result<Keyring, Rejection> {
    let own = ReadingKey::from_secret(&session.context().reading_secret()?)?;
    Ok(Keyring::new(session.context().network, session.identity()?.id(), own))
}

/// Enters as a reader of a service, unless we are one with this key and this certificate. Answers if that changed anything.
///
/// # Errors
/// Those of `reader`; [`Code::BadFile`] if the context has no place for a reading key.
pub(crate) async fn enter(session: &Session, service: &str) -> Result<bool, Rejection> {
    let (keyring, me) = (keyring(session)?, session.identity()?);
    let (key, serial) = (keyring.public_hex(), hex::encode(&me.serial));
    let named = Bytes::from(service.to_owned());
    let known: Readers = answer::parse(&session.ask(ABAC, "readers", vec![named.clone()]).await?, "readers")?;
    let id = me.id();
    if known.readers.iter().any(|reader| reader.reader == id && reader.key == key && reader.serial == serial) {
        return Ok(false);
    }
    session.call(ABAC, "reader", vec![named, Bytes::from(key)]).await?;
    Ok(true)
}
