//! Bad input over the network: each kind gets a clear answer, and the node goes on as if nothing had been.

use crate::support::network::{message, now};
use crate::support::wire::{self, code, submit};
use crate::support::{Dice, Fleet, connect};
use crate::target::Target;
use bytes::Bytes;
use futures::StreamExt;
use ledger::transaction::Transaction;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_api::v1::enrolment_client::EnrolmentClient;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::{Client, Context, Enrolment, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use ledger_identity::msp::Msps;
use ledger_identity::{Identity, Role};
use ring::rand::SystemRandom;
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

const DAY: u64 = 24 * 60 * 60 * 1_000_000;

fn refused<T: std::fmt::Debug>(outcome: Result<T, Rejection>, code: Code, word: &str) -> Rejection {
    let refused = outcome.unwrap_err();
    assert_eq!(refused.code, code, "{refused}");
    assert!(refused.to_string().contains(word), "{word:?} is missing in: {refused}");
    refused
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn garbage_on_the_port_costs_nobody_anything() {
    let mut target = Target::start().await;
    let mut dice = Dice::roll("garbage");
    let address = target.salma.nodes[0].clone();
    let http = b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n".to_vec();
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec();
    let mut plain = vec![Vec::new(), http.clone(), preface.clone(), b"SSH-2.0-x\r\n".to_vec(), vec![0; 70_000]];
    // A record of TLS that says it is longer than it is, and one that is all noise.
    plain.push([&[22, 3, 1, 0xff, 0xff][..], &dice.bytes(300)].concat());
    plain.extend((0..6).map(|round| dice.bytes(1 << (2 * round))));
    for bytes in plain {
        let mut socket = TcpStream::connect(&address).await.unwrap();
        // The node may close while we write.
        let _closed = socket.write_all(&bytes).await;
        let _closed = socket.shutdown().await;
        let mut answer = Vec::new();
        let _reset = socket.read_to_end(&mut answer).await;
        assert!(!answer.starts_with(b"HTTP/1"), "an answer in plain text");
        target.survived("plain bytes").await;
    }
    // Properly encrypted garbage, from somebody with a certificate and from nobody.
    let mut frames = vec![http, preface.clone(), dice.bytes(5_000)];
    for (kind, length) in [(0_u8, 0x00ff_ffff_u32), (1, 16_000), (4, 5), (8, 4), (9, 100), (0x77, 9)] {
        let head = [&length.to_be_bytes()[1..], &[kind, 0xff], &dice.bytes(4)].concat();
        frames.push([preface.clone(), vec![0, 0, 0, 4, 0, 0, 0, 0, 0], head, dice.bytes(400)].concat());
    }
    for named in [true, false] {
        for bytes in &frames {
            let mut stream = wire::tls(&target.salma, named).await.unwrap();
            let _closed = stream.write_all(bytes).await;
            let _closed = stream.shutdown().await;
            let mut answer = Vec::new();
            let _reset = stream.read_to_end(&mut answer).await;
            target.survived("garbage in TLS").await;
        }
    }
    target.end("garbage");
}

#[tokio::test]
async fn without_a_certificate_one_can_only_enrol() {
    let mut target = Target::start().await;
    let channel = wire::channel(&target.salma, false).await;
    let mut gateway = GatewayClient::new(channel.clone());
    let statuses = [
        submit(&channel, target.signed(|_| ()).encoded().clone()).await.unwrap_err(),
        gateway.submit_stream(futures::stream::empty()).await.map(drop).unwrap_err(),
        gateway.query(v1::QueryRequest::default()).await.unwrap_err(),
        gateway.subscribe(v1::SubscribeRequest::default()).await.map(drop).unwrap_err(),
        gateway.status(v1::StatusRequest {}).await.unwrap_err(),
        gateway.get_block(v1::GetBlockRequest { height: 1 }).await.unwrap_err(),
        gateway.get_transaction(v1::GetTransactionRequest::default()).await.unwrap_err(),
        gateway.denials(v1::DenialsRequest::default()).await.unwrap_err(),
        PeerClient::new(channel.clone()).messages(futures::stream::empty()).await.unwrap_err(),
    ];
    for status in statuses {
        assert_eq!(status.code(), tonic::Code::Unauthenticated, "{status:?}");
        assert!(status.message().contains("certificate"), "{status:?}");
        target.survived("a call without a certificate").await;
    }
    let mut enrolment = EnrolmentClient::new(channel);
    let verdicts = [
        enrolment.renew(v1::RenewRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.offer_ca(v1::OfferCaRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.seal_ca(v1::SealCaRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.take_ca(v1::TakeCaRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.copy_ca(v1::CopyCaRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.restore_ca(v1::RestoreCaRequest::default()).await.unwrap().into_inner().verdict,
        enrolment.drop_ca(v1::DropCaRequest::default()).await.unwrap().into_inner().verdict,
    ];
    for verdict in verdicts {
        assert_eq!(verdict.unwrap().code, u32::from(Code::CertificateRequired.number()));
    }
    assert_eq!(enrolment.network(v1::NetworkRequest {}).await.unwrap().into_inner().label, "test");
    target.survived("a CA asked by nobody").await;
    target.end("no certificate");
}

#[tokio::test]
async fn a_secret_is_good_once_and_only_for_its_name() {
    let mut target = Target::start().await;
    let admin = connect(&target.admin).await;
    let attributes = BTreeMap::from([("Husky".to_owned(), "true".to_owned())]);
    let secret = admin.register("Nadia", Role::Member, &attributes).await.unwrap().secret;
    let other = admin.register("Omar", Role::Member, &BTreeMap::new()).await.unwrap().secret;
    refused(admin.register("Nadia", Role::Admin, &attributes).await.map(|_| ()), Code::AlreadyRegistered, "Nadia");
    let enrolment = Enrolment::new(target.salma.nodes[0].clone(), target.fleet.founded.authorities[0].fingerprint);
    for (name, wrong) in
        [("Nadia", other.as_str()), ("Nadia", ""), ("Nobody", &secret), ("Org2/Nadia", &secret), ("nadia", &secret)]
    {
        refused(enrolment.enrol(name, wrong, KeyKind::Ed25519).await, Code::EnrolmentRefused, "secret");
        target.survived("a wrong secret").await;
    }
    let pinned_wrongly = Enrolment::new(target.salma.nodes[0].clone(), Hash::of(&[b"another CA"]));
    refused(pinned_wrongly.enrol("Nadia", &secret, KeyKind::Ed25519).await, Code::Untrusted, "SHA-256");
    let nadia = enrolment.enrol("Nadia", &secret, KeyKind::P256).await.unwrap();
    refused(enrolment.enrol("Nadia", &secret, KeyKind::P256).await, Code::EnrolmentRefused, "secret");
    target.survived("a used secret").await;
    let salma = connect(&target.salma).await;
    refused(salma.register("Eve", Role::Admin, &BTreeMap::new()).await.map(|_| ()), Code::NotAdmin, "Salma");
    connect(&nadia).await.invoke("abac", "acquire", vec!["Husky".into()]).await.unwrap();
    target.end("enrolment");
}

#[tokio::test]
async fn certificates_of_strangers_and_of_other_times_are_refused() {
    let (past, future) = (now() - 10 * DAY, now() + 30 * DAY);
    let fleet = Fleet::found_at(1, past);
    let expired = fleet.issue_at("Late", past, 1);
    let early = fleet.issue_at("Early", future, 1);
    let foreign = Fleet::found(1);
    let mut target = Target::start_on(fleet).await;

    refused(Client::connect(&expired).await.map(drop), Code::CertificateExpired, "expired");
    target.survived("an expired certificate").await;
    let refusal = Client::connect(&early).await.map(drop).unwrap_err();
    assert!(matches!(refusal.code, Code::CertificateNotYetValid | Code::CertificateExpired), "{refusal}");
    assert!(refusal.message.contains("not valid yet"), "{refusal}");
    target.survived("a certificate of the future").await;

    // The same names, another CA; once with our trust, once with their own.
    let eve = foreign.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let eve_here = Context {
        nodes: target.salma.nodes.clone(),
        msps: Arc::clone(&target.salma.msps),
        network: target.salma.network,
        ..eve.clone()
    };
    refused(Client::connect(&eve_here).await.map(drop), Code::Untrusted, "network");
    target.survived("a certificate of another CA").await;
    let deceived = Context { nodes: target.salma.nodes.clone(), ..eve };
    refused(Client::connect(&deceived).await.map(drop), Code::WrongNetwork, "a different network");
    target.survived("a client of another network").await;
    // ledgerctl tells the same.
    target.fleet.ctl().as_("Late").run(&["status"]).refused(2, &["LGR-2002", "expired"]);
    target.end("certificates");
}

/// A fake node trusts everybody.
struct Anybody(Arc<Msps>);

impl TrustSource for Anybody {
    fn msps(&self) -> Arc<Msps> {
        Arc::clone(&self.0)
    }

    fn now(&self) -> u64 {
        now()
    }

    fn revoked(&self, _: &Identity) -> bool {
        false
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_users_certificate_is_no_nodes() {
    let mut target = Target::start().await;
    // A user who serves: whoever connects must notice.
    let identity = TlsIdentity::new(target.salma.chain.clone(), Arc::clone(&target.salma.key)).unwrap();
    let config = server_config(identity, Arc::new(Anybody(Arc::clone(&target.salma.msps)))).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let fake = listener.local_addr().unwrap().to_string();
    let accepting = tokio::spawn(async move {
        let acceptor = TlsAcceptor::from(Arc::new(config));
        while let Ok((socket, _)) = listener.accept().await {
            let _refused = acceptor.accept(socket).await;
        }
    });
    let context = Context { name: "deceived".into(), nodes: vec![fake.clone()], ..target.salma.clone() };
    context.save(&target.fleet.home()).unwrap();
    let ctl = target.fleet.ctl();
    let told = tokio::task::spawn_blocking(move || ctl.as_("deceived").run(&["status"])).await.unwrap();
    told.refused(2, &["LGR-2001", "CN=Salma", "serverAuth"]);
    let enrolment = Enrolment::new(fake, target.fleet.founded.authorities[0].fingerprint);
    let refusal = enrolment.enrol("Eve", "00", KeyKind::Ed25519).await.unwrap_err();
    assert!(matches!(refusal.code, Code::WrongRole | Code::Untrusted), "{refusal}");
    accepting.abort();
    target.survived("a user who serves").await;

    // A user who speaks to the orderer.
    let channel = wire::channel(&target.salma, true).await;
    let frames = futures::stream::iter([v1::PeerFrame { message: Bytes::from_static(&[1, 2, 3]) }]);
    let status = PeerClient::new(channel).messages(frames.boxed()).await.unwrap_err();
    assert_eq!(status.code(), tonic::Code::PermissionDenied, "{status:?}");
    assert!(status.message().contains("Org1/Salma"), "{status:?}");
    target.survived("a user who speaks to the orderer").await;
    target.end("roles");
}

#[tokio::test]
async fn bytes_that_are_no_good_transaction_are_refused_each_with_its_code() {
    let mut target = Target::start().await;
    let channel = wire::channel(&target.salma, true).await;
    let good = target.signed(|body| body.args = vec![]);
    let mut dice = Dice::roll("bytes");
    for bytes in [Vec::new(), vec![0], vec![0xff; 100], dice.bytes(1000), b"{\"function\":\"set\"}".to_vec()] {
        assert_eq!(code(&submit(&channel, bytes).await.unwrap()), 1001);
        target.survived("no transaction").await;
    }
    // Cut at every length: never the transaction, never an end of the node.
    let bytes = good.encoded().clone();
    for cut in 0..bytes.len() {
        let answer = submit(&channel, bytes.slice(..cut)).await.unwrap();
        assert!((1000..3000).contains(&code(&answer)), "cut at {cut}: {answer:?}");
        target.faults += 1;
    }
    target.survived("cut transactions").await;
    // Every bit of it matters.
    for at in (0..bytes.len()).step_by(3) {
        let mut changed = bytes.to_vec();
        changed[at] ^= 1 << dice.below(8);
        let answer = submit(&channel, changed).await.unwrap();
        assert!((1000..3000).contains(&code(&answer)), "byte {at}: {answer:?}");
        target.faults += 1;
    }
    target.survived("changed transactions").await;

    let strange = Hash::of(&[b"elsewhere"]);
    let stranger = ledger_identity::key::SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
    let cases = [
        (1003, target.signed(|body| body.network = Bytes::copy_from_slice(&strange.0))),
        (1005, target.signed(|body| body.creator = Bytes::copy_from_slice(&strange.0))),
        (1006, target.signed(|body| body.not_after = now() - 1_000_000)),
        (1007, target.signed(|body| body.not_after = now() + 3_600_000_000)),
        (1009, target.signed(|body| body.chaincode = "abacus".into())),
        (1010, target.signed(|body| body.function = "aquire".into())),
        (1004, Transaction::sign(&target.body(), &stranger).unwrap()),
    ];
    for (wanted, transaction) in cases {
        let answer = submit(&channel, transaction.encoded().clone()).await.unwrap();
        assert_eq!(u64::from(code(&answer)), wanted, "{answer:?}");
        target.survived("a transaction that is not good").await;
    }
    target.end("bytes");
}

#[tokio::test]
async fn wrong_calls_are_refused_with_what_was_wanted() {
    let mut target = Target::start().await;
    let client = target.client.clone();
    let call = async |function: &str, args: &[&str]| {
        let args = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        client.invoke("abac", function, args).await
    };
    refused(call("acquire", &["Turtlebot"]).await, Code::UnknownRobot, "Turtlebot4");
    refused(call("acquire", &["Turtlebot4/cmd"]).await, Code::UnknownService, "cmd_vel");
    refused(call("aquire", &["Turtlebot4"]).await, Code::UnknownFunction, "acquire");
    refused(client.invoke("acab", "acquire", vec![]).await, Code::UnknownChaincode, "abac");
    refused(call("acquire", &[]).await, Code::BadArgument, "SERVICE");
    refused(call("acquire", &["Turtlebot4", "soon"]).await, Code::BadArgument, "soon");
    refused(call("set", &["Turtlebot4", "one", "1", "\0\u{1}\0\0"]).await, Code::BadArgument, "EPOCH");
    refused(call("set", &["Turtlebot4", "1", "5", "no CDR"]).await, Code::BadArgument, "CDR");
    refused(call("set", &["Turtlebot4", "99", "5", "\0\u{1}\0\0"]).await, Code::StaleEpoch, "99");
    refused(call("setup", &["{not json"]).await, Code::NotAdmin, "admin");
    let not_text = client.invoke("abac", "acquire", vec![Bytes::from_static(&[0xff, 0xfe])]).await;
    refused(not_text, Code::BadArgument, "SERVICE");
    for _ in 0..11 {
        target.survived("a wrong call").await;
    }
    target.end("calls");
}

#[tokio::test]
async fn a_replay_gets_the_first_verdict_and_changes_nothing() {
    let mut target = Target::start().await;
    let channel = wire::channel(&target.salma, true).await;
    let acquire = target.signed(|body| {
        body.function = "acquire".into();
        body.args = vec!["Husky".into()];
    });
    let first = submit(&channel, acquire.encoded().clone()).await.unwrap();
    assert_eq!(code(&first), 0, "{first:?}");
    // The hash of the block comes with what was executed just now.
    assert_eq!(first.block_hash.len(), 8, "{first:?}");
    let first = v1::SubmitResponse { block_hash: Bytes::new(), ..first };
    for _ in 0..5 {
        assert_eq!(submit(&channel, acquire.encoded().clone()).await.unwrap(), first);
        target.survived("a replay").await;
    }
    // Somebody else sends it.
    let mallory = wire::channel(&target.admin, true).await;
    assert_eq!(submit(&mallory, acquire.encoded().clone()).await.unwrap(), first);
    // The nonce again, for something else: another transaction, which stands for itself.
    let mut body = acquire.body().clone();
    body.function = "release".into();
    let release = Transaction::sign(&body, &target.salma.key).unwrap();
    assert_ne!(release.id(), acquire.id());
    let released = submit(&channel, release.encoded().clone()).await.unwrap();
    assert_eq!(code(&released), 0, "{released:?}");
    // And once more the first: it does not acquire again.
    assert_eq!(submit(&channel, acquire.encoded().clone()).await.unwrap(), first);
    let husky = target.client.query("abac", "robot", vec!["Husky".into()]).await.unwrap().response;
    assert!(String::from_utf8_lossy(&husky).contains("\"UnderOp\":false"), "{husky:?}");
    let block = target.client.block(first.height).await.unwrap();
    assert_eq!(block.transactions.iter().filter(|found| found.id == first.id).count(), 1);
    target.survived("a nonce used twice").await;
    target.end("replay");
}

#[tokio::test]
async fn what_is_too_large_is_refused_by_the_configured_limit() {
    let fleet = Fleet::found(1);
    fleet.nodes[0].configure("[limits]\npayload_bytes_max = 1048576");
    let mut target = Target::start_on(fleet).await;
    let channel = wire::channel(&target.salma, true).await;
    let sized = |target: &Target, bytes: usize, seq: u64| {
        let arguments = message(1, seq, &vec![7; bytes]);
        target.signed(|body| (body.function, body.args) = ("set".into(), arguments))
    };
    // For the whole transaction.
    for (bytes, seq) in [(1 << 20, 1), ((1 << 20) + 1, 2), (2 << 20, 3)] {
        let answer = submit(&channel, sized(&target, bytes, seq).encoded().clone()).await.unwrap();
        assert_eq!(code(&answer), 1002, "{bytes}: {:?}", answer.verdict);
        assert!(answer.verdict.unwrap().wanted.contains("1048576"));
        target.survived("a large transaction").await;
    }
    target.faults += 1;
    let next = 1_000_000 + target.faults;
    let fits = submit(&channel, sized(&target, (1 << 20) - 1000, next).encoded().clone()).await.unwrap();
    assert_eq!(code(&fits), 0, "{:?}", fits.verdict);
    // More than gRPC takes in at all.
    let status = submit(&channel, vec![0; 40 << 20]).await;
    assert!(
        status.as_ref().is_err_and(|status| !status.message().is_empty())
            || status.is_ok_and(|answer| code(&answer) == 1002)
    );
    target.survived("40 MiB").await;
    target.end("size");

    let fleet = Fleet::found(1);
    fleet.nodes[0].configure("[limits]\npayload_bytes_max = 2000");
    let mut small = Target::start_on(fleet).await;
    let channel = wire::channel(&small.salma, true).await;
    assert_eq!(code(&submit(&channel, sized(&small, 2000, 1).encoded().clone()).await.unwrap()), 1002);
    let refusal = small.client.invoke("abac", "set", message(1, 2, &[7; 2000])).await;
    refused(refusal, Code::TooLarge, "2000");
    assert_eq!(code(&submit(&channel, sized(&small, 1000, 3).encoded().clone()).await.unwrap()), 0);
    small.survived("more than configured").await;
    small.end("configured size");
}
