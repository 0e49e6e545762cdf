//! Renewal: the next certificate before the present one runs out, proved by the present one.

mod stored;

pub use stored::Renewed;

use crate::certification::{CONNECT_MAX, DOORS_MAX, request};
use crate::clock::now;
use crate::connect::{Connection, Credentials};
use crate::report::accepted;
use crate::tls::TlsIdentity;
use crate::v1::enrolment_client::EnrolmentClient;
use crate::v1::{EnrolResponse, RenewRequest};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::SigningKey;
use ledger_identity::msp::Msps;
use ring::rand::SystemRandom;
use rustls_pki_types::CertificateDer;
use std::sync::Arc;

/// A key that was made here for the next certificate of an identity.
pub struct Renewal {
    present: TlsIdentity,
    /// The subject of the present certificate, for messages.
    name: String,
    key: Arc<SigningKey>,
    request: Bytes,
}

impl Renewal {
    /// Makes a key of the same kind as the present one, and the request to certify it.
    ///
    /// # Errors
    /// [`Code::Internal`] if the system has no randomness, [`Code::Malformed`] and others if the present certificate
    /// cannot be read.
    pub fn begin(present: &TlsIdentity) -> Result<Self, Rejection> {
        let own = present.own();
        let name = Certificate::parse(own.certificate())?.subject;
        let key = SigningKey::generate(own.key.kind(), &SystemRandom::new())
            .map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        let request = request(&name, &key)?;
        Ok(Self { present: present.clone(), name, key: Arc::new(key), request })
    }

    /// The certificate signing request (PKCS #10, DER).
    pub fn request(&self) -> Bytes {
        self.request.clone()
    }

    /// The key.
    pub fn key(&self) -> &Arc<SigningKey> {
        &self.key
    }

    /// Asks the nodes in turn, and those that they name, until one that carries the CA answers.
    ///
    /// # Errors
    /// The answer of the last node, or of the first that knew more than that it carries no CA.
    pub async fn ask(
        &self,
        nodes: &[String],
        credentials: &Credentials,
        msps: &Msps,
    ) -> Result<TlsIdentity, Rejection> {
        let mut refused = Rejection::new(Code::NotFound, "no known node could renew the certificate");
        let (mut doors, mut next) = (nodes.to_vec(), 0);
        while let Some(address) = doors.get(next).cloned() {
            next += 1;
            let reason = match self.ask_one(&address, credentials).await {
                Ok(answer) => match accepted(answer.verdict.as_ref()) {
                    Ok(()) => return self.finish(&answer.certificate, msps),
                    Err(reason) => {
                        let room = (nodes.len() + DOORS_MAX).saturating_sub(doors.len());
                        let unknown: Vec<_> =
                            answer.carriers.into_iter().filter(|door| !doors.contains(door)).take(room).collect();
                        doors.extend(unknown);
                        reason
                    }
                },
                Err(reason) => reason,
            };
            if matches!(refused.code, Code::NotFound | Code::Unreachable | Code::CaElsewhere) {
                refused = reason;
            }
        }
        Err(refused)
    }

    async fn ask_one(&self, address: &str, credentials: &Credentials) -> Result<EnrolResponse, Rejection> {
        let own = Bytes::copy_from_slice(self.present.own().certificate());
        let connection =
            Connection::open((address, Some(&credentials.network)), Arc::clone(&credentials.tls), &own, CONNECT_MAX)
                .await?;
        let mut client = EnrolmentClient::new(connection.channel.clone());
        let answer = client.renew(RenewRequest { request: self.request() }).await;
        answer.map(tonic::Response::into_inner).map_err(|status| connection.refusal(&status))
    }

    /// Checks what the CA has certified: our key, for the same identity. The rest of the chain stays.
    ///
    /// # Errors
    /// [`Code::Untrusted`] if it is something else.
    pub fn finish(&self, certificate: &[u8], msps: &Msps) -> Result<TlsIdentity, Rejection> {
        self.finish_at(certificate, msps, now())
    }

    /// As [`Renewal::finish`], by a clock that need not be this machine's: microseconds since the UNIX epoch.
    ///
    /// # Errors
    /// As [`Renewal::finish`].
    pub fn finish_at(&self, certificate: &[u8], msps: &Msps, now: u64) -> Result<TlsIdentity, Rejection> {
        let unfit = |found: String| {
            Rejection::new(Code::Untrusted, "the certificate does not match the request")
                .found(found)
                .wanted(format!("a certificate of {:?} with our new key", self.name))
                .next("inform the admin of the organisation; the current certificate stays in use")
        };
        let own = self.present.own();
        let renewed = msps.verify(certificate, own.chain.get(1..).unwrap_or_default(), now)?;
        let before = Certificate::parse(own.certificate())?;
        if renewed.public_key != self.key.public_key() {
            return Err(unfit(format!("the key {:?}", renewed.public_key)));
        }
        let after = Certificate::parse(certificate)?;
        if (&after.subject_name, &after.issuer_name) != (&before.subject_name, &before.issuer_name) {
            return Err(unfit(format!("{:?}, issued by another CA or for another name", after.subject)));
        }
        let mut chain = own.chain.clone();
        if let Some(first) = chain.first_mut() {
            *first = CertificateDer::from(certificate.to_vec());
        }
        TlsIdentity::new(chain, Arc::clone(&self.key)).map_err(|error| unfit(error.to_string()))
    }
}

impl std::fmt::Debug for Renewal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Renewal").field("name", &self.name).finish_non_exhaustive()
    }
}
