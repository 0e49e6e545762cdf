//! How a certificate is issued: the ledger says who may have one, this node signs it, the ledger records it, and only
//! then it is handed out. So one key uses up a secret, whichever nodes it is taken to. A second try with the same key
//! receives the same certificate from any of them.
//!
//! Secrets that were made at this machine are known here alone. They must also work while the network orders nothing,
//! or nobody who is locked out could come back. So their use is kept on this disk first, and recorded as soon as
//! possible.

use super::authorities::lock;
use super::{EnrolmentService, Shared, printable};
use crate::trust::ca;
use crate::trust::ca::{CertificateAuthority, PRESENTED_BYTES_MAX, secret};
use bytes::Bytes;
use ledger::msp::{self, Ground, IdentityRecord, RecordCertificate, Recorded};
use ledger_api::v1;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use std::net::IpAddr;
use std::sync::Arc;

/// The registration that a secret opens.
enum Opened {
    /// A registration on the ledger; with the hash of the secret.
    Ledger(Box<IdentityRecord>, Hash),
    /// One that was made at this machine, at this time.
    Local(u64),
}

impl EnrolmentService {
    /// Exchanges a secret for a certificate.
    ///
    /// # Errors
    /// [`Code::EnrolmentRefused`] alike for whatever is wrong with name and secret, [`Code::CaElsewhere`],
    /// [`Code::Overloaded`] for who guesses, [`Code::BadArgument`] for a bad request, and why the ledger cannot be
    /// asked.
    pub(super) async fn enrol_for(
        &self,
        source: IpAddr,
        request: v1::EnrolRequest,
    ) -> Result<v1::EnrolResponse, Rejection> {
        let (organisations, name) = self.shared.asked(&request.name)?;
        let name = name.to_owned();
        let mut opened = self.opened(&organisations, &name, &request.secret).await?;
        if opened.is_none() {
            self.shared.count_try(source)?;
            // What was registered a moment ago through another node may not have come here yet.
            (self.shared.client.catch_up)().await?;
            opened = self.opened(&organisations, &name, &request.secret).await?;
        }
        let Some((organisation, opened)) = opened else {
            tracing::warn!(name = printable(&name), %source, "enrolment rejected: unknown name or wrong secret");
            return Err(CertificateAuthority::refusal());
        };
        self.check_known(&organisation)?;
        let key = ca::public_key(&request.request)?;
        let told = self.tell_carried(&organisation).await;
        let certificate = match (opened, told) {
            (Opened::Ledger(record, sha256), Ok(())) => self.issue(*record, key, Ground::Secret(sha256)).await,
            (Opened::Local(made), told) if told.as_ref().err().is_none_or(is_unreachable) => {
                self.issue_local(&organisation, &name, made, &request).await
            }
            (_, told) => told.map(|()| Bytes::new()),
        }
        .inspect_err(|refused| {
            tracing::warn!(organisation, name = printable(&name), code = %refused.code, "enrolment rejected");
        })?;
        tracing::info!(organisation, name = printable(&name), "enrolled");
        Ok(self.shared.certified(&organisation, certificate))
    }

    /// A certificate for the key of a request, by the CA of the caller's organisation. The caller was verified, on a
    /// connection or because it is this node itself.
    ///
    /// # Errors
    /// [`Code::CaElsewhere`], [`Code::NotFound`] if the name is not registered, [`Code::WrongRole`],
    /// [`Code::LimitExceeded`] soon after the last certificate, and why the ledger cannot be asked.
    pub(crate) async fn renew_for(
        &self,
        caller: Arc<Identity>,
        request: Bytes,
    ) -> Result<v1::EnrolResponse, Rejection> {
        let Identity { organisation, name, role, .. } = &*caller;
        if self.shared.authorities.find(organisation).is_none() {
            return Err(self.shared.elsewhere(organisation));
        }
        let key = ca::public_key(&request)?;
        self.tell_carried(organisation).await?;
        let mut record = self.shared.record(organisation, name)?;
        if record.is_none() {
            (self.shared.client.catch_up)().await?;
            record = self.shared.record(organisation, name)?;
        }
        let Some(record) = record else {
            return Err(Rejection::new(Code::NotFound, format!("{name:?} is not registered at {organisation}"))
                .next("ask an admin of the organisation to register it and to send the one-time secret"));
        };
        if record.role != *role {
            return Err(Rejection::new(Code::WrongRole, format!("{name} is registered with another role"))
                .found(format!("a certificate with role {role}"))
                .wanted(format!("role {}", record.role))
                .next("ask an admin of the organisation for a new one-time secret"));
        }
        let certificate = self.issue(record, key, Ground::Renewal).await?;
        tracing::info!(name = caller.id(), "certificate renewed");
        Ok(self.shared.certified(organisation, certificate))
    }

