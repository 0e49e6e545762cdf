//! The API of the CAs that a node carries: the service `Enrolment` of `enrolment.proto`.
//!
//! | file | what |
//! |---|---|
//! | `issuing` | a secret, or a certificate that is still good, becomes a certificate |
//! | `registrar` | tells the ledger which CAs this node carries, and what its disk knows |
//! | `carrying` | the key of a CA goes to another node |
//! | `keeping` | a copy of a CA for the safe, and back; its end at one node when it moves |
//! | `joining` | what an invited organisation has signed is brought to the ledger |
//! | `authorities`, `ledger_client`, `tries` | the CAs of this node; how it calls the ledger; who tries too often |
//!
//! A client without a certificate may ask for the network and may enrol. A refusal takes as long for a name that exists
//! as for one that does not.

mod authorities;
mod carrying;
mod issuing;
mod joining;
mod keeping;
mod ledger_client;
mod registrar;
#[cfg(test)]
mod tests;
mod tries;

pub(crate) use authorities::{Authorities, given_up_file, lock};
pub(crate) use ledger_client::LedgerClient;
pub(crate) use tries::Tries;

use crate::ordering::directory::{Directory, Member};
use crate::ordering::waiters::known_hash;
use crate::process::caller::Caller;
use crate::trust::ca::CertificateAuthority;
use bytes::Bytes;
use carrying::Offer;
use ledger::Ledger;
use ledger::msp::{self, CarrierRecord, NodeRole};
use ledger::network::Genesis;
use ledger_api::context::units_on_the_wire;
use ledger_api::tls::TlsIdentity;
use ledger_api::v1;
use ledger_api::v1::enrolment_server::Enrolment;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, NAME_BYTES_MAX, Role};
use serde::Serialize;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::Instant;
use tonic::{Request, Response, Status};

/// A refused try to enrol is answered no sooner than this after it came, so that nobody learns from the time what was
/// wrong.
const REFUSAL_TIME: Duration = Duration::from_millis(100);

/// The service; see the module.
#[derive(Clone)]
pub(crate) struct EnrolmentService {
    shared: Arc<Shared>,
}

struct Shared {
    own: OwnNode,
    /// Calls the ledger as this node.
    client: LedgerClient,
    /// One request to join at a time.
    carrying: Semaphore,
    authorities: Arc<Authorities>,
    ledger: Arc<Ledger>,
    genesis: Genesis,
    /// The same, byte for byte.
    document: Bytes,
    /// The node's clock, microseconds since the UNIX epoch.
    clock: fn() -> u64,
    tries: Mutex<Tries>,
    /// The key that was made last to receive a CA's key.
    offer: Mutex<Option<Offer>>,
}

/// The node that serves the API.
pub(crate) struct OwnNode {
    /// This node.
    pub me: Member,
    /// Its certificate and key.
    pub identity: TlsIdentity,
    /// The present members of the network.
    pub directory: Arc<Directory>,
    /// Can this node have nothing ordered at the moment?
    pub cut_off: Box<dyn Fn() -> bool + Send + Sync>,
    /// How far the clocks of most voters are ahead of this machine's, microseconds.
    pub clock_off: Box<dyn Fn() -> i64 + Send + Sync>,
}

impl EnrolmentService {
    /// The CAs of this node.
    pub(crate) fn authorities(&self) -> &Authorities {
        &self.shared.authorities
    }

    /// The service of a node that carries these CAs.
    pub(crate) fn new(
        authorities: Arc<Authorities>,
        ledger: Arc<Ledger>,
        own: OwnNode,
        (genesis, document): (Genesis, Bytes),
        client: LedgerClient,
        clock: fn() -> u64,
    ) -> Self {
        Self {
            shared: Arc::new(Shared {
                own,
                client,
                carrying: Semaphore::new(1),
                authorities,
                ledger,
                genesis,
                document,
                clock,
                tries: Mutex::default(),
                offer: Mutex::default(),
            }),
        }
    }

    /// Does work that waits for the disk, beside the threads that serve connections.
    async fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Shared) -> Result<T, Rejection> + Send + 'static,
    ) -> Result<T, Rejection> {
        let shared = Arc::clone(&self.shared);
        let done = tokio::task::spawn_blocking(move || work(&shared)).await;
        done.unwrap_or_else(|error| Err(Rejection::new(Code::Internal, format!("the CA failed: {error}"))))
    }
}

#[tonic::async_trait]
impl Enrolment for EnrolmentService {
    async fn network(&self, _: Request<v1::NetworkRequest>) -> Result<Response<v1::NetworkResponse>, Status> {
        Ok(Response::new(self.shared.network()))
    }

    async fn enrol(&self, request: Request<v1::EnrolRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        let (came, source) = (Instant::now(), source(&request));
        let request = request.into_inner();
        let organisation = self.shared.organisation_of(&request.name);
        let enrolled = self.enrol_for(source, request).await;
        if enrolled.as_ref().is_err_and(|refused| refused.code == Code::EnrolmentRefused) {
            tokio::time::sleep_until(came + REFUSAL_TIME).await;
        }
        Ok(Response::new(enrolled.unwrap_or_else(|refused| self.shared.not_certified(&refused, &organisation))))
    }

