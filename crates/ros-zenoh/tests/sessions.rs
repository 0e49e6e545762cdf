//! Two sessions over a router.

use std::time::Duration;

use ros_zenoh::{
    error::Error,
    key::Subject,
    node::Node,
    qos::TokenQos,
    settings::{Mode, Settings},
    subscriber::Incoming,
    token::Kind,
};

use crate::support::{
    BYTES_MAX, DEADLINE, DOMAIN, Received, client_of, free_endpoint, graph, latched, message, router, seen, subject,
    until,
};

#[tokio::test(flavor = "multi_thread")]
async fn messages_pass_with_the_number_time_and_identifier_of_their_publisher() {
    let (_router, [one, other]) = graph().await;
    let topic = subject("/cmd_vel");
    let received = Received::open(&other, &topic, TokenQos::default());
    let own = Received::open(&one, &topic, TokenQos::default());
    let publisher = one.publisher(&topic, TokenQos::default()).unwrap();
    until("the subscriber is seen", || seen(&one, Kind::Subscriber, "/cmd_vel").len() == 1).await;
    until("the publisher is seen", || seen(&other, Kind::Publisher, "/cmd_vel") == [publisher.gid()]).await;
    for number in 1..=3 {
        publisher.publish(message(number)).unwrap();
    }
    let messages = received.messages(3).await;
    let mut last = 0;
    for (number, (bytes, attachment)) in (1..).zip(messages) {
        assert_eq!((bytes, attachment.sequence), (message(number), i64::from(number)));
        assert_eq!(attachment.gid, publisher.gid());
        assert!(attachment.time >= last);
        last = attachment.time;
    }
    assert_eq!(own.count(), 0, "the own messages do not come back");
    drop(publisher);
    until("the publisher has left", || seen(&other, Kind::Publisher, "/cmd_vel").is_empty()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_that_is_too_long_is_told_and_not_copied() {
    let (_router, [one, other]) = graph().await;
    let topic = subject("/image");
    let received = Received::open(&other, &topic, TokenQos::default());
    let publisher = one.publisher(&topic, TokenQos::default()).unwrap();
    until("the subscriber is seen", || seen(&one, Kind::Subscriber, "/image").len() == 1).await;
    publisher.publish(vec![7; BYTES_MAX + 1].into()).unwrap();
    publisher.publish(vec![7; BYTES_MAX].into()).unwrap();
    let taken = received.take(2).await;
    assert!(matches!(taken[0], Incoming::TooLong(bytes) if bytes == BYTES_MAX + 1), "{taken:?}");
    assert!(matches!(&taken[1], Incoming::Message(bytes, _) if bytes.len() == BYTES_MAX), "{taken:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_late_to_a_latched_topic_gets_the_last_messages_in_order_and_once() {
    let (_router, [one, other]) = graph().await;
    let topic = subject("/map");
    let publisher = one.publisher(&topic, latched(2)).unwrap();
    for number in 1..=4 {
        publisher.publish(message(number)).unwrap();
    }
    until("the publisher is seen", || seen(&other, Kind::Publisher, "/map").len() == 1).await;
    let late = Received::open(&other, &topic, latched(2));
    let volatile = Received::open(&other, &topic, TokenQos::default());
    let numbers = |messages: &[(bytes::Bytes, _)]| messages.iter().map(|(bytes, _)| bytes[4]).collect::<Vec<_>>();
    assert_eq!(numbers(&late.messages(2).await), [3, 4]);
    publisher.publish(message(5)).unwrap();
    assert_eq!(numbers(&late.messages(1).await), [5]);
    assert_eq!(numbers(&volatile.messages(1).await), [5], "a volatile subscriber gets nothing old");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_type_with_another_definition_is_not_heard_and_one_whose_hash_is_not_known_is() {
    let (_router, [one, other]) = graph().await;
    let topic = subject("/cmd_vel");
    let unknown = Subject { hash: None, ..topic.clone() };
    let different = Subject { hash: Some(format!("RIHS01_{}", "0b".repeat(32))), ..topic.clone() };
    let (exact, any) =
        (Received::open(&other, &topic, TokenQos::default()), Received::open(&other, &unknown, TokenQos::default()));
    let [known, differs, without] =
        [&topic, &different, &unknown].map(|topic| one.publisher(topic, TokenQos::default()).unwrap());
    until("the subscribers are seen", || seen(&one, Kind::Subscriber, "/cmd_vel").len() == 2).await;
    for (publisher, number) in [(&known, 1), (&differs, 2), (&without, 3)] {
        publisher.publish(message(number)).unwrap();
    }
    let numbers = |messages: Vec<(bytes::Bytes, _)>| messages.iter().map(|(bytes, _)| bytes[4]).collect::<Vec<_>>();
    assert_eq!(numbers(any.messages(3).await), [1, 2, 3]);
    assert_eq!(numbers(exact.messages(2).await), [1, 3]);

    let kept = one.publisher(&unknown, latched(1)).unwrap();
    kept.publish(message(4)).unwrap();
    until("the publisher is seen", || seen(&other, Kind::Publisher, "/cmd_vel").len() == 4).await;
    let late = Received::open(&other, &topic, latched(1));
    assert_eq!(numbers(late.messages(1).await), [4], "also for those who come late");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_know_the_hash_calls_a_server_that_has_one() {
    let (_router, [one, other]) = graph().await;
    let service = subject("/reset");
    let unknown = Subject { hash: None, ..service.clone() };
    let mut client = other.client(&unknown, TokenQos::default(), BYTES_MAX, DEADLINE).unwrap();
    let mut server = one.server(&service, TokenQos::default(), BYTES_MAX).unwrap();
    until("the server is seen", || seen(&other, Kind::Server, "/reset").len() == 1).await;
    client.call(message(1)).unwrap();
    let request = tokio::time::timeout(DEADLINE, server.next()).await.unwrap().unwrap();
    server.reply(&request.id, message(2)).unwrap();
    assert_eq!(client.next().await.unwrap().message, message(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_replies_to_the_client_that_has_called() {
    let (_router, [one, other]) = graph().await;
    for hash in [subject("").hash, None] {
        let service = Subject { hash, ..subject("/reset") };
        let mut server = one.server(&service, TokenQos::default(), BYTES_MAX).unwrap();
        let mut client = other.client(&service, TokenQos::default(), BYTES_MAX, DEADLINE).unwrap();
        until("the server is seen", || seen(&other, Kind::Server, "/reset").len() == 1).await;
        until("the client is seen", || seen(&one, Kind::Client, "/reset").len() == 1).await;
        let numbers = [client.call(message(1)).unwrap(), client.call(message(2)).unwrap()];
        let requests = [server.next().await.unwrap(), server.next().await.unwrap()];
        for (number, request) in numbers.iter().zip(&requests) {
            assert_eq!(request.id, (client.gid(), *number));
        }
        // The second one first.
        for (request, reply) in requests.iter().rev().zip([22, 11]) {
            server.reply(&request.id, message(reply)).unwrap();
        }
        let replies = [client.next().await.unwrap(), client.next().await.unwrap()];
        assert_eq!(
            replies.each_ref().map(|reply| (reply.number, reply.message[4])),
            [(numbers[1], 22), (numbers[0], 11)]
        );
        assert!(matches!(server.reply(&requests[0].id, message(1)), Err(Error::NotWaiting)));
        drop((server, client));
        until("both have left", || seen(&other, Kind::Server, "/reset").is_empty()).await;
        until("both have left", || seen(&one, Kind::Client, "/reset").is_empty()).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_too_long_has_no_reply_and_is_counted() {
    let (_router, [one, other]) = graph().await;
    let service = subject("/reset");
    let mut server = one.server(&service, TokenQos::default(), BYTES_MAX).unwrap();
    let client = other.client(&service, TokenQos::default(), BYTES_MAX, DEADLINE).unwrap();
    until("the server is seen", || seen(&other, Kind::Server, "/reset").len() == 1).await;
    client.call(vec![7; BYTES_MAX + 1].into()).unwrap();
    client.call(message(1)).unwrap();
    assert_eq!(server.next().await.unwrap().message, message(1));
    assert_eq!(server.dropped(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_comes_back_brings_the_graph_back() {
    let endpoint = free_endpoint();
    let first = router(&endpoint).await;
    let one = Node::join(DOMAIN, "one", &client_of(&endpoint)).await.unwrap();
    let other = Node::join(DOMAIN, "other", &client_of(&endpoint)).await.unwrap();
    let topic = subject("/cmd_vel");
    let received = Received::open(&other, &topic, TokenQos::default());
    let publisher = one.publisher(&topic, TokenQos::default()).unwrap();
    until("both are seen", || !seen(&other, Kind::Publisher, "/cmd_vel").is_empty()).await;
    first.end();
    drop(first);
    until("nobody is seen without a router", || seen(&other, Kind::Publisher, "/cmd_vel").is_empty()).await;
    let _second = router(&endpoint).await;
    until("both are seen again", || !seen(&other, Kind::Publisher, "/cmd_vel").is_empty()).await;
    until("both are seen again", || !seen(&one, Kind::Subscriber, "/cmd_vel").is_empty()).await;
    publisher.publish(message(9)).unwrap();
    assert_eq!(received.messages(1).await[0].0, message(9));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_without_a_router_does_not_join_and_says_so() {
    let refused = Node::join(DOMAIN, "one", &client_of(&free_endpoint())).await.unwrap_err();
    assert!(refused.to_string().contains("127.0.0.1"), "{refused}");
}

#[tokio::test]
async fn a_runtime_without_worker_threads_is_refused_before_zenoh_panics() {
    let refused = Node::join(DOMAIN, "one", &client_of(&free_endpoint())).await.unwrap_err();
    assert!(refused.to_string().contains("worker threads"), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn peers_meet_without_a_router_if_one_connects_to_the_other() {
    let endpoint = free_endpoint();
    let peer = |listen: &str, connect: Option<&str>| Settings {
        mode: Mode::Peer,
        listen: vec![listen.parse().unwrap()],
        connect: connect.iter().map(|endpoint| endpoint.parse().unwrap()).collect(),
        ..Settings::default()
    };
    let one = Node::join(DOMAIN, "one", &peer(&endpoint, None)).await.unwrap();
    let other = Node::join(DOMAIN, "other", &peer("tcp/127.0.0.1:0", Some(&endpoint))).await.unwrap();
    let topic = subject("/cmd_vel");
    let received = Received::open(&other, &topic, TokenQos::default());
    let publisher = one.publisher(&topic, TokenQos::default()).unwrap();
    until("the subscriber is seen", || seen(&one, Kind::Subscriber, "/cmd_vel").len() == 1).await;
    publisher.publish(message(1)).unwrap();
    assert_eq!(received.messages(1).await[0].0, message(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_has_ended_refuses_to_publish_and_to_call() {
    let (_router, [one, _other]) = graph().await;
    let publisher = one.publisher(&subject("/cmd_vel"), TokenQos::default()).unwrap();
    let client = one.client(&subject("/reset"), TokenQos::default(), BYTES_MAX, Duration::from_secs(1)).unwrap();
    assert!(!one.is_ended());
    one.end();
    assert!(one.is_ended());
    assert!(matches!(publisher.publish(message(1)), Err(Error::Ended)));
    assert!(matches!(client.call(message(1)), Err(Error::Ended)));
}