    /// The registration that name and secret open here, and its organisation.
    async fn opened(
        &self,
        organisations: &[String],
        name: &str,
        presented: &str,
    ) -> Result<Option<(String, Opened)>, Rejection> {
        if presented.len() > PRESENTED_BYTES_MAX {
            return Ok(None);
        }
        let (organisations, name, presented) = (organisations.to_vec(), name.to_owned(), presented.to_owned());
        self.blocking(move |shared| {
            let (hash, mut found) = (secret::hash(&presented), None);
            for organisation in organisations {
                let record = shared.record(&organisation, &name)?;
                let opens = record.as_ref().and_then(|record| record.secret.as_ref());
                let opens = opens.is_some_and(|secret| secret::equal(&secret.sha256, &hash));
                let local = shared.opens_local(&organisation, &name, &presented, record.as_ref())?;
                if let (Some(record), true) = (record, opens) {
                    found.get_or_insert((organisation, Opened::Ledger(Box::new(record), hash)));
                } else if let Some(made) = local {
                    found.get_or_insert((organisation, Opened::Local(made)));
                }
            }
            Ok(found)
        })
        .await
    }

    /// Signs a certificate by what is registered, and hands it out once the ledger has recorded it: or the one that the
    /// ledger has recorded for the same key before.
    async fn issue(&self, record: IdentityRecord, key: PublicKey, ground: Ground) -> Result<Bytes, Rejection> {
        let (organisation, name) = (record.organisation.clone(), record.name.clone());
        match self.issue_once(record, &key, ground).await {
            // The registration was changed, and this node has not seen it.
            Err(stale) if stale.code == Code::WrongRole => {
                (self.shared.client.catch_up)().await?;
                let record = self.shared.record(&organisation, &name)?.ok_or(stale)?;
                self.issue_once(record, &key, ground).await
            }
            Err(refused) if refused.code == Code::EnrolmentRefused => Err(CertificateAuthority::refusal()),
            done => done,
        }
    }

    async fn issue_once(&self, record: IdentityRecord, key: &PublicKey, ground: Ground) -> Result<Bytes, Rejection> {
        let (organisation, key) = (record.organisation.clone(), key.clone());
        let der = self
            .blocking(move |shared| {
                let authority = shared.authority(&record.organisation)?;
                let authority = lock(&authority);
                authority.certify(&record.name, record.role, &record.attributes, &key, (shared.clock)())
            })
            .await?;
        self.record_certificate(&organisation, &der, ground).await
    }

    /// A certificate for a secret that was made at this machine.
    async fn issue_local(
        &self,
        organisation: &str,
        name: &str,
        made: u64,
        request: &v1::EnrolRequest,
    ) -> Result<Bytes, Rejection> {
        let (request, asked, owner) = (request.clone(), name.to_owned(), organisation.to_owned());
        let der = self
            .blocking(move |shared| {
                let authority = shared.authority(&owner)?;
                let der = lock(&authority).enrol(&asked, &request.secret, &request.request, (shared.clock)())?;
                // An answer that was lost is given again; not so once it was revoked, or has signed something.
                let certificate = Certificate::parse(&der)?;
                let issuer = certificate.issuer_name.hash();
                let used = shared.ledger.certificate(&Hash::of(&[&der]))?.is_some();
                if used || shared.ledger.is_revoked(&issuer, &certificate.serial)? {
                    return Err(CertificateAuthority::refusal());
                }
                Ok(der)
            })
            .await?;
        match self.record_certificate(organisation, &der, Ground::Local(made)).await {
            Err(refused) if refused.code == Code::EnrolmentRefused => Err(CertificateAuthority::refusal()),
            Err(unreachable) if is_unreachable(&unreachable) => {
                tracing::warn!(organisation, name, code = unreachable.code.name(), reason = %unreachable, "certificate \
                                                                                                           issued \
                                                                                                           from the \
                                                                                                           local \
                                                                                                           registry; \
                                                                                                           it will be \
                                                                                                           recorded \
                                                                                                           on the \
                                                                                                           ledger \
                                                                                                           later");
                Ok(der.into())
            }
            done => done,
        }
    }

