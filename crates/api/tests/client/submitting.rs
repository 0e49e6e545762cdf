//! Transactions: executed once whatever happens to connections, and never silently lost.

use crate::authority::Authority;
use crate::fake::{Chain, Fake, Reaction, Records, until};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::{Call, Client, Context, Options, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use prost::Message as _;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn call(argument: &str) -> Call {
    let args = vec![Bytes::copy_from_slice(argument.as_bytes())];
    Call { chaincode: "abac".into(), function: "set".into(), args, ttl: Duration::from_secs(30) }
}

fn ids(received: &[Bytes]) -> Vec<Hash> {
    received.iter().map(|one| Transaction::decode(one.clone()).unwrap().id()).collect()
}

async fn impatient(context: &Context, deadline_ms: u64) -> Client {
    let options = Options { deadline: Duration::from_millis(deadline_ms), ..Options::default() };
    Client::connect_with(context.nodes.clone(), context.credentials().unwrap(), options).await.unwrap()
}

#[tokio::test]
async fn an_executed_call_answers_with_height_and_response() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let done = client.invoke("abac", "acquire", vec!["Turtlebot4".into()]).await.unwrap();
    assert_eq!((done.height, done.response), (1, Bytes::from("1")));
    assert_eq!(client.height_seen(), 1);
    assert_eq!(ids(&node.received()), [done.id]);
}

#[tokio::test]
async fn a_long_call_is_signed_by_its_id() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let context = authority.context(&[&node]);
    let client = Client::connect(&context).await.unwrap();
    client.invoke("abac", "set", vec![vec![7; 10_000].into()]).await.unwrap();
    let sent = v1::Transaction::decode(node.received()[0].clone()).unwrap();
    let message = [&b"ledgerd transaction id v1\0"[..], Hash::of(&[&sent.body]).as_ref()].concat();
    assert!(context.key.public_key().verify(&message, &sent.signature).is_ok());
    let whole = [&b"ledgerd transaction v1\0"[..], &sent.body].concat();
    assert!(context.key.public_key().verify(&whole, &sent.signature).is_err());
}

#[tokio::test]
async fn a_node_is_told_what_the_client_has_seen_so_that_it_does_not_judge_by_less() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    for _ in 0..3 {
        client.invoke("abac", "acquire", vec!["Turtlebot4".into()]).await.unwrap();
    }
    assert_eq!(node.min_heights(), [0, 1, 2]);
}

#[tokio::test]
async fn a_lost_connection_sends_the_same_bytes_through_the_next_node() {
    let authority = Arc::new(Authority::new());
    let chain = Arc::new(Chain::default());
    let first = Fake::with_chain(&authority, Arc::clone(&chain)).await;
    let second = Fake::with_chain(&authority, Arc::clone(&chain)).await;
    first.script(|_, _| Reaction::CommitSilently);
    let client = Client::connect(&authority.context(&[&first, &second])).await.unwrap();
    let pending = client.submit_nowait(&client.prepare(call("a")).unwrap());
    until("the first node has it", || !first.received().is_empty()).await;
    first.stop().await;
    let done = pending.await.unwrap();
    assert_eq!(first.received(), second.received(), "the very same bytes");
    assert_eq!(*chain.executed.lock().unwrap(), [(done.id, 1)].into(), "executed once");
    assert_eq!(*client.node(), *second.address());
}

#[tokio::test]
async fn a_single_node_that_restarts_gets_the_same_transaction_again() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, attempt| if attempt == 1 { Reaction::CommitSilently } else { Reaction::Commit });
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let pending = client.submit_nowait(&client.prepare(call("a")).unwrap());
    until("the node has it", || !node.received().is_empty()).await;
    node.stop().await;
    node.restart().await;
    assert_eq!(pending.await.unwrap().height, 1);
    assert_eq!(node.received().len(), 2);
}

#[tokio::test]
async fn what_waits_is_sent_again_in_the_order_of_submission() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, attempt| if attempt == 1 { Reaction::Ignore } else { Reaction::Commit });
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let pending: Vec<_> =
        (0..200).map(|n| client.submit_nowait(&client.prepare(call(&n.to_string())).unwrap())).collect();
    until("the node has all", || node.received().len() == 200).await;
    node.cut();
    for one in pending {
        one.await.unwrap();
    }
    let received = ids(&node.received());
    assert_eq!(received[..200], received[200..]);
}

#[tokio::test]
async fn a_node_that_never_answers_is_left_for_another_one() {
    let authority = Arc::new(Authority::new());
    let chain = Arc::new(Chain::default());
    let stuck = Fake::with_chain(&authority, Arc::clone(&chain)).await;
    let other = Fake::with_chain(&authority, chain).await;
    stuck.script(|_, _| Reaction::Ignore);
    let client = Client::connect(&authority.context(&[&stuck, &other])).await.unwrap();
    let done = client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(ids(&other.received()), [done.id]);
}

