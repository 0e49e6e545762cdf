#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use crate::setup::{self, NetworkPlan, PlannedNode, PlannedOrganisation};
use ledger::Registry;
use ledger::key::KeyKind;
use ledger::results::ResultStore;
use ledger::state::{MemoryState, State};
use rcgen::{CertificateParams, KeyPair};
use std::path::PathBuf;
use tempfile::TempDir;

const NOW: u64 = 1_800_000_000_000_000;

/// A node that carries the CAs of both organisations, with one admin of Org1.
struct Fixture {
    _place: TempDir,
    service: EnrolmentService,
    ledger: Arc<Ledger>,
    admin: Arc<Identity>,
}

fn fixture() -> Fixture {
    let place = TempDir::new().unwrap();
    let organisation = |name: &str| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 };
    let data: PathBuf = place.path().join("node1");
    let plan = NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: "fleet".into(),
        organisations: vec![organisation("Org1"), organisation("Org2")],
        nodes: vec![PlannedNode {
            name: "node1".into(),
            organisation: "Org1".into(),
            data: data.clone(),
            address: "node1:7450".into(),
            voter: true,
        }],
    };
    let founded = setup::found(&plan, NOW).unwrap();
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    let ledger =
        Arc::new(Ledger::open(&founded.document, Registry::new(), state, Arc::new(ResultStore::in_memory())).unwrap());
    let mut authorities = CertificateAuthority::open_all(&data).unwrap();
    let org1 = authorities.iter_mut().find(|ca| ca.organisation() == "Org1").unwrap();
    let admin = org1.issue("Admin", Role::Admin, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap().certificate;
    let admin = Arc::new(ledger.msps().verify(&admin, &[], NOW).unwrap());
    let carrier: Carrier = Box::new(|join| {
        let refused = Rejection::new(Code::NotFound, "no such function");
        Box::pin(std::future::ready(if join.as_ref() == b"signed" { Ok(()) } else { Err(refused) }))
    });
    let document = (founded.genesis, founded.document);
    let surroundings = Surroundings { directory: Arc::new(Directory::read(&ledger)), cut_off: Box::new(|| false) };
    let service = EnrolmentService::new(authorities, Arc::clone(&ledger), surroundings, document, carrier, || NOW);
    Fixture { _place: place, service, ledger, admin }
}

fn by<T>(identity: Option<&Arc<Identity>>, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.extensions_mut().insert(Caller { identity: identity.map(Arc::clone) });
    request
}

fn register_request(name: &str, role: &str) -> v1::RegisterRequest {
    let attributes = BTreeMap::from([("Husky".to_owned(), "true".to_owned())]);
    v1::RegisterRequest { name: name.into(), role: role.into(), attributes, reissue: false }
}

fn csr() -> Bytes {
    let request = CertificateParams::default().serialize_request(&KeyPair::generate().unwrap()).unwrap();
    Bytes::copy_from_slice(request.der())
}

fn code(verdict: Option<v1::Verdict>) -> Code {
    Code::from_number(verdict.unwrap().code.try_into().unwrap()).unwrap()
}

impl Fixture {
    async fn register(&self, identity: Option<&Arc<Identity>>, name: &str, role: &str) -> v1::RegisterResponse {
        self.service.register(by(identity, register_request(name, role))).await.unwrap().into_inner()
    }

    async fn enrol(&self, name: &str, secret: &str) -> v1::EnrolResponse {
        let request = v1::EnrolRequest { name: name.into(), secret: secret.into(), request: csr() };
        self.service.enrol(by(None, request)).await.unwrap().into_inner()
    }

    async fn list(&self, identity: Option<&Arc<Identity>>, name: &str) -> v1::ListIdentitiesResponse {
        let request = v1::ListIdentitiesRequest { name: name.into() };
        self.service.list_identities(by(identity, request)).await.unwrap().into_inner()
    }
}

#[tokio::test]
async fn a_client_without_a_certificate_learns_the_network() {
    let f = fixture();
    let network = f.service.network(by(None, v1::NetworkRequest {})).await.unwrap().into_inner();
    assert_eq!(
        (network.network, network.label.as_str(), network.clock),
        (Bytes::copy_from_slice(&f.ledger.network().0), "fleet", NOW)
    );
    let [org1, org2] = network.organisations.as_slice() else { unreachable!("two organisations") };
    assert_eq!((org1.name.as_str(), org2.name.as_str()), ("Org1", "Org2"));
    assert_eq!((org1.addresses.as_slice(), org2.addresses.len()), (["node1:7450".to_owned()].as_slice(), 0));
    assert_eq!(
        (network.carries.as_slice(), network.cut_off),
        (["Org1".to_owned(), "Org2".to_owned()].as_slice(), false)
    );
    assert_eq!(org1.roots[0], f.ledger.msps().get("Org1").unwrap().roots().next().unwrap());
}

