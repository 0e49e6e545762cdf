//! First contact: only the fingerprint of the CA is known.

use crate::authority::{Authority, NETWORK};
use crate::fake::Fake;
use ledger_api::{Client, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use std::sync::Arc;

#[tokio::test]
async fn a_secret_becomes_a_context_that_connects_with_either_kind_of_key() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    *node.node.addresses.lock().unwrap() = vec!["node2.example:7450".into()];
    for kind in [KeyKind::Ed25519, KeyKind::P256] {
        let enrolment = Enrolment::new(node.address(), authority.fingerprint());
        let context = enrolment.enrol("Salma", "secret", kind).await.unwrap();
        assert_eq!((context.name.as_str(), context.organisation.as_str()), ("Salma", "Org1"));
        assert_eq!((context.network, context.key.kind()), (NETWORK, kind));
        assert_eq!(context.nodes, [node.address(), "node2.example:7450".to_owned()]);
        assert_eq!(context.ca_fingerprint("Org1"), Some(authority.fingerprint()));
        let client = Client::connect(&context).await.unwrap();
        client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    }
}

#[tokio::test]
async fn another_ca_than_the_pinned_one_learns_nothing() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let enrolment = Enrolment::new(node.address(), Hash([1; 32]));
    let refused = enrolment.enrol("Salma", "secret", KeyKind::Ed25519).await.unwrap_err();
    assert_eq!(refused.code, Code::Untrusted);
    assert_eq!(enrolment.network().await.unwrap_err().code, Code::Untrusted);
}

#[tokio::test]
async fn a_wrong_secret_is_refused_in_the_words_of_the_ca() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let enrolment = Enrolment::new(node.address(), authority.fingerprint());
    let refused = enrolment.enrol("Salma", "guess", KeyKind::Ed25519).await.unwrap_err();
    assert_eq!((refused.code, refused.advice()), (Code::EnrolmentRefused, "ask an admin for another"));
}

#[tokio::test]
async fn a_certificate_of_another_key_name_or_ca_is_not_stored() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let enrolment = Enrolment::new(node.address(), authority.fingerprint());
    let other_key = authority.stored().chain[0].to_vec();
    let other_ca = Authority::new().stored().chain[0].to_vec();
    *node.node.name.lock().unwrap() = Some("Farhad".into());
    let refused = enrolment.enrol("Salma", "secret", KeyKind::Ed25519).await.unwrap_err();
    assert!(refused.code == Code::Untrusted && refused.found.contains("Farhad"), "{refused}");
    for (certificate, what) in
        [(other_key, "another key"), (other_ca, "another CA"), (b"garbage".to_vec(), "no certificate")]
    {
        *node.node.certificate.lock().unwrap() = Some(certificate.into());
        let refused = enrolment.enrol("Salma", "secret", KeyKind::Ed25519).await.unwrap_err();
        let codes = [Code::Untrusted, Code::CertificateMalformed];
        assert!(codes.contains(&refused.code), "{what}: {refused}");
    }
}

#[tokio::test]
async fn nobody_listening_is_unreachable() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.stop().await;
    let refused = Enrolment::new(node.address(), authority.fingerprint()).network().await.unwrap_err();
    assert_eq!(refused.code, Code::Unreachable);
}
