#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use crate::ordering::directory::Part;
use crate::tools::setup;
use crate::tools::setup::{NetworkPlan, PlannedNode, PlannedOrganisation};
use futures::FutureExt;
use ledger::block::Payload;
use ledger::msp::{ENROLMENT_REPEAT_MAX, IdentityRecord};
use ledger::transaction::{Body, Transaction};
use ledger::{Page, Registry};
use ledger_base::hash::Hash;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use rcgen::{CertificateParams, KeyPair};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tempfile::TempDir;

const NOW: u64 = 1_800_000_000_000_000;
const SECOND: u64 = 1_000_000;

/// Somebody who signs transactions.
struct Signer {
    key: SigningKey,
    certificate: Bytes,
}

/// A ledger that executes what is signed, a block each; it may be out of reach.
struct Chain {
    ledger: Arc<Ledger>,
    time: AtomicU64,
    reachable: AtomicBool,
    turn: Mutex<u64>,
}

impl Chain {
    fn call(&self, by: &Signer, function: &str, argument: &Bytes) -> Result<Bytes, Rejection> {
        if !self.reachable.load(Ordering::Relaxed) {
            return Err(Rejection::new(Code::NoLeader, "no majority"));
        }
        let mut nonce = self.turn.lock().unwrap();
        *nonce += 1;
        let time = self.time.fetch_add(SECOND, Ordering::Relaxed) + SECOND;
        let [network, creator] =
            [self.ledger.network(), Hash::of(&[&by.certificate])].map(|hash| Bytes::copy_from_slice(&hash.0));
        let nonce = [&nonce.to_be_bytes()[..], &[0; 8]].concat().into();
        let (not_after, chaincode, function) = (time + 60 * SECOND, "msp".into(), function.into());
        let args = vec![argument.clone()];
        let body = Body { network, creator, nonce, not_after, chaincode, function, args, known_block: None };
        let signed = Transaction::sign(&body, &by.key).unwrap().with_certificate(by.certificate.clone()).unwrap();
        let data = Payload { time, transactions: vec![signed.encoded().clone()] }.to_bytes();
        let entry = Entry { index: self.ledger.tip().height + 1, term: 1, kind: EntryKind::Normal, data };
        self.ledger.apply(&entry).unwrap().results[0].outcome()
    }
}

/// Two nodes of Org1 on one ledger. Node 1 carries the CAs of Org1 and Org2, node 2 none. An admin of each organisation.
struct Fixture {
    place: TempDir,
    chain: Arc<Chain>,
    one: EnrolmentService,
    two: EnrolmentService,
    admins: [Signer; 2],
}

fn service(chain: &Arc<Chain>, document: &Bytes, data: &Path, id: u64) -> EnrolmentService {
    let tls = TlsIdentity::from_pem_files(&data.join("node.pem"), &data.join("node.key")).unwrap();
    let member = Member {
        id,
        name: format!("node{id}"),
        organisation: "Org1".into(),
        address: format!("node{id}:7450"),
        wanted: Some(Part::Voter),
        actual: None,
    };
    let own = tls.own();
    let signer = Arc::new(Signer {
        key: SigningKey::from_pkcs8_der(own.key.to_pkcs8_der()).unwrap(),
        certificate: Bytes::copy_from_slice(own.certificate()),
    });
    let (submitting, reading) = (Arc::clone(chain), Arc::clone(chain));
    let client = LedgerClient {
        submit: Box::new(move |function, argument| {
            let (chain, signer) = (Arc::clone(&submitting), Arc::clone(&signer));
            async move { chain.call(&signer, function, &argument) }.boxed()
        }),
        catch_up: Box::new(move || {
            let reachable = reading.reachable.load(Ordering::Relaxed);
            let answer = if reachable { Ok(()) } else { Err(Rejection::new(Code::NoLeader, "no majority")) };
            std::future::ready(answer).boxed()
        }),
    };
    let authorities = Arc::new(Authorities::open(data, (365, 7)).unwrap());
    let genesis = (Genesis::from_bytes(document).unwrap().0, document.clone());
    let directory = Arc::new(Directory::read(&chain.ledger));
    let (cut_off, clock_off) = (Box::new(|| false), Box::new(|| 0));
    let surroundings = OwnNode { me: member, identity: tls, directory, cut_off, clock_off };
    EnrolmentService::new(authorities, Arc::clone(&chain.ledger), surroundings, genesis, client, || NOW)
}