#[tokio::test]
async fn an_admin_registers_and_the_name_enrols_without_a_certificate() {
    let f = fixture();
    let registered = f.register(Some(&f.admin), "Salma", "").await;
    assert_eq!(code(registered.verdict), Code::Ok);
    assert_eq!(registered.organisation, "Org1");
    let enrolled = f.enrol("Salma", &registered.secret).await;
    assert_eq!(code(enrolled.verdict), Code::Ok);
    assert_eq!(enrolled.organisation, "Org1");
    assert!(enrolled.network.is_some());
    let identity = f.ledger.msps().verify(&enrolled.certificate, &[], NOW).unwrap();
    assert_eq!((identity.id().as_str(), identity.role), ("Org1/Salma", Role::Member));
    assert_eq!(identity.attributes["Husky"], "true");
    assert_eq!(code(f.enrol("Salma", &registered.secret).await.verdict), Code::EnrolmentRefused);
}

#[tokio::test]
async fn only_an_admin_with_a_good_certificate_manages_identities() {
    let f = fixture();
    let member = Arc::new(Identity { role: Role::Member, ..(*f.admin).clone() });
    let expired = Arc::new(Identity { not_after: NOW - 1, ..(*f.admin).clone() });
    let foreign = Arc::new(Identity { organisation: "Org3".into(), ..(*f.admin).clone() });
    for (caller, expected) in [
        (None, Code::CertificateRequired),
        (Some(&member), Code::NotAdmin),
        (Some(&expired), Code::CertificateExpired),
        (Some(&foreign), Code::Untrusted),
    ] {
        assert_eq!(code(f.register(caller, "Salma", "").await.verdict), expected);
        assert_eq!(code(f.list(caller, "").await.verdict), expected);
    }
    // Not even a request without the extension gets through.
    let bare = f.service.register(Request::new(register_request("Salma", ""))).await.unwrap().into_inner();
    assert_eq!(code(bare.verdict), Code::CertificateRequired);
    assert_eq!(f.list(Some(&f.admin), "").await.identities.len(), 2, "the node and the admin, nobody else");
}

#[tokio::test]
async fn a_revoked_admin_registers_nobody_and_the_list_shows_the_revocation() {
    let f = fixture();
    let before = f.list(Some(&f.admin), "Admin").await.identities;
    assert!(!before[0].certificates[0].revoked);
    let key = [b"msp\0revoked/".as_slice(), &f.admin.revocation_key()].concat();
    f.ledger.state().commit(
        [(Bytes::from(key), Some(Bytes::from_static(b"{}")))].into_iter().collect(),
        f.ledger.tip(),
        false,
    );
    assert_eq!(code(f.register(Some(&f.admin), "Salma", "").await.verdict), Code::Revoked);

    let mut other = (*f.admin).clone();
    other.serial = vec![1];
    let listed = f.list(Some(&Arc::new(other)), "Admin").await.identities;
    assert!(listed[0].certificates[0].revoked);
}

#[tokio::test]
async fn the_list_shows_one_organisation_only_and_what_revocations_need() {
    let f = fixture();
    f.register(Some(&f.admin), "Salma", "member").await;
    let org2 = Arc::new(Identity { organisation: "Org2".into(), ..(*f.admin).clone() });
    assert_eq!(code(f.register(Some(&org2), "Turtlebot4", "robot").await.verdict), Code::Ok);

    let names =
        |listed: &v1::ListIdentitiesResponse| listed.identities.iter().map(|i| i.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&f.list(Some(&f.admin), "").await), ["Admin", "Salma", "node1"]);
    let listed = f.list(Some(&org2), "").await;
    assert_eq!(names(&listed), ["Turtlebot4"]);
    assert_eq!((listed.identities[0].role.as_str(), listed.identities[0].enrolled), ("robot", false));
    assert_eq!(code(f.list(Some(&org2), "Salma").await.verdict), Code::NotFound);

    let admin = &f.list(Some(&f.admin), "Admin").await.identities[0];
    assert!(admin.enrolled);
    let certificate = &admin.certificates[0];
    assert_eq!(
        (certificate.serial.as_ref(), certificate.issuer.as_ref()),
        (f.admin.serial.as_slice(), f.admin.issuer.as_slice())
    );
    assert_eq!(certificate.fingerprint.as_ref(), f.admin.fingerprint.as_slice());
}

#[tokio::test]
async fn a_name_of_two_organisations_needs_the_organisation_with_it() {
    let f = fixture();
    let org2 = Arc::new(Identity { organisation: "Org2".into(), ..(*f.admin).clone() });
    let first = f.register(Some(&f.admin), "Sam", "").await.secret;
    let second = f.register(Some(&org2), "Sam", "").await.secret;
    assert_eq!(code(f.enrol("Sam", &first).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Org2/Sam", &first).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Org3/Sam", &first).await.verdict), Code::EnrolmentRefused);
    assert_eq!(f.enrol("Org1/Sam", &first).await.organisation, "Org1");
    assert_eq!(f.enrol("Org2/Sam", &second).await.organisation, "Org2");
}

#[tokio::test]
async fn an_unknown_name_and_a_wrong_secret_are_answered_alike_and_after_the_same_time() {
    let f = fixture();
    f.register(Some(&f.admin), "Salma", "").await;
    let began = Instant::now();
    let unknown = f.enrol("Nobody", "wrong").await;
    assert!(began.elapsed() >= REFUSAL_TIME);
    assert_eq!(f.enrol("Salma", "wrong").await, unknown);
    assert_eq!(code(unknown.verdict), Code::EnrolmentRefused);
}

