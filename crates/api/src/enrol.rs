//! Enrolment: a one-time secret becomes a certificate, with a key that never leaves this machine.

use crate::certification::{CONNECT_MAX, DOORS_MAX, request};
use crate::clock::now;
use crate::connect::{Connection, explain_clock};
use crate::context::{CONTEXT_NAME_BYTES_MAX, Context, Memory, RenewalRule, msps_of};
use crate::report::accepted;
use crate::tls::{ServerTrust, client_config};
use crate::v1;
use crate::v1::enrolment_client::EnrolmentClient;
use bytes::Bytes;
use ledger::network::Genesis;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::{Msp, Msps};
use ring::rand::SystemRandom;
use rustls::ClientConfig;
use rustls_pki_types::CertificateDer;
use std::sync::Arc;

/// First contact with a node, whose CA is known by its fingerprint only.
#[derive(Clone, Debug)]
pub struct Enrolment {
    node: String,
    ca_fingerprint: Hash,
    network: Option<Hash>,
}

impl Enrolment {
    /// Enrolment at the node at `HOST:PORT`, whose organisation's CA certificate has this SHA-256.
    pub fn new(node: impl Into<String>, ca_fingerprint: Hash) -> Self {
        Self { node: node.into(), ca_fingerprint, network: None }
    }

    /// The same into this network: a process that serves several has to be told which one is meant.
    #[must_use]
    pub fn into_network(self, network: Hash) -> Self {
        Self { network: Some(network), ..self }
    }

    /// The node's description of its network. Nothing but the CA is verified.
    ///
    /// # Errors
    /// [`Code::Unreachable`], [`Code::Untrusted`] if the fingerprint is another.
    pub async fn network(&self) -> Result<v1::NetworkResponse, Rejection> {
        let connection = self.connect().await?;
        let answer = EnrolmentClient::new(connection.channel.clone()).network(v1::NetworkRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| connection.refusal(&status))
    }

    /// The genesis document of the network with this name, which is its hash.
    ///
    /// # Errors
    /// As [`Enrolment::network`]; [`Code::Untrusted`] if the node has another genesis, [`Code::Malformed`].
    pub async fn genesis(&self, wanted: &Hash) -> Result<(Genesis, Bytes), Rejection> {
        let connection = self.connect().await?;
        let answer = EnrolmentClient::new(connection.channel.clone()).genesis(v1::GenesisRequest {}).await;
        let document = answer.map_err(|status| connection.refusal(&status))?.into_inner().genesis;
        let (genesis, network) = Genesis::from_bytes(&document)?;
        if network != *wanted {
            return Err(Rejection::new(
                Code::Untrusted,
                format!("the node at {} belongs to another network", self.node),
            )
            .found(format!("network {network}"))
            .wanted(format!("network {wanted}"))
            .next("check the address; the token is for another network"));
        }
        Ok((genesis, document))
    }

    /// Brings what an invited organisation has signed to the ledger: the argument of `msp join_organisation`.
    ///
    /// # Errors
    /// As [`Enrolment::network`], and what the ledger says of it.
    pub async fn join_organisation(&self, join: Bytes) -> Result<(), Rejection> {
        let connection = self.connect().await?;
        let mut client = EnrolmentClient::new(connection.channel.clone());
        let answer = client.join_organisation(v1::JoinOrganisationRequest { join }).await;
        accepted(answer.map_err(|status| connection.refusal(&status))?.into_inner().verdict.as_ref())
    }

    /// Makes a key here, has it certified, and checks the answer. The certificate must be of our key and of the
    /// organisation with the pinned CA, or of another one whose CA the same node carries. Then the pinned
    /// organisation's node vouches for the other's root. The context is named after the identity; store it with
    /// [`Context::save`].
    ///
    /// # Errors
    /// [`Code::EnrolmentRefused`] if name or secret is wrong, [`Code::Unreachable`], [`Code::Untrusted`].
    pub async fn enrol(&self, name: &str, secret: &str, kind: KeyKind) -> Result<Context, Rejection> {
        let key = SigningKey::generate(kind, &SystemRandom::new())
            .map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        self.enrol_key(name, secret, key).await
    }