    /// Brings a certificate to the ledger; answers with the one that counts.
    async fn record_certificate(&self, organisation: &str, der: &[u8], ground: Ground) -> Result<Bytes, Rejection> {
        let record = RecordCertificate { organisation: organisation.to_owned(), certificate: hex::encode(der), ground };
        let answer = (self.shared.client.submit)("record_certificate", super::json(&record)?).await?;
        let unreadable =
            |found: String| Rejection::new(Code::Internal, "the ledger's answer cannot be read").found(found);
        let recorded: Recorded = serde_json::from_slice(&answer).map_err(|error| unreadable(error.to_string()))?;
        hex::decode(recorded.certificate).map(Bytes::from).map_err(|error| unreadable(error.to_string()))
    }

    fn check_known(&self, organisation: &str) -> Result<(), Rejection> {
        if self.shared.ledger.msps().get(organisation).is_some() {
            return Ok(());
        }
        // The secret would be used up for a certificate that nobody can check yet.
        Err(Rejection::new(
            Code::Behind,
            format!(
                "this node does not yet have the block with which {organisation} \
                                                  joined"
            ),
        )
        .found(format!("block {}", self.shared.ledger.tip().height))
        .wanted("a node that is up to date with its network"))
    }

    /// Does this node carry the CA of that organisation?
    pub(crate) fn carries(&self, organisation: &str) -> bool {
        self.shared.authorities.find(organisation).is_some()
    }
}

/// The ledger cannot be asked at the moment.
fn is_unreachable(reason: &Rejection) -> bool {
    reason.code.class() == Class::Unreachable
}

impl Shared {
    /// The organisations whose registrations a name may mean, and the name alone.
    fn asked<'a>(&self, name: &'a str) -> Result<(Vec<String>, &'a str), Rejection> {
        let carried = self.authorities.organisations();
        match name.split_once('/') {
            Some((organisation, name)) if carried.iter().any(|carried| carried == organisation) => {
                Ok((vec![organisation.to_owned()], name))
            }
            Some((organisation, _)) if self.ledger.msps().get(organisation).is_some() => {
                Err(self.elsewhere(organisation))
            }
            // An organisation that does not exist is answered like a name that does not.
            Some((_, name)) => Ok((Vec::new(), name)),
            None if carried.is_empty() => Err(self.elsewhere(&self.own.me.organisation)),
            None => Ok((carried, name)),
        }
    }

    /// The registration of a name on the ledger.
    pub(super) fn record(&self, organisation: &str, name: &str) -> Result<Option<IdentityRecord>, Rejection> {
        msp::identity(&**self.ledger.state(), organisation, name)
    }

    /// Does the secret open a registration that was made at this machine, and that nobody has cancelled since? Answers
    /// with the time at which the secret was made.
    fn opens_local(
        &self,
        organisation: &str,
        name: &str,
        presented: &str,
        record: Option<&IdentityRecord>,
    ) -> Result<Option<u64>, Rejection> {
        let Some(authority) = self.authorities.find(organisation) else { return Ok(None) };
        let mut authority = lock(&authority);
        let Some(made) = authority.opens(name, presented, (self.clock)())? else { return Ok(None) };
        let role = authority.identity(name).map(|known| known.role).unwrap_or(Role::Member);
        match record {
            Some(record) if record.voided >= made => Ok(None),
            Some(record) if record.role != role => {
                Err(Rejection::new(Code::AlreadyRegistered, format!("{} is registered with another role", record.id()))
                    .found(format!("a secret for role {role}"))
                    .wanted(format!("role {}", record.role))
                    .next("choose another name: ledgerd admin-secret NAME"))
            }
            _ => Ok(Some(made)),
        }
    }

    fn certified(&self, organisation: &str, certificate: Bytes) -> v1::EnrolResponse {
        v1::EnrolResponse {
            verdict: Some(v1::Verdict::default()),
            certificate,
            // Our CAs sign with their root, which everybody has from the network.
            chain: Vec::new(),
            organisation: organisation.to_owned(),
            network: Some(self.network()),
            carriers: Vec::new(),
        }
    }
}