#[tokio::test]
async fn a_role_that_does_not_exist_is_refused() {
    let f = fixture();
    for role in ["root", "Admin", "peer"] {
        assert_eq!(code(f.register(Some(&f.admin), "Salma", role).await.verdict), Code::BadArgument);
    }
    assert_eq!(code(f.register(Some(&f.admin), "Admin", "").await.verdict), Code::AlreadyRegistered);
}

#[tokio::test]
async fn too_many_tries_are_refused_before_anything_is_looked_up() {
    let f = fixture();
    let secret = f.register(Some(&f.admin), "Salma", "").await.secret;
    let tries = (0..tries::BURST_MAX).map(|_| f.enrol("Nobody", "wrong"));
    for refused in futures::future::join_all(tries).await {
        assert_eq!(code(refused.verdict), Code::EnrolmentRefused);
    }
    assert_eq!(code(f.enrol("Salma", &secret).await.verdict), Code::Overloaded);
}

#[tokio::test]
async fn of_many_who_present_the_same_secret_at_once_one_is_enrolled() {
    let f = fixture();
    let secret = f.register(Some(&f.admin), "Salma", "").await.secret;
    let all = futures::future::join_all((0..16).map(|_| f.enrol("Salma", &secret))).await;
    assert_eq!(all.into_iter().filter(|enrolled| code(enrolled.verdict.clone()) == Code::Ok).count(), 1);
    assert_eq!(f.list(Some(&f.admin), "Salma").await.identities[0].certificates.len(), 1);
}

#[tokio::test]
async fn the_genesis_that_is_told_is_the_one_that_names_the_network() {
    let f = fixture();
    let answer = f.service.genesis(by(None, v1::GenesisRequest {})).await.unwrap().into_inner();
    assert_eq!(Genesis::from_bytes(&answer.genesis).unwrap().1, f.ledger.network());
}

#[tokio::test]
async fn only_who_has_a_good_certificate_renews_it_and_gets_the_same_name_and_role() {
    let f = fixture();
    let renew = |caller: Option<Arc<Identity>>| {
        let service = f.service.clone();
        async move { service.renew(by(caller.as_ref(), v1::RenewRequest { request: csr() })).await.unwrap().into_inner() }
    };
    let later = |identity: &Identity| Some(Arc::new(identity.clone()));
    let expired = Identity { not_after: NOW - 1, ..(*f.admin).clone() };
    let foreign = Identity { organisation: "Org3".into(), ..(*f.admin).clone() };
    let stranger = Identity { name: "Nobody".into(), ..(*f.admin).clone() };
    for (caller, expected) in [
        (None, Code::CertificateRequired),
        (later(&expired), Code::CertificateExpired),
        (later(&foreign), Code::Untrusted),
        (later(&stranger), Code::NotFound),
        // Its certificate was issued just now.
        (later(&f.admin), Code::Overloaded),
    ] {
        assert_eq!(code(renew(caller).await.verdict), expected);
    }
    f.ledger.state().commit(
        [(
            Bytes::from([b"msp\0revoked/".as_slice(), &f.admin.revocation_key()].concat()),
            Some(Bytes::from_static(b"{}")),
        )]
        .into_iter()
        .collect(),
        f.ledger.tip(),
        false,
    );
    assert_eq!(code(renew(later(&f.admin)).await.verdict), Code::Revoked);
}

#[tokio::test]
async fn a_request_to_join_is_carried_if_it_is_small_and_refused_ones_are_not_carried_without_end() {
    let f = fixture();
    let join = async |join: &[u8]| {
        let request = v1::JoinOrganisationRequest { join: Bytes::copy_from_slice(join) };
        code(f.service.join_organisation(by(None, request)).await.unwrap().into_inner().verdict)
    };
    assert_eq!(join(&vec![0; 64 * 1024 + 1]).await, Code::TooLarge);
    for _ in 0..tries::BURST_MAX * 2 {
        assert_eq!(join(b"signed").await, Code::Ok);
    }
    for _ in 0..tries::BURST_MAX {
        assert_eq!(join(b"forged").await, Code::NotFound);
    }
    assert_eq!(join(b"signed").await, Code::Overloaded);
}

#[tokio::test]
async fn garbage_from_outside_is_refused_and_costs_nothing() {
    let f = fixture();
    let secret = f.register(Some(&f.admin), "Salma", "").await.secret;
    let long = "x".repeat(1 << 20);
    assert_eq!(code(f.enrol(&long, &long).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Salma", &long).await.verdict), Code::EnrolmentRefused);
    let request = v1::EnrolRequest { name: "Salma".into(), secret: secret.clone(), request: Bytes::from(long) };
    assert_eq!(code(f.service.enrol(by(None, request)).await.unwrap().into_inner().verdict), Code::BadArgument);
    assert_eq!(code(f.enrol("Salma", &secret).await.verdict), Code::Ok);
}
