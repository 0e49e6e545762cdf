//! A node comes to carry the CA of its organisation in three steps. It offers a key made for this purpose, a node that
//! carries the CA seals the CA's key for it, and it takes that. An admin of the organisation brings it from one to the
//! other, and cannot read it.

use super::authorities::lock;
use super::{EnrolmentService, Shared};
use crate::trust::ca::CertificateAuthority;
use crate::trust::ca::seal::{Delivery, Receiver};
use bytes::Bytes;
use ledger::msp::{self, NodeRole};
use ledger_api::v1;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger_identity::key::SigningKey;
use ledger_identity::msp::Usage;
use ledger_identity::{Identity, Role};
use std::sync::Arc;

/// How long after it was made a key can be sealed for, microseconds.
const OFFER_LIFE_MAX: u64 = 10 * 60 * 1_000_000;
/// Separates the node's signature under an offer from everything else that it signs.
const SIGNATURE_DOMAIN: &[u8] = b"ledgerd offer to carry a CA v1\0";

/// A key that was made for one delivery.
pub(super) struct Offer {
    organisation: String,
    receiver: Receiver,
    made: u64,
}

impl EnrolmentService {
    /// This node is ready to carry the CA of the caller's organisation.
    pub(super) fn offer(&self, admin: &Identity, organisation: &str) -> Result<v1::OfferCaResponse, Rejection> {
        let shared = &self.shared;
        shared.check_own(admin, organisation)?;
        if shared.own.me.organisation != organisation {
            return Err(Rejection::new(
                Code::WrongRole,
                format!("this node may not hold the CA key of {organisation}"),
            )
            .found(format!("node {}", shared.own.me.full_name()))
            .wanted(format!("a node of {organisation}"))
            .next(format!("ledgerctl ca carry NODE, with a node of {organisation}")));
        }
        let receiver = Receiver::generate();
        let (key, node) = (receiver.public(), shared.own.me.full_name());
        let own = shared.own.identity.own();
        let signature = own.key.sign(&signed_bytes(&shared.ledger.network(), organisation, &node, &key));
        let certificate = Bytes::copy_from_slice(own.certificate());
        let offer = Offer { organisation: organisation.to_owned(), receiver, made: (shared.clock)() };
        *shared.offer.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(offer);
        Ok(v1::OfferCaResponse {
            verdict: Some(v1::Verdict::default()),
            node,
            key: key.into(),
            signature: signature.into(),
            certificate,
        })
    }

    /// Seals the key of the caller's CA for a node of the same organisation that has offered to carry it.
    pub(super) async fn seal(
        &self,
        admin: Arc<Identity>,
        request: v1::SealCaRequest,
    ) -> Result<v1::SealCaResponse, Rejection> {
        self.shared.check_own(&admin, &request.organisation)?;
        self.shared.check_offer(&request)?;
        let node = request.node.clone();
        let (sealed, root) = self
            .blocking(move |shared| {
                let authority = shared.authority(&request.organisation)?;
                let authority = lock(&authority);
                let delivery = Delivery {
                    network: &shared.ledger.network(),
                    organisation: &request.organisation,
                    node: &request.node,
                    root: authority.root(),
                };
                let sealed = delivery.seal(&request.key, authority.key().to_pkcs8_der())?;
                Ok((sealed, authority.root().to_vec()))
            })
            .await?;
        tracing::warn!(by = admin.id(), node, "CA key encrypted for another node, which will also hold it");
        Ok(v1::SealCaResponse { verdict: Some(v1::Verdict::default()), sealed: sealed.into(), root: root.into() })
    }

    /// Takes the key of a CA that was sealed for this node, stores it, and tells the ledger.
    pub(super) async fn take(&self, admin: &Identity, request: v1::TakeCaRequest) -> Result<(), Rejection> {
        let organisation = request.organisation.clone();
        self.shared.check_own(admin, &organisation)?;
        if !self.carries(&organisation) {
            self.blocking(move |shared| shared.take(&request)).await?;
            tracing::warn!(
                by = admin.id(),
                organisation,
                "received the CA key; this node issues certificates from \
                                                           now on"
            );
        }
        self.tell_carried(&organisation).await
    }
}