    /// As [`Enrolment::enrol`], with a key that exists. An answer that was lost can be asked for again with the same
    /// secret and key: for some minutes the same certificate comes back. A node that does not carry the CA names those
    /// that do, and they are asked instead, pinned to the same CA.
    ///
    /// # Errors
    /// As [`Enrolment::enrol`].
    pub async fn enrol_key(&self, name: &str, secret: &str, key: SigningKey) -> Result<Context, Rejection> {
        // The name may be ORGANISATION/NAME; only its last part can be in a certificate.
        let own_name = name.rsplit('/').next().unwrap_or(name);
        let request = v1::EnrolRequest { name: name.into(), secret: secret.into(), request: request(own_name, &key)? };
        let (mut doors, mut next, mut elsewhere) = (vec![self.node.clone()], 0, None);
        while let Some(door) = doors.get(next).cloned() {
            next += 1;
            match self.knock(&door, request.clone()).await {
                Ok(answer) => match accepted(answer.verdict.as_ref()) {
                    Ok(()) => return self.check(own_name, key, answer),
                    Err(refused) if refused.code == Code::CaElsewhere => {
                        let unknown: Vec<_> =
                            answer.carriers.into_iter().filter(|carrier| !doors.contains(carrier)).collect();
                        doors.extend(unknown);
                        doors.truncate(DOORS_MAX);
                        elsewhere.get_or_insert(refused);
                    }
                    Err(refused) => return Err(refused),
                },
                // The first node is the one that the caller named; of the others one may be down.
                Err(unreachable) if next == 1 => return Err(unreachable),
                Err(unreachable) => {
                    tracing::debug!(door, code = unreachable.code.name(), reason = %unreachable, "a node with the CA \
                                                                                                  key does not answer");
                }
            }
        }
        Err(elsewhere.unwrap_or_else(|| Rejection::new(Code::Internal, "no node was queried")))
    }

    /// Makes a context of a certificate (first, with issuers that are not declared behind it) and its key, which exist already. The
    /// node describes its network, and one of the organisations in it must have issued the certificate. It is named
    /// after the identity, as far as a directory can be, and never renewed here; store it with [`Context::save`].
    ///
    /// # Errors
    /// As [`Enrolment::network`]; [`Code::Untrusted`] if no organisation has issued the certificate or it is no client's;
    /// [`Code::BadFile`] if the key is another's.
    pub async fn import(&self, chain: Vec<CertificateDer<'static>>, key: SigningKey) -> Result<Context, Rejection> {
        let network = self.network().await?;
        let msps = msps_of(&network.organisations)?;
        self.check_pinned(&msps)?;
        let own = chain.first().map(AsRef::as_ref).unwrap_or_default();
        let identity = msps.verify(own, chain.get(1..).unwrap_or_default(), now())?;
        let id = Hash::from_slice(&network.network).ok_or_else(|| {
            Rejection::new(Code::Malformed, format!("the node at {} sends no network name", self.node))
        })?;
        if identity.public_key != key.public_key() {
            return Err(Rejection::new(Code::BadFile, "the key does not belong to the certificate")
                .found(format!("{:?}", key.public_key()))
                .wanted(format!("{:?}", identity.public_key))
                .next("use the key of this certificate: keystore, next to signcerts"));
        }
        let mut roots = network
            .organisations
            .iter()
            .filter(|found| found.roots.iter().any(|root| Hash::of(&[root]) == self.ca_fingerprint));
        let others = roots.next().into_iter().flat_map(|found| &found.addresses);
        let others = others.filter(|address| **address != self.node);
        Ok(Context {
            name: context_name(&identity.name),
            organisation: identity.organisation,
            network: id,
            label: network.label,
            nodes: std::iter::once(&self.node).chain(others).cloned().collect(),
            chain,
            key: Arc::new(key),
            msps: Arc::new(msps),
            renew: RenewalRule::Never,
            memory: Memory::default(),
        })
    }

    async fn knock(&self, door: &str, request: v1::EnrolRequest) -> Result<v1::EnrolResponse, Rejection> {
        let connection =
            Connection::open((door, self.network.as_ref()), self.tls()?, &Bytes::new(), CONNECT_MAX).await?;
        let answer = EnrolmentClient::new(connection.channel.clone()).enrol(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| connection.refusal(&status))
    }

