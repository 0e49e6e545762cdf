//! The API of the CAs that a node carries: the service `Enrolment` of `enrolment.proto`.
//!
//! A client without a certificate may ask for the network and may enrol. Tries to enrol share one limited rate, and a
//! refusal takes as long for a name that exists as for one that does not.

mod joining;
mod renewal;
#[cfg(test)]
mod tests;
mod tries;

pub(crate) use joining::{Carrier, carrier};

use crate::ca::{CertificateAuthority, IssuedCertificate, Registered};
use crate::listen::Caller;
use crate::peers::Directory;
use ledger::identity::{Identity, Role};
use ledger::network::Genesis;
use ledger::{Bytes, Code, Ledger, Rejection};
use ledger_api::v1;
use ledger_api::v1::enrolment_server::Enrolment;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::Instant;
use tonic::{Request, Response, Status};
use tries::Tries;

/// A refused try to enrol is answered no sooner than this after it came: counting a wrong secret takes a write to
/// the disk, which an unknown name does not.
const REFUSAL_TIME: Duration = Duration::from_millis(100);
/// The roles by the names that an admin uses.
const ROLES: [Role; 4] = [Role::Member, Role::Admin, Role::Node, Role::Robot];

/// The service; see the module.
#[derive(Clone)]
pub(crate) struct EnrolmentService {
    shared: Arc<Shared>,
}

struct Shared {
    /// Submits as this node what an organisation that joins has signed.
    carrier: Carrier,
    /// One such request at a time.
    carrying: Semaphore,
    /// By organisation; most nodes carry one or none.
    authorities: BTreeMap<String, Mutex<CertificateAuthority>>,
    ledger: Arc<Ledger>,
    surroundings: Surroundings,
    genesis: Genesis,
    /// The same, byte for byte.
    document: Bytes,
    /// The node's clock, microseconds since the UNIX epoch.
    clock: fn() -> u64,
    tries: Mutex<Tries>,
}

/// What the node knows of the network it is in.
pub(crate) struct Surroundings {
    /// Who belongs to the network now.
    pub directory: Arc<Directory>,
    /// Can this node have nothing ordered at the moment?
    pub cut_off: Box<dyn Fn() -> bool + Send + Sync>,
}