    async fn renew(&self, request: Request<v1::RenewRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        let caller = match self.shared.caller(&request) {
            Ok(caller) => caller,
            Err(refused) => return Ok(Response::new(self.shared.not_certified(&refused, ""))),
        };
        let renewed = self.renew_for(Arc::clone(&caller), request.into_inner().request).await;
        Ok(Response::new(renewed.unwrap_or_else(|refused| self.shared.not_certified(&refused, &caller.organisation))))
    }

    async fn genesis(&self, _: Request<v1::GenesisRequest>) -> Result<Response<v1::GenesisResponse>, Status> {
        Ok(Response::new(v1::GenesisResponse { genesis: self.shared.document.clone() }))
    }

    async fn join_organisation(
        &self,
        request: Request<v1::JoinOrganisationRequest>,
    ) -> Result<Response<v1::JoinOrganisationResponse>, Status> {
        let source = source(&request);
        let joined = self.carry(request.into_inner().join, source).await;
        Ok(Response::new(v1::JoinOrganisationResponse { verdict: Some(verdict(joined)) }))
    }

    async fn offer_ca(&self, request: Request<v1::OfferCaRequest>) -> Result<Response<v1::OfferCaResponse>, Status> {
        let admin = self.shared.admin(&request);
        let offered = admin.and_then(|admin| self.offer(&admin, &request.into_inner().organisation));
        Ok(Response::new(offered.unwrap_or_else(|refused| v1::OfferCaResponse {
            verdict: Some((&refused).into()),
            ..v1::OfferCaResponse::default()
        })))
    }

    async fn seal_ca(&self, request: Request<v1::SealCaRequest>) -> Result<Response<v1::SealCaResponse>, Status> {
        let sealed = match self.shared.admin(&request) {
            Ok(admin) => self.seal(admin, request.into_inner()).await,
            Err(refused) => Err(refused),
        };
        Ok(Response::new(sealed.unwrap_or_else(|refused| v1::SealCaResponse {
            verdict: Some((&refused).into()),
            ..v1::SealCaResponse::default()
        })))
    }

    async fn take_ca(&self, request: Request<v1::TakeCaRequest>) -> Result<Response<v1::TakeCaResponse>, Status> {
        let taken = match self.shared.admin(&request) {
            Ok(admin) => self.take(&admin, request.into_inner()).await,
            Err(refused) => Err(refused),
        };
        Ok(Response::new(v1::TakeCaResponse { verdict: Some(verdict(taken)) }))
    }

    async fn copy_ca(&self, request: Request<v1::CopyCaRequest>) -> Result<Response<v1::CopyCaResponse>, Status> {
        let copied = match self.shared.admin(&request) {
            Ok(admin) => self.copy(admin, request.into_inner()).await,
            Err(refused) => Err(refused),
        };
        Ok(Response::new(copied.unwrap_or_else(|refused| v1::CopyCaResponse {
            verdict: Some((&refused).into()),
            ..v1::CopyCaResponse::default()
        })))
    }

    async fn restore_ca(
        &self,
        request: Request<v1::RestoreCaRequest>,
    ) -> Result<Response<v1::RestoreCaResponse>, Status> {
        let restored = match self.shared.admin(&request) {
            Ok(admin) => self.restore(&admin, request.into_inner()).await,
            Err(refused) => Err(refused),
        };
        Ok(Response::new(v1::RestoreCaResponse { verdict: Some(verdict(restored)) }))
    }

    async fn drop_ca(&self, request: Request<v1::DropCaRequest>) -> Result<Response<v1::DropCaResponse>, Status> {
        let dropped = match self.shared.admin(&request) {
            Ok(admin) => self.give_up(&admin, &request.into_inner().organisation).await,
            Err(refused) => Err(refused),
        };
        Ok(Response::new(v1::DropCaResponse { verdict: Some(verdict(dropped)) }))
    }
}

impl Shared {
    fn network(&self) -> v1::NetworkResponse {
        let ders = |ders: &mut dyn Iterator<Item = &[u8]>| ders.map(Bytes::copy_from_slice).collect();
        let msps = self.ledger.msps();
        let (members, tip) = (self.own.directory.members(), self.ledger.tip());
        let organisations = msps.iter().map(|msp| v1::Organisation {
            name: msp.organisation().to_owned(),
            roots: ders(&mut msp.roots()),
            intermediates: ders(&mut msp.intermediates()),
            units: msp.units().map(units_on_the_wire),
            // Those that leave are no longer worth asking.
            addresses: members
                .iter()
                .filter(|member| member.organisation == msp.organisation() && member.wanted.is_some())
                .map(|member| member.address.clone())
                .collect(),
        });
        v1::NetworkResponse {
            network: Bytes::copy_from_slice(&self.ledger.network().0),
            label: self.genesis.label.clone(),
            organisations: organisations.collect(),
            // Clients sign by it: by the clocks of most voters, also where this machine's is wrong.
            clock: (self.clock)().saturating_add_signed((self.own.clock_off)()).max(tip.time),
            cut_off: (self.own.cut_off)(),
            carries: self.authorities.organisations(),
            rules: self.ledger.rules().number(),
            height: tip.height,
            block_hash: known_hash(&tip.hash),
        }
    }

