//! Calls that change nothing.

use crate::authority::Authority;
use crate::fake::Fake;
use ledger_api::Client;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;

#[tokio::test]
async fn a_query_reads_what_the_client_has_written() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    assert_eq!(client.query("abac", "robot", Vec::new()).await.unwrap().height, 0);
    let done = client.invoke("abac", "setup", Vec::new()).await.unwrap();
    assert_eq!(client.query("abac", "robot", Vec::new()).await.unwrap().height, done.height);
}

#[tokio::test]
async fn a_query_is_repeated_until_the_node_can_answer() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    node.node
        .not_now
        .lock()
        .unwrap()
        .extend([Rejection::new(Code::Behind, "not there yet"), Rejection::new(Code::Overloaded, "too much")]);
    client.query("abac", "robot", Vec::new()).await.unwrap();
    assert!(node.node.not_now.lock().unwrap().is_empty());
}

#[tokio::test]
async fn a_refused_query_is_not_repeated() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let refused = Rejection::new(Code::UnknownRobot, "no robot \"Husk\"").next("did you mean \"Husky\"?");
    let waiting = [Rejection::new(Code::Internal, "never asked"), refused.clone()];
    node.node.not_now.lock().unwrap().extend(waiting);
    assert_eq!(client.query("abac", "robot", Vec::new()).await, Err(refused));
    assert_eq!(node.node.not_now.lock().unwrap().len(), 1);
}

#[tokio::test]
async fn questions_survive_the_loss_of_a_node() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    let client = Client::connect(&authority.context(&[&first, &second])).await.unwrap();
    first.stop().await;
    second.node.height.send_replace(42);
    assert_eq!(client.status().await.unwrap().height, 42);
    let id = Hash([3; 32]);
    assert_eq!(client.transaction(id).await.unwrap().id, id.as_ref());
}

#[tokio::test]
async fn refusals_of_whole_calls_keep_their_code_and_their_lines() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let missing = client.block(9).await.unwrap_err();
    assert_eq!((missing.code, missing.advice()), (Code::NotFound, "wait for it"));
    assert!(client.denials(0).await.unwrap().is_empty());
}