    fn check(&self, name: &str, key: SigningKey, answer: v1::EnrolResponse) -> Result<Context, Rejection> {
        let unfit = |found: String| {
            Rejection::new(
                Code::Untrusted,
                format!("the certificate from the node at {} does not match the request", self.node),
            )
            .found(found)
            .wanted(format!("a certificate of {name:?} with our key, issued below CA {}", self.ca_fingerprint))
            .next("enrol at another node of the organisation, and inform its admin")
        };
        let network = answer.network.ok_or_else(|| unfit("no description of the network".into()))?;
        let msps = msps_of(&network.organisations)?;
        let organisation = msps.get(&answer.organisation).ok_or_else(|| {
            unfit(format!("organisation {:?}, which is not part of the network", answer.organisation))
        })?;
        self.check_pinned(&msps)?;
        let identity = verify(organisation, &answer.certificate, &answer.chain)?;
        if identity.public_key != key.public_key() {
            return Err(unfit(format!("the key {:?}", identity.public_key)));
        }
        if identity.name != name {
            return Err(unfit(format!("the name {:?}", identity.name)));
        }
        let id = Hash::from_slice(&network.network)
            .ok_or_else(|| unfit(format!("a network name of {} bytes", network.network.len())))?;
        let der = |bytes: &Bytes| CertificateDer::from(bytes.to_vec());
        let own = network.organisations.iter().find(|found| found.name == answer.organisation);
        let others = own.into_iter().flat_map(|own| &own.addresses).filter(|address| **address != self.node);
        let nodes = std::iter::once(&self.node).chain(others).cloned().collect();
        Ok(Context {
            name: identity.name,
            organisation: answer.organisation,
            network: id,
            label: network.label,
            nodes,
            chain: std::iter::once(&answer.certificate).chain(&answer.chain).map(der).collect(),
            key: Arc::new(key),
            msps: Arc::new(msps),
            renew: RenewalRule::default(),
            memory: Memory::default(),
        })
    }

    /// The pinned CA must be one of the network that the node describes.
    fn check_pinned(&self, msps: &Msps) -> Result<(), Rejection> {
        let mut roots = msps.iter().flat_map(Msp::roots).map(|root| Hash::of(&[root]));
        if roots.any(|root| root == self.ca_fingerprint) {
            return Ok(());
        }
        let known: Vec<_> = msps.iter().map(Msp::organisation).collect();
        Err(Rejection::new(Code::Untrusted, format!("the node at {} describes another network", self.node))
            .found(format!("the organisations {}, none with this CA", known.join(", ")))
            .wanted(format!("an organisation with CA {}", self.ca_fingerprint))
            .next("ask the operator of the node for the fingerprint of its CA"))
    }

    async fn connect(&self) -> Result<Connection, Rejection> {
        let there = (self.node.as_str(), self.network.as_ref());
        match Connection::open(there, self.tls()?, &Bytes::new(), CONNECT_MAX).await {
            Err(refused) => Err(explain_clock(refused, there, CONNECT_MAX).await),
            opened => opened,
        }
    }

    fn tls(&self) -> Result<Arc<ClientConfig>, Rejection> {
        let trust = ServerTrust::Fingerprint(self.ca_fingerprint.0);
        Ok(Arc::new(client_config(None, trust).map_err(|error| crate::connect::unusable(&error))?))
    }
}

/// The identity in the certificate, verified against the authorities of that organisation alone.
fn verify(organisation: &Msp, certificate: &[u8], chain: &[Bytes]) -> Result<Identity, Rejection> {
    let mut msps = Msps::new();
    msps.insert(organisation.clone())?;
    let chain: Vec<_> = chain.iter().map(|der| CertificateDer::from(der.as_ref())).collect();
    Ok(msps.verify(certificate, &chain, now())?)
}

/// The name of a certificate of another CA as the name of a directory: `User1@org1.example.com` keeps its letters.
fn context_name(name: &str) -> String {
    let usable = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' };
    let mut made = String::new();
    for c in name.trim_start_matches(['-', '.']).chars().map(usable) {
        if made.len() + c.len_utf8() <= CONTEXT_NAME_BYTES_MAX {
            made.push(c);
        }
    }
    if made.is_empty() { "imported".to_owned() } else { made }
}