impl EnrolmentService {
    /// The service of a node that carries these CAs.
    pub(crate) fn new(
        authorities: impl IntoIterator<Item = CertificateAuthority>,
        ledger: Arc<Ledger>,
        surroundings: Surroundings,
        (genesis, document): (Genesis, Bytes),
        carrier: Carrier,
        clock: fn() -> u64,
    ) -> Self {
        let authorities = authorities.into_iter().map(|ca| (ca.organisation().to_owned(), Mutex::new(ca))).collect();
        Self {
            shared: Arc::new(Shared {
                carrier,
                carrying: Semaphore::new(1),
                authorities,
                ledger,
                surroundings,
                genesis,
                document,
                clock,
                tries: Mutex::default(),
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
        let came = Instant::now();
        let request = request.into_inner();
        let enrolled = match self.shared.begin_try() {
            Ok(()) => self.blocking(move |shared| shared.enrol(&request)).await,
            Err(rejection) => Err(rejection),
        };
        Ok(Response::new(match enrolled {
            Ok(response) => {
                self.shared.forgive_try();
                response
            }
            Err(rejection) => {
                if rejection.code == Code::EnrolmentRefused {
                    tokio::time::sleep_until(came + REFUSAL_TIME).await;
                }
                v1::EnrolResponse { verdict: Some((&rejection).into()), ..v1::EnrolResponse::default() }
            }
        }))
    }

    async fn register(&self, request: Request<v1::RegisterRequest>) -> Result<Response<v1::RegisterResponse>, Status> {
        let registered = match self.shared.admin(&request) {
            Ok(admin) => {
                let request = request.into_inner();
                self.blocking(move |shared| shared.register(&admin, request)).await
            }
            Err(rejection) => Err(rejection),
        };
        Ok(Response::new(registered.unwrap_or_else(|rejection| v1::RegisterResponse {
            verdict: Some((&rejection).into()),
            ..v1::RegisterResponse::default()
        })))
    }

    async fn renew(&self, request: Request<v1::RenewRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        let renewed = match self.shared.caller(&request) {
            Ok(caller) => self.renew_for(caller, request.into_inner().request).await,
            Err(rejection) => Err(rejection),
        };
        Ok(Response::new(renewed.unwrap_or_else(|rejection| v1::EnrolResponse {
            verdict: Some((&rejection).into()),
            ..v1::EnrolResponse::default()
        })))
    }

    async fn genesis(&self, _: Request<v1::GenesisRequest>) -> Result<Response<v1::GenesisResponse>, Status> {
        Ok(Response::new(v1::GenesisResponse { genesis: self.shared.document.clone() }))
    }

    async fn join_organisation(
        &self,
        request: Request<v1::JoinOrganisationRequest>,
    ) -> Result<Response<v1::JoinOrganisationResponse>, Status> {
        let joined = self.carry(request.into_inner().join).await;
        let verdict = joined.map_or_else(|rejection| (&rejection).into(), |()| v1::Verdict::default());
        Ok(Response::new(v1::JoinOrganisationResponse { verdict: Some(verdict) }))
    }

    async fn list_identities(
        &self,
        request: Request<v1::ListIdentitiesRequest>,
    ) -> Result<Response<v1::ListIdentitiesResponse>, Status> {
        let listed = match self.shared.admin(&request) {
            Ok(admin) => {
                let name = request.into_inner().name;
                self.blocking(move |shared| shared.list(&admin, &name)).await
            }
            Err(rejection) => Err(rejection),
        };
        Ok(Response::new(listed.unwrap_or_else(|rejection| v1::ListIdentitiesResponse {
            verdict: Some((&rejection).into()),
            ..v1::ListIdentitiesResponse::default()
        })))
    }
}

impl Shared {
    fn network(&self) -> v1::NetworkResponse {
        let ders = |ders: &mut dyn Iterator<Item = &[u8]>| ders.map(Bytes::copy_from_slice).collect();
        let msps = self.ledger.msps();
        let members = self.surroundings.directory.members();
        let organisations = msps.iter().map(|msp| v1::Organisation {
            name: msp.organisation().to_owned(),
            roots: ders(&mut msp.roots()),
            intermediates: ders(&mut msp.intermediates()),
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
            clock: (self.clock)().max(self.ledger.tip().time),
            cut_off: (self.surroundings.cut_off)(),
            carries: self.authorities.keys().cloned().collect(),
        }
    }

    fn enrol(&self, request: &v1::EnrolRequest) -> Result<v1::EnrolResponse, Rejection> {
        let now = (self.clock)();
        let Some((mut authority, name)) = self.find(&request.name) else {
            tracing::warn!(name = ?printable(&request.name), "refused to enrol a name that is not registered");
            return Err(CertificateAuthority::refusal());
        };
        let organisation = authority.organisation().to_owned();
        if self.ledger.msps().get(&organisation).is_none() {
            // The secret would be used up for a certificate that nobody can check yet.
            return Err(Rejection::new(
                Code::Behind,
                format!("this node does not know yet that {organisation} has joined"),
            )
            .found(format!("block {}", self.ledger.tip().height))
            .wanted("a node that has caught up with its network")
            .next("try again in a moment"));
        }
        let certificate = authority.enrol(name, &request.secret, &request.request, now).inspect_err(|rejection| {
            tracing::warn!(organisation, name = ?printable(name), code = %rejection.code, "refused to enrol");
        })?;
        tracing::info!(organisation, name = ?printable(name), "enrolled");
        drop(authority);
        Ok(v1::EnrolResponse {
            verdict: Some(v1::Verdict::default()),
            certificate: certificate.into(),
            // Our CAs sign with their root, which clients have from the network.
            chain: Vec::new(),
            organisation,
            network: Some(self.network()),
        })
    }

    /// The CA for a name, or for ORGANISATION/NAME: none if the name is registered nowhere, or at several.
    fn find<'a>(&self, name: &'a str) -> Option<(MutexGuard<'_, CertificateAuthority>, &'a str)> {
        if let Some((organisation, name)) = name.split_once('/') {
            return Some((lock(self.authorities.get(organisation)?), name));
        }
        let mut found = self.authorities.values().map(lock).filter(|ca| ca.identity(name).is_some());
        match (found.next(), found.next()) {
            (Some(authority), None) => Some((authority, name)),
            _ => None,
        }
    }

    fn register(&self, admin: &Identity, request: v1::RegisterRequest) -> Result<v1::RegisterResponse, Rejection> {
        let v1::RegisterRequest { name, role: wanted, attributes, reissue } = request;
        let role = role(&wanted)?;
        let mut authority = self.authority_of(admin)?;
        let secret = if reissue {
            let attributes = Some(attributes).filter(|attributes| !attributes.is_empty());
            authority.reissue(&name, attributes, (self.clock)())?
        } else {
            authority.register(&name, role, attributes, (self.clock)())?
        };
        let organisation = authority.organisation().to_owned();
        tracing::info!(by = admin.id(), name = ?printable(&name), reissue, "registered");
        Ok(v1::RegisterResponse { verdict: Some(v1::Verdict::default()), secret, organisation })
    }

    fn list(&self, admin: &Identity, name: &str) -> Result<v1::ListIdentitiesResponse, Rejection> {
        let authority = self.authority_of(admin)?;
        let chosen = |(known, _): &(&str, &Registered)| name.is_empty() || *known == name;
        let identities = authority
            .identities()
            .filter(chosen)
            .map(|(name, registered)| self.registered(authority.organisation(), name, registered))
            .collect::<Result<Vec<_>, _>>()?;
        if identities.is_empty() && !name.is_empty() {
            return Err(Rejection::new(
                Code::NotFound,
                format!("{:?} is not registered at {}", printable(name), authority.organisation()),
            )
            .next("ledgerctl identity list shows who is"));
        }
        Ok(v1::ListIdentitiesResponse { verdict: Some(v1::Verdict::default()), identities })
    }

    fn registered(
        &self,
        organisation: &str,
        name: &str,
        registered: &Registered,
    ) -> Result<v1::RegisteredIdentity, Rejection> {
        let certificate = |issued: &IssuedCertificate| {
            Ok(v1::IssuedCertificate {
                serial: Bytes::copy_from_slice(&issued.serial),
                issuer: Bytes::copy_from_slice(&issued.issuer.0),
                fingerprint: Bytes::copy_from_slice(&issued.fingerprint.0),
                not_before: issued.not_before,
                not_after: issued.not_after,
                revoked: self.ledger.is_revoked(&issued.issuer, &issued.serial)?,
            })
        };
        Ok(v1::RegisteredIdentity {
            name: name.to_owned(),
            organisation: organisation.to_owned(),
            role: registered.role.to_string(),
            attributes: registered.attributes.clone(),
            enrolled: !registered.certificates.is_empty(),
            certificates: registered.certificates.iter().map(certificate).collect::<Result<_, Rejection>>()?,
        })
    }

    /// Who calls, if the certificate is still good.
    fn caller<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Rejection> {
        let caller =
            request.extensions().get::<Caller>().and_then(|caller| caller.identity.clone()).ok_or_else(|| {
                Rejection::new(Code::CertificateRequired, "this call needs a client certificate")
                    .found("a connection without one, which can only enrol")
                    .next("connect with a certificate, for example with --context")
            })?;
        caller.check_validity((self.clock)())?;
        self.ledger.check_revoked(&caller)?;
        Ok(caller)
    }

    /// Who calls, if it is an admin whose certificate is still good.
    fn admin<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Rejection> {
        let caller = self.caller(request)?;
        if caller.role != Role::Admin {
            return Err(Rejection::new(Code::NotAdmin, format!("{} may not manage identities", caller.id()))
                .found(format!("role {}", caller.role))
                .wanted(format!("an admin of {}", caller.organisation))
                .next(format!("ask an admin of {}", caller.organisation)));
        }
        Ok(caller)
    }

    /// The CA of the caller's organisation: the only one that an admin may change or read.
    fn authority_of(&self, caller: &Identity) -> Result<MutexGuard<'_, CertificateAuthority>, Rejection> {
        let organisation = &caller.organisation;
        self.authorities.get(organisation).map(lock).ok_or_else(|| {
            let carried: Vec<_> = self.authorities.keys().map(String::as_str).collect();
            Rejection::new(Code::NotFound, format!("this node does not carry the CA of {organisation}"))
                .found(if carried.is_empty() { "no CA".into() } else { format!("the CA of {}", carried.join(", ")) })
                .next(format!("ask the node of {organisation} that does"))
        })
    }

    fn begin_try(&self) -> Result<(), Rejection> {
        self.tries.lock().unwrap_or_else(PoisonError::into_inner).take((self.clock)())
    }

    fn forgive_try(&self) {
        self.tries.lock().unwrap_or_else(PoisonError::into_inner).give_back();
    }
}

/// A CA that panicked half-way has changed nothing: it changes its memory last.
fn lock(authority: &Mutex<CertificateAuthority>) -> MutexGuard<'_, CertificateAuthority> {
    authority.lock().unwrap_or_else(PoisonError::into_inner)
}

fn role(name: &str) -> Result<Role, Rejection> {
    if name.is_empty() {
        return Ok(Role::Member);
    }
    ROLES.into_iter().find(|role| role.as_str() == name).ok_or_else(|| {
        Rejection::new(Code::BadArgument, "this role does not exist")
            .found(format!("{:?}", printable(name)))
            .wanted("member, admin, node or robot")
    })
}

/// A name from outside, cut for a log line or message; print it with `{:?}`.
fn printable(name: &str) -> String {
    name.chars().take(128).collect()
}