#[tokio::test]
async fn a_node_without_a_leader_is_left_for_another_one() {
    let authority = Arc::new(Authority::new());
    let (alone, other) = (Fake::start(&authority).await, Fake::start(&authority).await);
    alone.script(|_, _| Reaction::Refuse(Rejection::new(Code::NoLeader, "no leader is known")));
    let client = Client::connect(&authority.context(&[&alone, &other])).await.unwrap();
    let done = client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(ids(&other.received()), [done.id]);
}

#[tokio::test]
async fn a_node_with_a_full_disk_is_left_for_another_one_and_believed_where_there_is_none() {
    let authority = Arc::new(Authority::new());
    let (full, other) = (Fake::start(&authority).await, Fake::start(&authority).await);
    full.script(|_, _| Reaction::Refuse(Rejection::new(Code::DiskFull, "the disk is full")));
    let client = Client::connect(&authority.context(&[&full, &other])).await.unwrap();
    let done = client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(ids(&other.received()), [done.id]);
    let client = Client::connect(&authority.context(&[&full])).await.unwrap();
    assert_eq!(client.invoke("abac", "acquire", Vec::new()).await.unwrap_err().code, Code::DiskFull);
}

#[tokio::test]
async fn a_node_that_is_behind_is_left_for_another_one() {
    let authority = Arc::new(Authority::new());
    let (behind, other) = (Fake::start(&authority).await, Fake::start(&authority).await);
    behind.script(|_, _| Reaction::Refuse(Rejection::new(Code::Behind, "this node fetches blocks that it missed")));
    let client = Client::connect(&authority.context(&[&behind, &other])).await.unwrap();
    let done = client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(ids(&other.received()), [done.id]);
}

#[tokio::test]
async fn a_full_queue_is_tried_again_over_the_same_connection() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, attempt| match attempt {
        1 | 2 => Reaction::Refuse(Rejection::new(Code::Overloaded, "the queue is full")),
        _ => Reaction::Commit,
    });
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(node.received().len(), 3);
}

#[tokio::test]
async fn a_command_for_which_a_queue_is_full_is_refused_and_not_sent_behind_newer_ones() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, _| Reaction::Refuse(Rejection::new(Code::Overloaded, "the queue is full").found("full")));
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let refused = client.submit_nowait(&client.prepare(call("a")).unwrap()).await.unwrap_err();
    assert_eq!((refused.code, refused.found.as_str()), (Code::Overloaded, "full"), "what the node says");
    assert_eq!(node.received().len(), 1);
}

#[tokio::test]
async fn what_is_final_is_not_repeated() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let held = Rejection::new(Code::Held, "Turtlebot4/cmd_vel is held")
        .found("held by Org1/Farhad")
        .wanted("a free service")
        .next("wait");
    let refused = held.clone();
    node.script(move |_, _| Reaction::Refuse(refused.clone()));
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    assert_eq!(client.invoke("abac", "acquire", Vec::new()).await, Err(held));
    assert_eq!(node.received().len(), 1);
}

#[tokio::test]
async fn an_unknown_outcome_names_the_id() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, _| Reaction::Ignore);
    let client = impatient(&authority.context(&[&node]), 5_000).await;
    let transaction = client.prepare(call("a")).unwrap();
    let id = transaction.id();
    let refused = client.submit(transaction).await.unwrap_err();
    assert_eq!(refused.code, Code::Timeout);
    assert!(refused.message.contains("outcome is unknown"), "{refused}");
    assert!(refused.message.contains(&id.to_string()) && refused.advice().contains(&id.to_string()), "{refused}");
}

#[tokio::test]
async fn what_was_sent_before_the_node_went_away_is_unknown() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, _| Reaction::CommitSilently);
    let client = impatient(&authority.context(&[&node]), 5_000).await;
    let pending = client.submit_nowait(&client.prepare(call("a")).unwrap());
    until("the node has it", || !node.received().is_empty()).await;
    node.stop().await;
    assert_eq!(pending.await.unwrap_err().code, Code::Timeout);
}

