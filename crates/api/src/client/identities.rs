//! The registry of the own organisation, which stands on the ledger: any node will do. And how another node comes to carry
//! the organisation's CA.

use super::uplink::Uplink;
use super::{Client, Committed};
use crate::report::accepted;
use crate::v1;
use bytes::Bytes;
use ledger::Page;
use ledger::msp::{CancelRegistration, IdentityRecord, NAME as MSP, Register, RevokeIdentity, RevokedIdentity};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ring::rand::SecureRandom;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::time::Duration;

/// For how long a one-time secret is good, unless something else is asked for.
pub const SECRET_LIFE: Duration = Duration::from_secs(7 * 24 * 3600);
/// Random bytes of a secret: 128 bits, so that guessing is hopeless.
const SECRET_BYTES: usize = 16;

/// A new registration.
#[derive(Clone, PartialEq, Eq)]
pub struct Registered {
    /// The one-time secret for the enrolment. It was made here, and the ledger has its hash alone.
    pub secret: String,
    /// The organisation that will issue the certificate.
    pub organisation: String,
    /// Until when the secret can be used, microseconds since the UNIX epoch.
    pub expires: u64,
}

impl Client {
    /// Registers a name with its role and attributes, as an admin of the organisation; the secret is good for a week.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::AlreadyRegistered`], [`Code::BadArgument`] for a name that nobody could enrol with;
    /// [`Code::Timeout`] if no answer came and it may have happened.
    pub async fn register(
        &self,
        name: &str,
        role: Role,
        attributes: &BTreeMap<String, String>,
    ) -> Result<Registered, Rejection> {
        self.register_for(name, Some(role), attributes, SECRET_LIFE).await
    }

    /// A new one-time secret for a registered name, whose role stays; attributes replace the old ones, none keep them.
    /// Certificates issued before stay valid until they expire or are revoked.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::NotFound`]; [`Code::Timeout`] as [`Client::register`].
    pub async fn reissue(&self, name: &str, attributes: &BTreeMap<String, String>) -> Result<Registered, Rejection> {
        self.register_for(name, None, attributes, SECRET_LIFE).await
    }

    /// As [`Client::register`], or without a role as [`Client::reissue`], with a secret that is good for so long.
    ///
    /// # Errors
    /// As these.
    pub async fn register_for(
        &self,
        name: &str,
        role: Option<Role>,
        attributes: &BTreeMap<String, String>,
        life: Duration,
    ) -> Result<Registered, Rejection> {
        let mut random = [0; SECRET_BYTES];
        self.random
            .fill(&mut random)
            .map_err(|_| Rejection::new(Code::Internal, "the system's source of randomness failed: no secret"))?;
        let secret = hex::encode(random);
        let expires = self.now().saturating_add(u64::try_from(life.as_micros()).unwrap_or(u64::MAX));
        let register = Register {
            name: name.to_owned(),
            role,
            attributes: attributes.clone(),
            secret: Hash::of(&[secret.as_bytes()]),
            expires,
            again: role.is_none(),
        };
        let done = self.invoke(MSP, "register", argument(&register)?).await.map_err(|refused| match refused.code {
            Code::Timeout => refused.next(format!(
                "ledgerctl identity show {name} shows whether it was registered; --reissue then creates another secret"
            )),
            _ => refused,
        })?;
        let record: IdentityRecord = read("register", &done.response)?;
        Ok(Registered { secret, organisation: record.organisation, expires })
    }

    /// The registered identities of the own organisation: of this name, or all for an empty one.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; else as [`Client::query`].
    pub async fn identities(&self, name: &str) -> Result<Vec<IdentityRecord>, Rejection> {
        if name.is_empty() {
            return self.list(MSP, "identities").await;
        }
        let answer = self.query(MSP, "identities", argument(&BTreeMap::from([("name", name)]))?).await?;
        Ok(read::<Page<_>>("identities", &answer.response)?.items)
    }