fn fixture() -> Fixture {
    let place = TempDir::new().unwrap();
    let organisation = |name: &str| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 };
    let node = |id: u64| PlannedNode {
        name: format!("node{id}"),
        organisation: "Org1".into(),
        data: place.path().join(format!("node{id}")),
        address: format!("node{id}:7450"),
        voter: true,
    };
    let plan = NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: "fleet".into(),
        organisations: vec![organisation("Org1"), organisation("Org2")],
        nodes: vec![node(1), node(2)],
    };
    let founded = setup::found(&plan, NOW).unwrap();
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    let ledger = Ledger::open(&founded.document, Registry::new(), state, Arc::new(ResultStore::in_memory())).unwrap();
    let chain = Arc::new(Chain {
        ledger: Arc::new(ledger),
        time: AtomicU64::new(NOW),
        reachable: AtomicBool::new(true),
        turn: Mutex::new(0),
    });
    let admins = [0, 1].map(|index: usize| {
        let mut ca = CertificateAuthority::open(&founded.authorities[index].directory).unwrap();
        let issued = ca.issue("Admin", Role::Admin, BTreeMap::new(), KeyKind::Ed25519, NOW).unwrap();
        Signer { key: issued.key, certificate: issued.certificate.into() }
    });
    let one = service(&chain, &founded.document, &plan.nodes[0].data, 1);
    let two = service(&chain, &founded.document, &plan.nodes[1].data, 2);
    Fixture { place, chain, one, two, admins }
}

fn from<T>(source: u8, identity: Option<Arc<Identity>>, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.extensions_mut().insert(Caller { identity, source: [10, 0, 0, source].into() });
    request
}

fn csr() -> Bytes {
    let request = CertificateParams::default().serialize_request(&KeyPair::generate().unwrap()).unwrap();
    Bytes::copy_from_slice(request.der())
}

fn code(verdict: Option<v1::Verdict>) -> Code {
    Code::from_number(verdict.unwrap().code.try_into().unwrap()).unwrap()
}

impl Fixture {
    fn identity(&self, organisation: usize) -> Arc<Identity> {
        Arc::new(self.chain.ledger.msps().verify(&self.admins[organisation - 1].certificate, &[], NOW).unwrap())
    }

    /// Registers a name at an organisation, with its secret "secret of NAME".
    fn register(&self, organisation: usize, name: &str) -> String {
        let secret = format!("secret of {}", name.to_lowercase());
        let argument = serde_json::json!({
            "name": name, "attributes": {"Husky": "true"}, "secret": Hash::of(&[secret.as_bytes()]),
            "expires": NOW + 24 * 3600 * SECOND,
        });
        self.admin(organisation, "register", &argument.to_string()).unwrap();
        secret
    }

    fn admin(&self, organisation: usize, function: &str, argument: &str) -> Result<Bytes, Rejection> {
        self.chain.call(&self.admins[organisation - 1], function, &Bytes::copy_from_slice(argument.as_bytes()))
    }

    fn listed(&self, name: &str) -> Option<IdentityRecord> {
        let argument = Bytes::from(serde_json::json!({ "name": name }).to_string());
        let (ledger, now) = (&self.chain.ledger, self.chain.time.load(Ordering::Relaxed));
        let admin = ledger.msps().verify(&self.admins[0].certificate, &[], now).unwrap();
        let (page, _) = ledger.query(&admin, now, "msp", "identities", &[argument]).unwrap();
        let page: Page<IdentityRecord> = serde_json::from_slice(&page).unwrap();
        page.items.into_iter().next()
    }

    async fn enrol_from(&self, source: u8, name: &str, secret: &str, request: &Bytes) -> v1::EnrolResponse {
        let request = v1::EnrolRequest { name: name.into(), secret: secret.into(), request: request.clone() };
        self.one.enrol(from(source, None, request)).await.unwrap().into_inner()
    }

    async fn enrol(&self, name: &str, secret: &str) -> v1::EnrolResponse {
        self.enrol_from(1, name, secret, &csr()).await
    }
}

