//! Transactions in flight: their order, and which are given elsewhere.

use super::*;
use crate::v1::Verdict as Answered;
use ledger::transaction::{Body, NONCE_BYTES};
use ledger_identity::key::{KeyKind, SigningKey};
use ring::rand::SystemRandom;

fn transaction(key: &SigningKey, nonce: u8) -> Transaction {
    let (id, nonce) = (Bytes::from(vec![1; 32]), Bytes::from(vec![nonce; NONCE_BYTES]));
    let (chaincode, function) = ("abac".to_owned(), "set".to_owned());
    let body = Body {
        network: id.clone(),
        creator: id,
        nonce,
        not_after: 1,
        chaincode,
        function,
        args: Vec::new(),
        known_block: None,
    };
    Transaction::sign(&body, key).unwrap()
}

fn identity() -> TlsIdentity {
    let key = rcgen::KeyPair::generate().unwrap();
    let certificate = rcgen::CertificateParams::new(Vec::new()).unwrap().self_signed(&key).unwrap();
    let key = SigningKey::from_pkcs8_der(&key.serialize_der()).unwrap();
    TlsIdentity::new(vec![certificate.der().clone()], Arc::new(key)).unwrap()
}

#[tokio::test]
async fn what_is_new_does_not_overtake_what_a_node_could_not_take() {
    let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
    let table = InFlight::new(identity(), Duration::from_secs(60), false);
    let (outgoing, mut sent) = mpsc::unbounded_channel();
    table.attach(outgoing);
    let [first, second, third] = [1, 2, 3].map(|nonce| transaction(&key, nonce));
    let mut verdicts = Vec::new();
    for one in [&first, &second] {
        verdicts.push(table.add(one, table.room(one).await.unwrap(), Patience::Call));
        assert_eq!(sent.try_recv().unwrap().transaction, *one.encoded());
    }
    // The second is refused before the first, then comes a third.
    for one in [&second, &first] {
        let verdict = Answered::from(&Rejection::new(Code::NoLeader, "no leader is known"));
        let id = Bytes::copy_from_slice(one.id().as_ref());
        let answer = SubmitResponse { id, verdict: Some(verdict), ..SubmitResponse::default() };
        assert_eq!(table.answer(answer), Effect::Leave);
    }
    verdicts.push(table.add(&third, table.room(&third).await.unwrap(), Patience::Call));
    assert!(sent.try_recv().is_err(), "it rests with the others");
    table.sweep(Instant::now() + RETRY_AFTER, None, &LastAnswers::default());
    for one in [&first, &second, &third] {
        assert_eq!(sent.try_recv().unwrap().transaction, *one.encoded());
    }
}

#[tokio::test]
async fn a_call_without_an_answer_is_given_elsewhere_once_and_a_command_is_not() {
    let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
    let table = InFlight::new(identity(), Duration::from_secs(60), true);
    let [call, command, waits] = [1, 2, 3].map(|nonce| transaction(&key, nonce));
    let (outgoing, _sent) = mpsc::unbounded_channel();
    table.attach(outgoing);
    let _verdict = table.add(&call, table.room(&call).await.unwrap(), Patience::Call);
    let _verdict = table.add(&command, table.room(&command).await.unwrap(), Patience::Command);
    let now = Instant::now();
    assert!(table.unanswered(now).is_empty(), "it may still be answered");
    assert_eq!(table.unanswered(now + ELSEWHERE_AFTER), [call.encoded().clone()]);
    assert!(table.unanswered(now + 2 * ELSEWHERE_AFTER).is_empty());
    table.detach();
    let _verdict = table.add(&waits, table.room(&waits).await.unwrap(), Patience::Call);
    assert!(table.unanswered(now + 3 * ELSEWHERE_AFTER).is_empty(), "it was given to no node yet");
}