    /// Voids the secret of a name that has not enrolled with it.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; [`Code::NotFound`] if nothing is open.
    pub async fn cancel_registration(&self, name: &str) -> Result<(), Rejection> {
        let cancel = CancelRegistration { name: name.to_owned() };
        self.invoke(MSP, "cancel_registration", argument(&cancel)?).await.map(drop)
    }

    /// Revokes all certificates of a name and voids its secret, in one block; answers with its height as well.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; [`Code::NotFound`] if there is nothing to revoke.
    pub async fn revoke_identity(&self, name: &str, reason: &str) -> Result<(RevokedIdentity, Committed), Rejection> {
        let revoke = RevokeIdentity { name: name.to_owned(), reason: reason.to_owned() };
        let done = self.invoke(MSP, "revoke_identity", argument(&revoke)?).await?;
        Ok((read("revoke_identity", &done.response)?, done))
    }

    /// Asks the node that this client is connected to for a key with which it can receive the CA's.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::WrongRole`] if it is a node of another organisation; else as [`Client::status`].
    pub async fn offer_ca(&self, organisation: &str) -> Result<v1::OfferCaResponse, Rejection> {
        let ask = |up: Uplink| {
            let request = v1::OfferCaRequest { organisation: organisation.into() };
            async move { up.enrolment().offer_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await
    }

    /// Asks the node that this client is connected to to seal the CA's key for another node.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::CaElsewhere`], [`Code::Untrusted`]; else as [`Client::status`].
    pub async fn seal_ca(&self, offer: v1::SealCaRequest) -> Result<v1::SealCaResponse, Rejection> {
        let ask = |up: Uplink| {
            let request = offer.clone();
            async move { up.enrolment().seal_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await
    }

    /// Hands the sealed key to the node that this client is connected to. Good for being done again.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::BadSignature`] if it was sealed for another one; else as [`Client::status`].
    pub async fn take_ca(&self, taken: v1::TakeCaRequest) -> Result<(), Rejection> {
        let ask = |up: Uplink| {
            let request = taken.clone();
            async move { up.enrolment().take_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await.map(drop)
    }

    /// Asks the node that this client is connected to for a copy of the CA under a passphrase.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::CaElsewhere`], [`Code::BadArgument`] for a short passphrase; else as [`Client::status`].
    pub async fn copy_ca(&self, request: v1::CopyCaRequest) -> Result<Bytes, Rejection> {
        let ask = |up: Uplink| {
            let request = request.clone();
            async move { up.enrolment().copy_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await.map(|answer| answer.file)
    }

    /// Puts a copy of the CA back at the node that this client is connected to.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::WrongRole`], [`Code::BadFile`]; [`Code::AlreadyExists`] if the node carries it, also because
    /// an earlier try of this call arrived; else as [`Client::status`].
    pub async fn restore_ca(&self, request: v1::RestoreCaRequest) -> Result<(), Rejection> {
        let ask = |up: Uplink| {
            let request = request.clone();
            async move { up.enrolment().restore_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await.map(drop)
    }

    /// Removes the CA from the node that this client is connected to.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::LastOne`] if no other node carries it, [`Code::CaElsewhere`]; else as [`Client::status`].
    pub async fn drop_ca(&self, organisation: &str) -> Result<(), Rejection> {
        let ask = |up: Uplink| {
            let request = v1::DropCaRequest { organisation: organisation.into() };
            async move { up.enrolment().drop_ca(request).await }
        };
        self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await.map(drop)
    }
}

fn argument(value: &impl Serialize) -> Result<Vec<Bytes>, Rejection> {
    let text = serde_json::to_vec(value)
        .map_err(|error| Rejection::new(Code::Internal, "an argument cannot be encoded").found(error.to_string()))?;
    Ok(vec![text.into()])
}

fn read<T: DeserializeOwned>(function: &str, answer: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(answer).map_err(|error| {
        Rejection::new(Code::Internal, format!("the answer of msp {function} cannot be read")).found(error.to_string())
    })
}