#[tokio::test]
async fn a_client_without_a_certificate_learns_the_network() {
    let f = fixture();
    let network = f.one.network(from(1, None, v1::NetworkRequest {})).await.unwrap().into_inner();
    assert_eq!(
        (network.network, network.label.as_str(), network.clock),
        (Bytes::copy_from_slice(&f.chain.ledger.network().0), "fleet", NOW)
    );
    let [org1, org2] = network.organisations.as_slice() else { unreachable!("two organisations") };
    assert_eq!((org1.name.as_str(), org2.name.as_str()), ("Org1", "Org2"));
    assert_eq!((org1.addresses.join(" ").as_str(), org2.addresses.len()), ("node1:7450 node2:7450", 0));
    assert_eq!((network.carries.join(" ").as_str(), network.cut_off), ("Org1 Org2", false));
    assert_eq!(org1.roots[0], f.chain.ledger.msps().get("Org1").unwrap().roots().next().unwrap());
}

#[tokio::test]
async fn a_name_that_is_registered_on_the_ledger_enrols_and_its_certificate_stands_there_before_it_is_handed_out() {
    let f = fixture();
    let secret = f.register(1, "Salma");
    let enrolled = f.enrol("Salma", &secret).await;
    assert_eq!(code(enrolled.verdict), Code::Ok);
    assert_eq!(enrolled.organisation, "Org1");
    let identity = f.chain.ledger.msps().verify(&enrolled.certificate, &[], NOW).unwrap();
    assert_eq!((identity.id().as_str(), identity.role), ("Org1/Salma", Role::Member));
    assert_eq!(identity.attributes["Husky"], "true");
    let issued = &f.listed("Salma").unwrap().certificates[0];
    assert_eq!((issued.fingerprint.0, issued.via.as_str()), (identity.fingerprint, "Org1/node1"));
    assert_eq!(code(f.enrol("Salma", &secret).await.verdict), Code::EnrolmentRefused, "another key");
}

#[tokio::test]
async fn nothing_is_handed_out_and_no_secret_spent_while_the_ledger_is_out_of_reach() {
    let f = fixture();
    let secret = f.register(1, "Salma");
    f.chain.reachable.store(false, Ordering::Relaxed);
    let request = csr();
    assert_eq!(code(f.enrol_from(1, "Salma", &secret, &request).await.verdict), Code::NoLeader);
    // A guess is not answered by a state that may be old.
    assert_eq!(code(f.enrol("Nobody", "wrong").await.verdict), Code::NoLeader);
    f.chain.reachable.store(true, Ordering::Relaxed);
    assert_eq!(code(f.enrol_from(1, "Salma", &secret, &request).await.verdict), Code::Ok);
}