#[tokio::test]
async fn a_lost_attempt_that_a_node_calls_expired_was_never_executed_and_is_signed_anew() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let first = Mutex::new(None);
    node.script(move |transaction, attempt| {
        let lost = *first.lock().unwrap().get_or_insert(transaction.id()) == transaction.id();
        match (lost, attempt) {
            (true, 1) => Reaction::Ignore,
            (true, _) => Reaction::Refuse(Rejection::new(Code::Expired, "came too late")),
            (false, _) => Reaction::Commit,
        }
    });
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let invoked = tokio::spawn(async move { client.invoke("abac", "acquire", Vec::new()).await });
    until("the node has it", || !node.received().is_empty()).await;
    node.cut();
    let done = invoked.await.unwrap().unwrap();
    let received = ids(&node.received());
    assert_eq!(received, [received[0], received[0], done.id]);
}

#[tokio::test]
async fn a_refusal_that_is_no_end_leaves_the_outcome_of_a_lost_attempt_unknown() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, attempt| match attempt {
        1 => Reaction::CommitSilently,
        _ => Reaction::Refuse(Rejection::new(Code::UnknownCreator, "whose is it?")),
    });
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    // The certificate came along, so nothing more can be tried.
    let invoked = tokio::spawn(async move { client.invoke("abac", "acquire", Vec::new()).await });
    until("the node has it", || !node.received().is_empty()).await;
    node.cut();
    assert_eq!(invoked.await.unwrap().unwrap_err().code, Code::Timeout);
}

#[tokio::test]
async fn only_what_no_node_has_seen_is_called_a_first_attempt() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, attempt| match attempt {
        1 => Reaction::Refuse(Rejection::new(Code::NoLeader, "no leader is known")),
        _ => Reaction::Commit,
    });
    let context = authority.context(&[&node]);
    let client = Client::connect(&context).await.unwrap();
    let transaction = client.prepare(call("a")).unwrap();
    client.submit(transaction.clone()).await.unwrap();
    assert_eq!(node.first_attempts(), [true, false], "the second may have been the first one's copy");
    client.submit(transaction.clone()).await.unwrap();
    let other = Client::connect(&context).await.unwrap();
    other.submit(transaction).await.unwrap();
    assert_eq!(node.first_attempts(), [true, false, false, false], "a program may have given it to anybody");
    other.submit_nowait(&other.prepare(call("b")).unwrap()).await.unwrap();
    assert!(node.first_attempts()[4]);
}

#[tokio::test]
async fn what_was_only_refused_is_not_called_unknown() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, _| Reaction::Refuse(Rejection::new(Code::NoLeader, "no leader is known")));
    let client = impatient(&authority.context(&[&node]), 5_000).await;
    assert_eq!(client.invoke("abac", "acquire", Vec::new()).await.unwrap_err().code, Code::NoLeader);
}

#[tokio::test]
async fn without_any_node_a_transaction_fails_as_unreachable() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = impatient(&authority.context(&[&node]), 5_000).await;
    node.stop().await;
    // A question finds the connection broken; from then on nothing is sent into it.
    assert_eq!(client.status().await.unwrap_err().code, Code::Unreachable);
    let refused = client.invoke("abac", "acquire", Vec::new()).await.unwrap_err();
    assert_eq!(refused.code, Code::Unreachable);
    assert!(refused.message.contains(&node.address()), "{refused}");
}

#[tokio::test]
async fn the_certificate_travels_until_a_transaction_is_executed() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let context = authority.context(&[&node]);
    let client = Client::connect(&context).await.unwrap();
    for _ in 0..2 {
        client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    }
    let came: Vec<_> = node
        .received()
        .into_iter()
        .map(|one| Transaction::decode(one).unwrap().certificate().map(|der| Hash::of(&[der])))
        .collect();
    assert_eq!(came, [Some(client.creator()), None]);
}

#[tokio::test]
async fn an_unknown_creator_is_introduced_under_the_same_id() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    node.script(|transaction, _| match transaction.certificate() {
        Some(_) => Reaction::Commit,
        None => Reaction::Refuse(Rejection::new(Code::UnknownCreator, "who is this")),
    });
    let done = client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(ids(&node.received())[1..], [done.id, done.id]);
}

#[tokio::test]
async fn dates_follow_the_clock_of_the_node_even_when_it_jumps() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.node.ahead.store(3_600_000_000, Ordering::SeqCst);
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    // An hour back: what is dated by the old clock lies too far ahead now, and is signed anew.
    node.node.ahead.store(0, Ordering::SeqCst);
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert_eq!(node.received().len(), 3);
}

#[tokio::test]
async fn the_same_transaction_submitted_twice_is_sent_once_and_answers_both() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    node.script(|_, attempt| if attempt == 1 { Reaction::Ignore } else { Reaction::Commit });
    let transaction = client.prepare(call("a")).unwrap();
    let (one, two) = (client.submit_nowait(&transaction), client.submit_nowait(&transaction));
    until("the node has it", || node.received().len() == 1).await;
    node.cut();
    assert_eq!(one.await.unwrap(), two.await.unwrap());
    assert_eq!(node.received().len(), 2, "once on each connection");
}