impl Shared {
    /// An admin decides about the CA of their own organisation only.
    pub(super) fn check_own(&self, admin: &Identity, organisation: &str) -> Result<(), Rejection> {
        if admin.organisation == organisation {
            return Ok(());
        }
        Err(Rejection::new(Code::NotAdmin, format!("{} may not choose the nodes that hold this CA key", admin.id()))
            .found(format!("an admin of {}", admin.organisation))
            .wanted(format!("an admin of {}", super::printable(organisation))))
    }

    /// The offer is by a node of the organisation, as the ledger knows it now.
    fn check_offer(&self, offer: &v1::SealCaRequest) -> Result<(), Rejection> {
        let v1::SealCaRequest { organisation, node, key, signature, certificate } = offer;
        let refused = |found: String| {
            Rejection::new(Code::Untrusted, "the CA key cannot be encrypted for this node")
                .found(found)
                .wanted(format!("an offer that a node of {organisation} has signed"))
                .next("ledgerctl ca carry NODE")
        };
        if certificate.len() > CERTIFICATE_BYTES_MAX {
            return Err(refused(format!("a certificate of {} bytes", certificate.len())));
        }
        let identity = self.ledger.msps().verify_for(Usage::Server, certificate, &[], (self.clock)())?;
        self.ledger.check_revoked(&identity)?;
        let nodes = msp::nodes(&**self.ledger.state())?;
        let present = nodes.iter().any(|record| {
            record.role != NodeRole::Removed
                && record.organisation == *organisation
                && record.name == identity.name
                && identity.organisation == *organisation
        });
        if identity.role != Role::Node || identity.id() != *node || !present {
            return Err(refused(format!(
                "{} with role {}, which is not a node of that organisation",
                identity.id(),
                identity.role
            )));
        }
        let message = signed_bytes(&self.ledger.network(), organisation, node, key);
        identity.public_key.verify(&message, signature).map_err(|error| refused(error.to_string()))
    }

    fn take(&self, request: &v1::TakeCaRequest) -> Result<(), Rejection> {
        let v1::TakeCaRequest { organisation, sealed, root } = request;
        let bad = |found: &str| {
            Rejection::new(Code::BadArgument, "this node cannot receive the CA key")
                .found(found)
                .next("ledgerctl ca carry NODE starts the transfer again")
        };
        let msps = self.ledger.msps();
        if !msps.get(organisation).is_some_and(|msp| msp.roots().any(|known| known == root)) {
            return Err(bad("a root certificate that the ledger does not list for the organisation"));
        }
        let now = (self.clock)();
        let mut offer = self.offer.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let current = offer
            .as_ref()
            .filter(|offer| offer.organisation == *organisation && now.saturating_sub(offer.made) <= OFFER_LIFE_MAX);
        let current = current.ok_or_else(|| bad("no key for this transfer, or one that is several minutes old"))?;
        let (network, node) = (self.ledger.network(), self.own.me.full_name());
        let delivery = Delivery { network: &network, organisation, node: &node, root };
        let key = current.receiver.open(&delivery, sealed)?;
        let key = SigningKey::from_pkcs8_der(&key).map_err(|error| bad(&error.to_string()))?;
        if Certificate::parse(root)?.public_key_info != key.public_key().to_spki() {
            return Err(bad("the key of another CA"));
        }
        let directory = self.authorities.directory(organisation);
        self.authorities.add(CertificateAuthority::install(&directory, organisation, &key, root)?);
        self.authorities.settle_given_up(organisation);
        *offer = None;
        Ok(())
    }
}

fn signed_bytes(network: &Hash, organisation: &str, node: &str, key: &[u8]) -> Vec<u8> {
    let mut bytes = SIGNATURE_DOMAIN.to_vec();
    for part in [&network.0[..], organisation.as_bytes(), node.as_bytes(), key] {
        bytes.extend_from_slice(&(part.len() as u64).to_be_bytes());
        bytes.extend_from_slice(part);
    }
    bytes
}