#[tokio::test]
async fn the_same_key_receives_the_same_certificate_until_it_is_revoked_or_some_minutes_have_passed() {
    let f = fixture();
    let (salma, farhad) = (f.register(1, "Salma"), f.register(1, "Farhad"));
    let request = csr();
    let first = f.enrol_from(1, "Salma", &salma, &request).await.certificate;
    assert_eq!(f.enrol_from(1, "Salma", &salma, &request).await.certificate, first);
    f.admin(1, "revoke_identity", r#"{"name":"Salma"}"#).unwrap();
    assert_eq!(code(f.enrol_from(1, "Salma", &salma, &request).await.verdict), Code::EnrolmentRefused);

    assert_eq!(code(f.enrol_from(1, "Farhad", &farhad, &request).await.verdict), Code::Ok);
    f.chain.time.fetch_add(ENROLMENT_REPEAT_MAX, Ordering::Relaxed);
    assert_eq!(code(f.enrol_from(1, "Farhad", &farhad, &request).await.verdict), Code::EnrolmentRefused);
}

#[tokio::test]
async fn a_name_of_two_organisations_enrols_where_its_secret_is_known() {
    let f = fixture();
    let first = f.register(1, "Sam");
    let other = serde_json::json!({
        "name": "Sam", "secret": Hash::of(&[b"another"]), "expires": NOW + 24 * 3600 * SECOND,
    });
    f.admin(2, "register", &other.to_string()).unwrap();
    assert_eq!(code(f.enrol("Org2/Sam", &first).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Org3/Sam", &first).await.verdict), Code::EnrolmentRefused);
    assert_eq!(f.enrol("Sam", "another").await.organisation, "Org2");
    assert_eq!(f.enrol("Org1/Sam", &first).await.organisation, "Org1");
}

#[tokio::test]
async fn an_unknown_name_and_a_wrong_secret_are_answered_alike_and_after_the_same_time() {
    let f = fixture();
    f.register(1, "Salma");
    let began = Instant::now();
    let unknown = f.enrol("Nobody", "wrong").await;
    assert!(began.elapsed() >= REFUSAL_TIME);
    assert_eq!(f.enrol("Salma", "wrong").await, unknown);
    assert_eq!(code(unknown.verdict), Code::EnrolmentRefused);
}

#[tokio::test]
async fn guesses_cost_the_guesser_and_never_who_has_the_right_secret() {
    let f = fixture();
    let secret = f.register(1, "Salma");
    let tries = (0..tries::BURST_MAX).map(|_| f.enrol("Salma", "wrong"));
    for refused in futures::future::join_all(tries).await {
        assert_eq!(code(refused.verdict), Code::EnrolmentRefused);
    }
    assert_eq!(code(f.enrol("Salma", "wrong").await.verdict), Code::Overloaded);
    assert_eq!(code(f.enrol_from(2, "Salma", "wrong", &csr()).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Salma", &secret).await.verdict), Code::Ok, "even from the same address");
}

#[tokio::test]
async fn of_many_who_present_the_same_secret_at_once_one_is_enrolled() {
    let f = fixture();
    let secret = f.register(1, "Salma");
    let all = futures::future::join_all((0..16).map(|_| f.enrol("Salma", &secret))).await;
    assert_eq!(all.into_iter().filter(|enrolled| code(enrolled.verdict.clone()) == Code::Ok).count(), 1);
    assert_eq!(f.listed("Salma").unwrap().certificates.len(), 1);
}

#[tokio::test]
async fn a_secret_made_at_the_nodes_machine_works_at_once_and_without_the_ledger_which_learns_of_it_later() {
    let f = fixture();
    let directory = f.place.path().join("node1/ca/Org1");
    let secret = CertificateAuthority::open(&directory).unwrap().admin_secret("boss", NOW).unwrap();
    f.one.tell_carried("Org1").await.unwrap();
    let listed = f.listed("boss").unwrap();
    assert_eq!((listed.role, listed.local.unwrap().at.as_str()), (Role::Admin, "Org1/node1"));
    f.chain.reachable.store(false, Ordering::Relaxed);
    let request = csr();
    let enrolled = f.enrol_from(1, "boss", &secret, &request).await;
    assert_eq!(code(enrolled.verdict), Code::Ok);
    assert_eq!(f.enrol_from(1, "boss", &secret, &request).await.certificate, enrolled.certificate);
    f.chain.reachable.store(true, Ordering::Relaxed);
    f.one.tell_carried("Org1").await.unwrap();
    assert_eq!(f.listed("boss").unwrap().certificates.len(), 1);
    // Revoked over the network, the secret at the machine is void as well.
    f.admin(1, "revoke_identity", r#"{"name":"boss"}"#).unwrap();
    assert_eq!(code(f.enrol_from(1, "boss", &secret, &request).await.verdict), Code::EnrolmentRefused);
}

#[tokio::test]
async fn what_the_disk_knows_is_told_to_the_ledger_once() {
    let f = fixture();
    f.one.tell_carried("Org1").await.unwrap();
    let height = f.chain.ledger.tip().height;
    f.one.tell_carried("Org1").await.unwrap();
    assert_eq!(f.chain.ledger.tip().height, height, "there is nothing to tell any more");
    for name in ["Admin", "node1", "node2"] {
        assert_eq!(f.listed(name).unwrap().certificates.len(), 1, "{name}");
    }
    f.admin(1, "revoke_identity", r#"{"name":"node2"}"#).unwrap();
}

#[tokio::test]
async fn a_node_that_does_not_carry_the_ca_names_those_that_do() {
    let f = fixture();
    f.one.tell_carried("Org1").await.unwrap();
    let secret = f.register(1, "Salma");
    let request = v1::EnrolRequest { name: "Salma".into(), secret, request: csr() };
    for name in ["Salma", "Org1/Salma", "Nobody"] {
        let request = v1::EnrolRequest { name: name.into(), ..request.clone() };
        let answer = f.two.enrol(from(1, None, request)).await.unwrap().into_inner();
        assert_eq!(answer.carriers, ["node1:7450"]);
        let verdict = answer.verdict.unwrap();
        assert!(verdict.next.contains("Org1/node1 at node1:7450"), "{verdict:?}");
        assert_eq!(code(Some(verdict)), Code::CaElsewhere);
    }
    let renewed = f.two.renew(from(1, Some(f.identity(1)), v1::RenewRequest { request: csr() })).await.unwrap();
    assert_eq!(renewed.into_inner().carriers, ["node1:7450"]);
}

#[tokio::test]
async fn a_second_node_takes_the_ca_over_and_issues_and_who_brings_it_cannot_read_the_key() {
    let f = fixture();
    f.one.tell_carried("Org1").await.unwrap();
    let admin = Some(f.identity(1));
    let offer_of = |service: &EnrolmentService, organisation: &str| {
        let (service, request) = (service.clone(), v1::OfferCaRequest { organisation: organisation.into() });
        let admin = admin.clone();
        async move { service.offer_ca(from(1, admin, request)).await.unwrap().into_inner() }
    };
    assert_eq!(code(offer_of(&f.two, "Org2").await.verdict), Code::NotAdmin);
    let offer = offer_of(&f.two, "Org1").await;
    let seal = v1::SealCaRequest {
        organisation: "Org1".into(),
        node: offer.node,
        key: offer.key,
        signature: offer.signature,
        certificate: offer.certificate,
    };
    let sealed_for = |identity: Option<Arc<Identity>>, request: &v1::SealCaRequest| {
        let (service, request) = (f.one.clone(), request.clone());
        async move { service.seal_ca(from(1, identity, request)).await.unwrap().into_inner() }
    };
    // Nobody but an admin of the organisation, for nobody but a node of it, and for no key but the one it has signed.
    assert_eq!(code(sealed_for(None, &seal).await.verdict), Code::CertificateRequired);
    assert_eq!(code(sealed_for(Some(f.identity(2)), &seal).await.verdict), Code::NotAdmin);
    let mallory = v1::SealCaRequest { key: vec![9; 32].into(), ..seal.clone() };
    assert_eq!(code(sealed_for(admin.clone(), &mallory).await.verdict), Code::Untrusted);
    let person = v1::SealCaRequest { certificate: f.admins[0].certificate.clone(), ..seal.clone() };
    assert_ne!(code(sealed_for(admin.clone(), &person).await.verdict), Code::Ok);
    let sealed = sealed_for(admin.clone(), &seal).await;
    assert_eq!(code(sealed.verdict), Code::Ok);
    let key = std::fs::read_to_string(f.place.path().join("node1/ca/Org1/ca.key")).unwrap();
    let secret = SigningKey::from_pkcs8_pem(&key).unwrap().to_pkcs8_der().to_vec();
    assert!(!sealed.sealed.windows(16).any(|part| part == &secret[secret.len() - 16..]));

    let take = v1::TakeCaRequest { organisation: "Org1".into(), sealed: sealed.sealed, root: sealed.root };
    let bring = |request: v1::TakeCaRequest| {
        let (service, admin) = (f.two.clone(), admin.clone());
        async move { code(service.take_ca(from(1, admin, request)).await.unwrap().into_inner().verdict) }
    };
    assert_eq!(bring(v1::TakeCaRequest { root: vec![1].into(), ..take.clone() }).await, Code::BadArgument);
    assert_eq!(bring(v1::TakeCaRequest { sealed: vec![1; 80].into(), ..take.clone() }).await, Code::BadSignature);
    assert!(!f.two.carries("Org1"));
    assert_eq!(bring(take.clone()).await, Code::Ok);
    assert_eq!(bring(take).await, Code::Ok, "it can be done again");

    let salma = v1::EnrolRequest { name: "Salma".into(), secret: f.register(1, "Salma"), request: csr() };
    let first = f.two.enrol(from(1, None, salma.clone())).await.unwrap().into_inner();
    assert_eq!(code(first.verdict), Code::Ok);
    let again = f.one.enrol(from(1, None, salma)).await.unwrap().into_inner();
    assert_eq!(again.certificate, first.certificate, "any carrier answers a second try with the same certificate");
    assert_eq!(f.listed("Salma").unwrap().certificates[0].via, "Org1/node2");
}

#[tokio::test]
async fn a_ca_that_is_put_into_the_directory_of_a_running_node_is_noticed() {
    let f = fixture();
    let from_directory = CertificateAuthority::open(&f.place.path().join("node1/ca/Org1")).unwrap();
    let place = f.place.path().join("node2/ca");
    std::fs::create_dir_all(&place).unwrap();
    CertificateAuthority::install(&place.join("Org1"), "Org1", from_directory.key(), from_directory.root()).unwrap();
    assert!(!f.two.carries("Org1"));
    f.two.shared.authorities.look().unwrap();
    f.two.tell_carried("Org1").await.unwrap();
    let carriers = msp::carriers(&**f.chain.ledger.state()).unwrap();
    assert!(carriers.iter().any(|carrier| carrier.full_name() == "Org1/node2"));
}

#[tokio::test]
async fn a_carrier_whose_directory_is_gone_does_not_start_unless_it_was_given_up() {
    let f = fixture();
    f.one.tell_carried("Org1").await.unwrap();
    let data = f.place.path().join("node1");
    std::fs::rename(data.join("ca/Org1"), f.place.path().join("away")).unwrap();
    let check = || Authorities::open(&data, (365, 7)).unwrap().check_carried(&f.chain.ledger, &f.one.shared.own.me);
    let refused = check().unwrap_err();
    assert_eq!(refused.code, Code::BadFile);
    assert!(refused.found.contains("ca/Org1") && refused.advice().contains("ledgerd ca restore"), "{refused}");
    std::fs::write(given_up_file(&data, "Org1"), b"").unwrap();
    check().unwrap();
}

#[tokio::test]
async fn the_genesis_that_is_told_is_the_one_that_names_the_network() {
    let f = fixture();
    let answer = f.one.genesis(from(1, None, v1::GenesisRequest {})).await.unwrap().into_inner();
    assert_eq!(Genesis::from_bytes(&answer.genesis).unwrap().1, f.chain.ledger.network());
}

#[tokio::test]
async fn only_who_has_a_good_certificate_renews_it_and_gets_the_same_name_and_role() {
    let f = fixture();
    let renew = |caller: Option<Arc<Identity>>| {
        let service = f.one.clone();
        async move { service.renew(from(1, caller, v1::RenewRequest { request: csr() })).await.unwrap().into_inner() }
    };
    let good = f.identity(1);
    let other = |change: &dyn Fn(&mut Identity)| {
        let mut changed = (*good).clone();
        change(&mut changed);
        Some(Arc::new(changed))
    };
    for (caller, expected) in [
        (None, Code::CertificateRequired),
        (other(&|caller| caller.not_after = NOW - 1), Code::CertificateExpired),
        (other(&|caller| caller.organisation = "Org3".into()), Code::Untrusted),
        (other(&|caller| caller.name = "Nobody".into()), Code::NotFound),
        (other(&|caller| caller.role = Role::Member), Code::WrongRole),
    ] {
        assert_eq!(code(renew(caller).await.verdict), expected);
    }
    let renewed = renew(Some(Arc::clone(&good))).await;
    let identity = f.chain.ledger.msps().verify(&renewed.certificate, &[], NOW).unwrap();
    assert_eq!((identity.id(), identity.role), (good.id(), Role::Admin));
    assert_eq!(code(renew(Some(Arc::clone(&good))).await.verdict), Code::LimitExceeded, "just now");
    let salma = v1::EnrolRequest { name: "Salma".into(), secret: f.register(1, "Salma"), request: csr() };
    let enrolled = f.one.enrol(from(1, None, salma)).await.unwrap().into_inner();
    let salma = f.chain.ledger.msps().verify(&enrolled.certificate, &[], NOW).unwrap();
    f.admin(1, "revoke_identity", r#"{"name":"Salma"}"#).unwrap();
    assert_eq!(code(renew(Some(Arc::new(salma))).await.verdict), Code::Revoked);
}

#[tokio::test]
async fn a_request_to_join_is_carried_if_it_is_small_and_refused_ones_are_not_carried_without_end() {
    let f = fixture();
    let join = async |join: &[u8]| {
        let request = v1::JoinOrganisationRequest { join: Bytes::copy_from_slice(join) };
        code(f.one.join_organisation(from(1, None, request)).await.unwrap().into_inner().verdict)
    };
    assert_eq!(join(&vec![0; 64 * 1024 + 1]).await, Code::TooLarge);
    for _ in 0..tries::BURST_MAX {
        assert_eq!(join(b"forged").await, Code::BadArgument);
    }
    assert_eq!(join(b"forged").await, Code::Overloaded);
}

#[tokio::test]
async fn garbage_from_outside_is_refused_and_costs_nothing() {
    let f = fixture();
    let secret = f.register(1, "Salma");
    let long = "x".repeat(1 << 20);
    assert_eq!(code(f.enrol(&long, &long).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol("Salma", &long).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol(&format!("{long}/{long}"), &long).await.verdict), Code::EnrolmentRefused);
    assert_eq!(code(f.enrol_from(1, "Salma", &secret, &Bytes::from(long)).await.verdict), Code::BadArgument);
    assert_eq!(code(f.enrol("Salma", &secret).await.verdict), Code::Ok);
}
