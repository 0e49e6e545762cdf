//! Tells the ledger which CAs this node carries, and the knowledge of its own disk. That is names and certificates from
//! before there was a ledger, and secrets that were made at this machine.

use super::authorities::lock;
use super::{EnrolmentService, Shared, json};
use ledger::msp::{self, ADOPTED_MAX, CarryCa, IssuedCertificate, KnownIdentity, LocalSecret, UncarryCa};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use std::time::Duration;

/// How often the disk is compared with the ledger.
const LOOK_EVERY: Duration = Duration::from_secs(10);
/// Pause after the ledger could not be told.
const RETRY_PAUSE: Duration = Duration::from_secs(1);

impl EnrolmentService {
    /// Keeps the ledger informed. Never ends.
    pub(crate) async fn keep_registered(self) {
        loop {
            let pause = match self.register_all().await {
                Ok(()) => LOOK_EVERY,
                Err(reason) => {
                    tracing::debug!(code = reason.code.name(), %reason, "registrations of this node's CA are not \
                                                                         recorded on the ledger yet");
                    RETRY_PAUSE
                }
            };
            tokio::time::sleep(pause).await;
        }
    }

    async fn register_all(&self) -> Result<(), Rejection> {
        self.blocking(|shared| shared.authorities.look()).await?;
        for organisation in self.shared.authorities.organisations() {
            if self.shared.ledger.msps().get(&organisation).is_some() {
                self.tell_carried(&organisation).await?;
            }
        }
        for organisation in self.shared.authorities.given_up() {
            let owner = organisation.clone();
            self.blocking(move |shared| shared.remove_dropped(&owner)).await?;
            if !self.carries(&organisation) && self.shared.is_carrier(&organisation)? {
                let uncarry = UncarryCa { organisation: organisation.clone(), node: None };
                (self.shared.client.submit)("uncarry_ca", json(&uncarry)?).await?;
            }
            self.shared.authorities.settle_given_up(&organisation);
        }
        Ok(())
    }

    /// Sees to it that the ledger knows that this node carries a CA, and everything that its disk knows.
    ///
    /// # Errors
    /// Why the ledger cannot be told.
    pub(super) async fn tell_carried(&self, organisation: &str) -> Result<(), Rejection> {
        let owner = organisation.to_owned();
        for carry in self.blocking(move |shared| shared.untold(&owner)).await? {
            (self.shared.client.submit)("carry_ca", json(&carry)?).await?;
        }
        Ok(())
    }
}

impl Shared {
    /// Does the ledger say that this node carries the CA?
    fn is_carrier(&self, organisation: &str) -> Result<bool, Rejection> {
        let carriers = msp::carriers(&**self.ledger.state())?;
        Ok(carriers.iter().any(|carrier| {
            carrier.organisation == organisation
                && carrier.node_organisation == self.own.me.organisation
                && carrier.node == self.own.me.name
        }))
    }

    /// The facts about this CA that the ledger lacks, in as many calls as it takes.
    fn untold(&self, organisation: &str) -> Result<Vec<CarryCa>, Rejection> {
        let authority = self.authority(organisation)?;
        let mut authority = lock(&authority);
        authority.refresh()?;
        let now = (self.clock)();
        let mut unknown = Vec::new();
        for (name, registered) in authority.identities() {
            let record = self.record(organisation, name)?;
            if record.as_ref().is_some_and(|record| record.role != registered.role) {
                continue;
            }
            let told =
                |fingerprint: &Hash| record.as_ref().is_some_and(|record| record.certificate(fingerprint).is_some());
            let certificates: Vec<_> = registered
                .certificates
                .iter()
                .filter(|issued| issued.not_after >= now && !told(&issued.fingerprint))
                .map(|issued| IssuedCertificate {
                    serial: hex::encode(&issued.serial),
                    issuer: issued.issuer,
                    fingerprint: issued.fingerprint,
                    not_before: issued.not_before,
                    not_after: issued.not_after,
                    via: String::new(),
                    recorded: 0,
                    revoked: false,
                })
                .collect();
            let secret = registered.open_secret(now).map(|(made, expires)| LocalSecret {
                at: self.own.me.full_name(),
                made,
                expires,
            });
            let is_new = |secret: &LocalSecret| match &record {
                Some(record) => record.voided < secret.made && record.local.as_ref() != Some(secret),
                None => true,
            };
            let secret = secret.filter(is_new);
            if !certificates.is_empty() || secret.is_some() {
                let (role, attributes) = (registered.role, registered.attributes.clone());
                unknown.push(KnownIdentity { name: name.to_owned(), role, attributes, secret, certificates });
            }
        }
        if unknown.is_empty() && self.is_carrier(organisation)? {
            return Ok(Vec::new());
        }
        let proof = authority.prove(&self.ledger.network(), &self.own.me.full_name());
        let mut calls: Vec<_> = unknown
            .chunks(ADOPTED_MAX)
            .map(|identities| CarryCa { identities: identities.to_vec(), ..proof.clone() })
            .collect();
        if calls.is_empty() {
            calls.push(proof);
        }
        Ok(calls)
    }
}
