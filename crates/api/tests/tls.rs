//! Handshakes over an in-memory connection: which sides accept each other.
#![expect(clippy::unwrap_used, clippy::panic, reason = "tests")]

use ledger_api::tls::{
    Refusal, ServerTrust, TlsError, TlsIdentity, TrustSource, Trusted, client_config, client_config_expecting,
    client_identity, refusal, server_config,
};
use ledger_base::hash::Hash;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::{Identity, IdentityError, Role};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, KeyUsagePurpose, date_time_ymd,
};
use ring::rand::SystemRandom;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{AlertDescription, CertificateError, ClientConfig};
use std::collections::BTreeSet;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_rustls::{TlsAcceptor, TlsConnector};

/// 2030-01-01, in microseconds since the UNIX epoch: the time at the server.
const NOW: u64 = 1_893_456_000_000_000;
const NO_MORE: &[CertificateDer<'_>] = &[];

struct Ca(CertifiedIssuer<'static, KeyPair>);

fn params(name: &str, unit: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    params.not_before = date_time_ymd(2020, 1, 1);
    params.not_after = date_time_ymd(2100, 1, 1);
    params
}

fn ca_params(name: &str) -> CertificateParams {
    let mut params = params(name, "ca");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    params
}

impl Ca {
    fn new(name: &str) -> Self {
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256).unwrap();
        Self(CertifiedIssuer::self_signed(ca_params(name), key).unwrap())
    }

    fn below(&self, name: &str) -> Self {
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        Self(CertifiedIssuer::signed_by(ca_params(name), key, &self.0).unwrap())
    }

    fn der(&self) -> CertificateDer<'static> {
        self.0.der().clone()
    }

    /// A certificate with its key, followed by `issuers`.
    fn issue(&self, params: &CertificateParams, issuers: &[CertificateDer<'static>]) -> TlsIdentity {
        self.issue_with(KeyKind::Ed25519, params, issuers)
    }

    fn issue_with(
        &self,
        kind: KeyKind,
        params: &CertificateParams,
        issuers: &[CertificateDer<'static>],
    ) -> TlsIdentity {
        let key = SigningKey::generate(kind, &SystemRandom::new()).unwrap();
        let pair = KeyPair::from_pem(&key.to_pkcs8_pem()).unwrap();
        let own = params.signed_by(&pair, &self.0).unwrap().der().clone();
        TlsIdentity::new([&[own], issuers].concat(), key.into()).unwrap()
    }

    fn node(&self) -> TlsIdentity {
        self.issue(&params("node1", "node"), &[self.der()])
    }

    fn user(&self, name: &str) -> TlsIdentity {
        self.issue(&params(name, "member"), &[])
    }

    fn msps(&self, organisation: &str) -> Arc<Msps> {
        let mut msps = Msps::new();
        msps.insert(Msp::new(organisation, &[self.der()], NO_MORE).unwrap()).unwrap();
        Arc::new(msps)
    }
}

struct Network {
    msps: Mutex<Arc<Msps>>,
    now: AtomicU64,
    revoked: Mutex<BTreeSet<String>>,
}

impl Network {
    fn new(msps: Arc<Msps>) -> Arc<Self> {
        Arc::new(Self { msps: Mutex::new(msps), now: NOW.into(), revoked: Mutex::default() })
    }
}

impl TrustSource for Network {
    fn msps(&self) -> Arc<Msps> {
        Arc::clone(&self.msps.lock().unwrap())
    }

    fn now(&self) -> u64 {
        self.now.load(Ordering::SeqCst)
    }

    fn revoked(&self, identity: &Identity) -> bool {
        self.revoked.lock().unwrap().contains(&identity.id())
    }
}

/// The view of both sides of a connection over which one byte goes each way.
struct Outcome {
    client: io::Result<()>,
    server: io::Result<Option<Identity>>,
}

impl Outcome {
    fn caller(self) -> Option<Identity> {
        self.client.unwrap();
        self.server.unwrap()
    }

    /// Why the client refused the server.
    fn refused_by_client(&self) -> Refusal {
        assert!(self.server.is_err(), "the server noticed");
        let Err(error) = &self.client else { panic!("the client accepted") };
        refusal(error).unwrap_or_else(|| panic!("no reason in {error:?}")).clone()
    }

    /// Why the server refused the client, and the alert that told the client so.
    fn refused_by_server(&self) -> (CertificateError, AlertDescription) {
        fn inner(error: &io::Error) -> Option<&rustls::Error> {
            error.get_ref()?.downcast_ref()
        }
        let Err(seen) = &self.client else { panic!("the client did not notice") };
        let Some(rustls::Error::AlertReceived(alert)) = inner(seen) else { panic!("no alert: {seen:?}") };
        let Err(error) = &self.server else { panic!("the server accepted") };
        let Some(rustls::Error::InvalidCertificate(reason)) = inner(error) else { panic!("no reason: {error:?}") };
        (reason.clone(), *alert)
    }
}

async fn connect(client: ClientConfig, server: TlsIdentity, network: &Arc<Network>) -> Outcome {
    let trust: Arc<dyn TrustSource> = Arc::clone(network) as _;
    let acceptor = TlsAcceptor::from(Arc::new(server_config(server, Arc::clone(&trust)).unwrap()));
    let connector = TlsConnector::from(Arc::new(client));
    let (near, far) = tokio::io::duplex(1 << 16);
    let client = async move {
        let mut stream = connector.connect(ServerName::try_from("any.host").unwrap(), near).await?;
        assert_eq!(stream.get_ref().1.alpn_protocol(), Some(b"h2".as_slice()));
        stream.write_all(b"?").await?;
        stream.flush().await?;
        stream.read_exact(&mut [0]).await.map(|_| ())
    };
    let server = async move {
        let mut stream = acceptor.accept(far).await?;
        stream.read_exact(&mut [0]).await?;
        stream.write_all(b"!").await?;
        stream.flush().await?;
        let identity = client_identity(stream.get_ref().1.peer_certificates(), trust.as_ref());
        Ok(identity.unwrap())
    };
    let (client, server) = tokio::join!(client, server);
    Outcome { client, server }
}

/// Two organisations' users and a node of the first, which trusts only the first.
fn setting() -> (Ca, Ca, Arc<Network>) {
    let (one, two) = (Ca::new("ca.org1"), Ca::new("ca.org2"));
    let network = Network::new(one.msps("Org1"));
    (one, two, network)
}

fn roots(ca: &Ca) -> ServerTrust {
    ServerTrust::Roots(ca.msps("Org1"))
}

#[tokio::test]
async fn a_user_and_a_node_of_one_network_know_each_other() {
    let (ca, _, network) = setting();
    let config = client_config(Some(ca.user("Salma")), roots(&ca)).unwrap();
    let caller = connect(config, ca.node(), &network).await.caller().unwrap();
    assert_eq!((caller.id().as_str(), caller.role), ("Org1/Salma", Role::Member));
}

#[tokio::test]
async fn keys_of_both_kinds_connect() {
    let (ca, _, network) = setting();
    for kind in [KeyKind::Ed25519, KeyKind::P256] {
        let salma = ca.issue_with(kind, &params("Salma", "client"), &[]);
        let node = ca.issue_with(kind, &params("node1", "peer"), &[]);
        let config = client_config(Some(salma), roots(&ca)).unwrap();
        assert!(connect(config, node, &network).await.caller().is_some(), "{kind}");
    }
}

#[tokio::test]
async fn a_client_without_a_certificate_is_nobody() {
    let (ca, _, network) = setting();
    let config = client_config(None, roots(&ca)).unwrap();
    assert_eq!(connect(config, ca.node(), &network).await.caller(), None);
}

#[tokio::test]
async fn nodes_connect_to_nodes() {
    let (ca, _, network) = setting();
    let trust = ServerTrust::Network(Arc::clone(&network) as _);
    let config = client_config(Some(ca.issue(&params("node2", "node"), &[])), trust).unwrap();
    assert_eq!(connect(config, ca.node(), &network).await.caller().unwrap().role, Role::Node);
}

#[tokio::test]
async fn a_chain_through_an_intermediate_is_accepted_on_both_sides_once_it_is_declared_there() {
    let (ca, _, network) = setting();
    let below = ca.below("ica.org1");
    let salma = below.issue(&params("Salma", "member"), &[below.der()]);
    let node = || below.issue(&params("node1", "node"), &[below.der(), ca.der()]);
    let mut declared = Msps::new();
    declared.insert(Msp::new("Org1", &[ca.der()], &[below.der()]).unwrap()).unwrap();
    let declared = Arc::new(declared);
    let config = client_config(Some(salma.clone()), ServerTrust::Roots(Arc::clone(&declared))).unwrap();
    // Whoever has lost the authority goes on presenting it.
    let refused = connect(config.clone(), node(), &network).await.refused_by_server();
    assert_eq!(refused, (CertificateError::UnknownIssuer, AlertDescription::UnknownCA));
    *network.msps.lock().unwrap() = declared;
    assert_eq!(connect(config, node(), &network).await.caller().unwrap().id(), "Org1/Salma");
    for trust in [roots(&ca), ServerTrust::Learnt(Arc::new(Trusted::new(ca.msps("Org1"), None)))] {
        let config = client_config(Some(salma.clone()), trust).unwrap();
        assert!(matches!(connect(config, node(), &network).await.refused_by_client(), Refusal::Identity(_)));
    }
}

#[tokio::test]
async fn a_user_of_another_network_is_refused() {
    let (ca, other, network) = setting();
    let config = client_config(Some(other.user("Eve")), roots(&ca)).unwrap();
    let refused = connect(config, ca.node(), &network).await.refused_by_server();
    assert_eq!(refused, (CertificateError::UnknownIssuer, AlertDescription::UnknownCA));
}

#[tokio::test]
async fn an_organisation_that_joins_is_accepted_without_a_restart() {
    let (ca, other, network) = setting();
    let mut both = Msps::clone(&network.msps());
    both.insert(Msp::new("Org2", &[other.der()], NO_MORE).unwrap()).unwrap();
    *network.msps.lock().unwrap() = Arc::new(both);
    let config = client_config(Some(other.user("Farhad")), roots(&ca)).unwrap();
    assert_eq!(connect(config, ca.node(), &network).await.caller().unwrap().id(), "Org2/Farhad");
}

#[tokio::test]
async fn a_user_is_refused_before_and_after_the_validity_of_the_certificate() {
    let (ca, _, network) = setting();
    let mut late = params("Salma", "member");
    late.not_before = date_time_ymd(2031, 1, 1);
    let config = client_config(Some(ca.issue(&late, &[])), roots(&ca)).unwrap();
    let refused = connect(config, ca.node(), &network).await.refused_by_server();
    assert_eq!(refused, (CertificateError::NotValidYet, AlertDescription::CertificateExpired));
    let mut early = params("Salma", "member");
    early.not_after = date_time_ymd(2029, 1, 1);
    let config = client_config(Some(ca.issue(&early, &[])), roots(&ca)).unwrap();
    let refused = connect(config, ca.node(), &network).await.refused_by_server();
    assert_eq!(refused, (CertificateError::Expired, AlertDescription::CertificateExpired));
}

#[tokio::test]
async fn a_revoked_user_is_refused() {
    let (ca, _, network) = setting();
    let salma = ca.user("Salma");
    let config = client_config(Some(salma.clone()), roots(&ca)).unwrap();
    assert!(connect(config.clone(), ca.node(), &network).await.caller().is_some());
    network.revoked.lock().unwrap().insert("Org1/Salma".into());
    let refused = connect(config, ca.node(), &network).await.refused_by_server();
    assert_eq!(refused, (CertificateError::Revoked, AlertDescription::CertificateRevoked));
    // A connection from before: asked again, the answer has changed.
    let again = client_identity(Some(&salma.own().chain), network.as_ref());
    assert_eq!(again, Err(Refusal::Revoked { id: "Org1/Salma".into() }));
}

#[tokio::test]
async fn a_users_certificate_does_not_pass_as_a_nodes() {
    let (ca, _, network) = setting();
    for trust in [
        roots(&ca),
        ServerTrust::Network(Arc::clone(&network) as _),
        ServerTrust::Fingerprint(Hash::of(&[&ca.der()]).0),
    ] {
        for unit in ["member", "admin", "robot"] {
            let impostor = ca.issue(&params("node1", unit), &[ca.der()]);
            let config = client_config(Some(ca.user("Salma")), trust.clone()).unwrap();
            let refused = connect(config, impostor, &network).await.refused_by_client();
            assert!(matches!(refused, Refusal::NotANode { .. }), "{unit} with {trust:?} gave {refused}");
        }
    }
}

#[tokio::test]
async fn a_node_of_another_network_is_refused() {
    let (ca, other, network) = setting();
    let config = client_config(None, roots(&ca)).unwrap();
    let refused = connect(config, other.node(), &network).await.refused_by_client();
    assert!(matches!(refused, Refusal::Identity(IdentityError::Untrusted { .. })), "{refused}");
    assert!(!refused.remedy().is_empty());
}

#[tokio::test]
async fn a_node_is_refused_before_and_after_the_validity_of_its_certificate() {
    let (ca, _, network) = setting();
    let mut late = params("node1", "node");
    late.not_before = date_time_ymd(2090, 1, 1);
    let mut early = params("node1", "node");
    early.not_after = date_time_ymd(2021, 1, 1);
    for trust in [roots(&ca), ServerTrust::Network(Arc::clone(&network) as _)] {
        let config = client_config(None, trust).unwrap();
        let refused = connect(config.clone(), ca.issue(&late, &[]), &network).await.refused_by_client();
        assert!(matches!(refused, Refusal::Identity(IdentityError::NotYetValid { .. })), "{refused}");
        let refused = connect(config, ca.issue(&early, &[]), &network).await.refused_by_client();
        assert!(matches!(refused, Refusal::Identity(IdentityError::Expired { .. })), "{refused}");
    }
}

#[tokio::test]
async fn a_revoked_node_is_refused_by_nodes() {
    let (ca, _, network) = setting();
    network.revoked.lock().unwrap().insert("Org1/node1".into());
    let config = client_config(None, ServerTrust::Network(Arc::clone(&network) as _)).unwrap();
    let refused = connect(config, ca.node(), &network).await.refused_by_client();
    assert_eq!(refused, Refusal::Revoked { id: "Org1/node1".into() });
}

#[tokio::test]
async fn first_contact_accepts_a_node_below_the_pinned_authority() {
    let (ca, _, network) = setting();
    let trust = ServerTrust::Fingerprint(Hash::of(&[&ca.der()]).0);
    let config = client_config(None, trust.clone()).unwrap();
    assert_eq!(connect(config, ca.node(), &network).await.caller(), None);
    let below = ca.below("ica.org1");
    let node = below.issue(&params("node1", "node"), &[below.der(), ca.der()]);
    assert_eq!(connect(client_config(None, trust).unwrap(), node, &network).await.caller(), None);
}

#[tokio::test]
async fn first_contact_refuses_another_authority() {
    let (ca, other, network) = setting();
    let config = client_config(None, ServerTrust::Fingerprint(Hash::of(&[&ca.der()]).0)).unwrap();
    let refused = connect(config.clone(), other.node(), &network).await.refused_by_client();
    assert!(matches!(refused, Refusal::Fingerprint { .. }), "{refused}");
    // Presenting the right authority beside a certificate that it did not issue does not help.
    let impostor = other.issue(&params("node1", "node"), &[ca.der()]);
    let refused = connect(config, impostor, &network).await.refused_by_client();
    assert!(matches!(refused, Refusal::Identity(IdentityError::Untrusted { .. })), "{refused}");
}

#[tokio::test]
async fn first_contact_refuses_a_pin_on_the_certificate_of_the_node_itself() {
    let (ca, _, network) = setting();
    let node = ca.node();
    let pin = Hash::of(&[node.own().chain.first().unwrap()]).0;
    let config = client_config(None, ServerTrust::Fingerprint(pin)).unwrap();
    let refused = connect(config, node, &network).await.refused_by_client();
    assert!(matches!(refused, Refusal::Fingerprint { .. }), "{refused}");
}

#[tokio::test]
async fn a_client_that_expects_one_node_refuses_the_others() {
    let (ca, _, network) = setting();
    for name in ["Org1/node1", "node1"] {
        let config = client_config_expecting(None, roots(&ca), name).unwrap();
        assert_eq!(connect(config, ca.node(), &network).await.caller(), None);
    }
    for name in ["Org1/node2", "Org2/node1", "node2"] {
        let config = client_config_expecting(None, roots(&ca), name).unwrap();
        let refused = connect(config, ca.node(), &network).await.refused_by_client();
        assert_eq!(refused, Refusal::OtherNode { found: "Org1/node1".into(), wanted: name.into() });
    }
}

#[tokio::test]
async fn tls_1_2_is_not_spoken() {
    let (ca, _, network) = setting();
    let server = server_config(ca.node(), network).unwrap();
    let acceptor = TlsAcceptor::from(Arc::new(server));
    let (mut near, far) = tokio::io::duplex(1 << 16);
    // A ClientHello of TLS 1.2 without the supported_versions extension, offering one ECDHE suite.
    let mut hello = vec![0x03, 0x03];
    hello.extend([7; 32]);
    hello.extend([0, 0, 2, 0xc0, 0x2b, 1, 0]);
    let extensions: &[u8] = &[0, 10, 0, 4, 0, 2, 0, 23, 0, 13, 0, 4, 0, 2, 4, 3];
    hello.extend([0, extensions.len() as u8]);
    hello.extend(extensions);
    let message = [&[1, 0, 0, hello.len() as u8], hello.as_slice()].concat();
    let record = [&[22, 3, 1, 0, message.len() as u8], message.as_slice()].concat();
    near.write_all(&record).await.unwrap();
    let refused = acceptor.accept(far).await.unwrap_err();
    assert!(refused.to_string().contains("SupportedVersionsExtensionRequired"), "{refused}");
    assert!(refusal(&refused).is_none());
}

#[test]
fn a_chain_and_a_key_are_read_from_files() {
    let ca = Ca::new("ca.org1");
    let key = SigningKey::generate(KeyKind::P256, &SystemRandom::new()).unwrap();
    let pair = KeyPair::from_pem(&key.to_pkcs8_pem()).unwrap();
    let certificate = params("node1", "node").signed_by(&pair, &ca.0).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (chain, secret) = (folder.path().join("node.pem"), folder.path().join("node.key"));
    std::fs::write(&chain, certificate.pem() + &ca.0.pem()).unwrap();
    std::fs::write(&secret, key.to_pkcs8_pem()).unwrap();
    let read = TlsIdentity::from_pem_files(&chain, &secret).unwrap();
    assert_eq!(read.own().chain, [certificate.der().clone(), ca.der()]);
    assert!(!format!("{read:?}").contains("key"), "the secret is not shown");

    let refused = TlsIdentity::from_pem_files(&folder.path().join("missing.pem"), &secret).unwrap_err();
    assert!(refused.to_string().contains("missing.pem"), "{refused}");
    let refused = TlsIdentity::from_pem_files(&secret, &secret).unwrap_err();
    assert!(matches!(&refused, TlsError::In { reason, .. } if matches!(**reason, TlsError::Chain { .. })), "{refused}");
    assert!(refused.to_string().contains("node.key: "), "the file is named: {refused}");
    let refused = TlsIdentity::from_pem_files(&chain, &chain).unwrap_err();
    assert!(matches!(&refused, TlsError::In { reason, .. } if matches!(**reason, TlsError::Key(_))), "{refused}");
    assert!(refused.to_string().contains("node.pem: "), "the file is named: {refused}");
    std::fs::write(&secret, "x".repeat(1 << 20)).unwrap();
    let refused = TlsIdentity::from_pem_files(&chain, &secret).unwrap_err();
    assert!(matches!(refused, TlsError::File { .. }), "{refused}");
}

#[test]
fn a_key_that_is_not_the_certificates_is_refused() {
    let ca = Ca::new("ca.org1");
    let other = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
    let refused = TlsIdentity::new(ca.node().own().chain.clone(), other.into()).unwrap_err();
    assert!(matches!(refused, TlsError::KeyMismatch { .. }), "{refused}");
}

#[tokio::test]
async fn a_renewed_certificate_is_shown_from_the_next_handshake_on_by_both_sides() {
    let (one, _, network) = setting();
    let (salma, node) = (one.user("Salma"), one.node());
    let connected = || async {
        let trust = ServerTrust::Roots(one.msps("Org1"));
        connect(client_config(Some(salma.clone()), trust).unwrap(), node.clone(), &network).await
    };
    // Made before the renewal, used after it.
    let before = client_config(Some(salma.clone()), ServerTrust::Roots(one.msps("Org1"))).unwrap();
    assert_eq!(connected().await.server.unwrap().unwrap().name, "Salma");
    let old = salma.own().creator;
    salma.renew(&one.user("Salma2"));
    assert_ne!(salma.own().creator, old);
    let outcome = connect(before, node.clone(), &network).await;
    assert_eq!(outcome.server.unwrap().unwrap().name, "Salma2");
    node.renew(&one.issue(&params("node1", "member"), &[one.der()]));
    let refused = connected().await.client.unwrap_err();
    assert!(matches!(refusal(&refused), Some(Refusal::NotANode { .. })), "{refused}");
}

#[test]
fn of_two_keys_in_a_file_the_one_of_the_certificate_is_taken() {
    let ca = Ca::new("ca.org1");
    let [key, other] = [(); 2].map(|()| SigningKey::generate(KeyKind::P256, &SystemRandom::new()).unwrap());
    let pair = KeyPair::from_pem(&key.to_pkcs8_pem()).unwrap();
    let chain = params("node1", "node").signed_by(&pair, &ca.0).unwrap().pem();
    let (own, other) = (key.to_pkcs8_pem(), other.to_pkcs8_pem());
    for keys in [own.clone() + &other, other.clone() + &own] {
        assert_eq!(TlsIdentity::from_pem(&chain, &keys).unwrap().own().key.public_key(), key.public_key());
    }
    let refused = TlsIdentity::from_pem(&chain, &other).unwrap_err();
    assert!(matches!(refused, TlsError::KeyMismatch { .. }), "{refused}");
}