#[tokio::test]
async fn thousands_are_in_flight_on_one_stream_and_more_are_refused_at_once() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.script(|_, _| Reaction::Ignore);
    let client = impatient(&authority.context(&[&node]), 60_000).await;
    let pending: Vec<_> = (0..ledger_api::IN_FLIGHT_MAX)
        .map(|n| client.submit_nowait(&client.prepare(call(&n.to_string())).unwrap()))
        .collect();
    let refused = client.submit_nowait(&client.prepare(call("one more")).unwrap()).await.unwrap_err();
    assert_eq!(refused.code, Code::Overloaded);
    node.script(|_, _| Reaction::Commit);
    node.cut();
    for one in pending {
        one.await.unwrap();
    }
    client.invoke("abac", "set", Vec::new()).await.unwrap();
}

#[tokio::test]
async fn dropping_the_client_closes_its_connection_but_not_before_the_last_verdict() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let pending = client.submit_nowait(&client.prepare(call("a")).unwrap());
    drop(client);
    pending.await.unwrap();
    until("the connection is closed", || node.idle()).await;
}

#[tokio::test]
async fn an_expired_certificate_is_refused_with_the_reason() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let refused = Client::connect(&authority.expired(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::CertificateExpired, "{refused}");
    assert_eq!(refused.message, "the certificate of Org1/Salma has expired");
    assert!(refused.found.contains("2021-01-01"), "{refused}");
    assert!(
        refused.advice().starts_with("ask an admin of Org1 for: ledgerctl identity register Salma --reissue"),
        "{refused}"
    );
}

#[tokio::test]
async fn a_stranger_is_refused_with_the_reason_on_either_side() {
    let (authority, stranger) = (Arc::new(Authority::new()), Arc::new(Authority::new()));
    let node = Fake::start(&authority).await;
    // The node's certificate is not of an organisation that this context knows.
    let refused = Client::connect(&stranger.context(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::Untrusted, "{refused}");
    // The context knows the node, but not the other way round.
    let mut context = stranger.context(&[&node]);
    context.msps = authority.msps();
    let refused = Client::connect(&context).await.err().unwrap();
    assert_eq!(refused.code, Code::Untrusted, "{refused}");
    assert!(refused.message.contains("our certificate"), "{refused}");
}

#[tokio::test]
async fn a_node_of_another_network_is_refused() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    *node.node.network.lock().unwrap() = Hash([9; 32]);
    let refused = Client::connect(&authority.context(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::WrongNetwork);
}

#[tokio::test]
async fn a_closed_port_is_unreachable_and_the_next_node_is_used() {
    let authority = Arc::new(Authority::new());
    let (down, up) = (Fake::start(&authority).await, Fake::start(&authority).await);
    down.stop().await;
    let refused = Client::connect(&authority.context(&[&down])).await.err().unwrap();
    assert_eq!(refused.code, Code::Unreachable);
    assert!(refused.message.contains(&down.address()), "{refused}");
    let client = Client::connect(&authority.context(&[&down, &up])).await.unwrap();
    assert_eq!(*client.node(), *up.address());
}

#[tokio::test]
async fn a_call_that_a_node_executed_on_a_branch_of_its_own_is_reported_by_the_next_node_with_what_to_do() {
    let authority = Arc::new(Authority::new());
    // The second node has another branch.
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    *first.node.records.lock().unwrap() = Records::Silent;
    *second.node.records.lock().unwrap() = Records::Unknown;
    let client = Client::connect(&authority.context(&[&first, &second])).await.unwrap();
    let calls = client.invoke("abac", "acquire", vec!["Turtlebot4".into()]);
    let (refused, ()) = tokio::join!(calls, async {
        until("the client asks whether the call is certified", || first.node.asked.load(Ordering::Relaxed) > 0).await;
        // A certificate contradicts the first node, and it stops.
        first.stop().await;
    });
    let (refused, id) = (refused.unwrap_err(), ids(&first.received()).pop().unwrap());
    assert_eq!(refused.code, Code::Contradicted, "{refused}");
    assert!(refused.message.contains(&id.to_string()), "{refused}");
    assert!(refused.advice().contains("repeat calls that are still wanted"), "{refused}");
    assert!(second.received().is_empty(), "it is not signed or sent again by itself");
    // The client goes on with the other node.
    assert_eq!(client.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap_err().code, Code::Contradicted);
    *second.node.records.lock().unwrap() = Records::Known;
    client.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
    assert_eq!(*client.node(), *second.address());
}