    /// The caller, if the certificate is still good.
    fn caller<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Rejection> {
        let caller =
            request.extensions().get::<Caller>().and_then(|caller| caller.identity.clone()).ok_or_else(|| {
                Rejection::new(Code::CertificateRequired, "this call needs a client certificate")
                    .found("a connection without one, which can only enrol")
            })?;
        caller.check_validity((self.clock)())?;
        self.ledger.check_revoked(&caller)?;
        Ok(caller)
    }

    /// The caller, if it is an admin whose certificate is still good.
    fn admin<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Rejection> {
        let caller = self.caller(request)?;
        if caller.role != Role::Admin {
            return Err(Rejection::new(Code::NotAdmin, format!("{} may not manage identities", caller.id()))
                .found(format!("role {}", caller.role))
                .wanted(format!("an admin of {}", caller.organisation)));
        }
        Ok(caller)
    }

    /// The CA of an organisation.
    fn authority(&self, organisation: &str) -> Result<Arc<Mutex<CertificateAuthority>>, Rejection> {
        self.authorities.find(organisation).ok_or_else(|| self.elsewhere(organisation))
    }

    /// This node does not carry the CA of that organisation; these do.
    fn elsewhere(&self, organisation: &str) -> Rejection {
        let carriers = self.carriers(organisation);
        let named: Vec<_> =
            carriers.iter().map(|(carrier, address)| format!("{} at {address}", carrier.full_name())).collect();
        let carried = self.authorities.organisations();
        let own = if carried.is_empty() { "no CA".into() } else { format!("the CA of {}", carried.join(", ")) };
        let refused =
            Rejection::new(Code::CaElsewhere, format!("this node does not hold the CA key of {organisation}"))
                .found(own);
        if named.is_empty() {
            return refused.wanted(format!("a node that holds the CA key of {organisation}; none is known")).next(
                "restore it from a backup, at a node of the organisation: ledgerd ca restore FILE --config FILE",
            );
        }
        refused.wanted(named.join(", ")).next(format!("use {}", named.join(" or ")))
    }

    /// The nodes that carry the CA of an organisation, with their addresses.
    fn carriers(&self, organisation: &str) -> Vec<(CarrierRecord, String)> {
        let state = &**self.ledger.state();
        let nodes = msp::nodes(state).unwrap_or_default();
        let carriers = msp::carriers(state).unwrap_or_default();
        let own = carriers.into_iter().filter(|carrier| carrier.organisation == organisation);
        own.filter_map(|carrier| {
            let of = |node: &&msp::NodeRecord| {
                node.role != NodeRole::Removed
                    && node.organisation == carrier.node_organisation
                    && node.name == carrier.node
            };
            let address = nodes.iter().find(of)?.address.clone();
            Some((carrier, address))
        })
        .collect()
    }

    /// The organisation at which somebody of this name would enrol: the one in front of it, or this node's.
    fn organisation_of(&self, name: &str) -> String {
        let named = name.split_once('/').map(|(organisation, _)| organisation);
        named.filter(|named| named.len() <= NAME_BYTES_MAX).unwrap_or(&self.own.me.organisation).to_owned()
    }

    /// A refusal; with the addresses of the nodes that carry the CA, if this one does not.
    fn not_certified(&self, refused: &Rejection, organisation: &str) -> v1::EnrolResponse {
        let elsewhere = refused.code == Code::CaElsewhere;
        let carriers = if elsewhere { self.carriers(organisation) } else { Vec::new() };
        v1::EnrolResponse {
            verdict: Some(refused.into()),
            carriers: carriers.into_iter().map(|(_, address)| address).collect(),
            ..v1::EnrolResponse::default()
        }
    }

    fn count_try(&self, source: IpAddr) -> Result<(), Rejection> {
        self.tries.lock().unwrap_or_else(PoisonError::into_inner).take(source, (self.clock)())
    }

    fn forgive_try(&self, source: IpAddr) {
        self.tries.lock().unwrap_or_else(PoisonError::into_inner).give_back(source);
    }
}

/// Where a request comes from.
fn source<T>(request: &Request<T>) -> IpAddr {
    let unknown = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
    request.extensions().get::<Caller>().map_or(unknown, |caller| caller.source)
}

fn verdict(outcome: Result<(), Rejection>) -> v1::Verdict {
    outcome.map_or_else(|refused| (&refused).into(), |()| v1::Verdict::default())
}

/// An argument of a chaincode function.
fn json(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value)
        .map(Bytes::from)
        .map_err(|error| Rejection::new(Code::Internal, format!("an argument cannot be written: {error}")))
}

/// A name from outside for a log line or a message: cut, and with control characters escaped.
fn printable(name: &str) -> String {
    name.chars().take(128).flat_map(char::escape_debug).collect()
}
