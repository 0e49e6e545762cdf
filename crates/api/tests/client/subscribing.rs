//! Subscriptions: every block once, in order, over any number of connections.

use crate::authority::Authority;
use crate::fake::{Fake, until, wall_clock};
use ledger_api::{Client, EventStream, Subscription};
use std::sync::Arc;
use std::sync::atomic::Ordering;

async fn heights(stream: &mut EventStream, count: usize) -> Vec<u64> {
    let mut heights = Vec::new();
    while heights.len() < count {
        let delivery = stream.next().await.unwrap();
        if !delivery.events.is_empty() {
            heights.push(delivery.height);
        }
    }
    heights
}

#[tokio::test]
async fn a_cut_subscription_resumes_after_the_last_delivery_through_another_node() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    for node in [&first, &second] {
        node.node.height.send_replace(3);
    }
    let client = Client::connect(&authority.context(&[&first, &second])).await.unwrap();
    let mut stream = client.subscribe(Subscription { from_height: 1, ..Subscription::default() });
    assert_eq!(heights(&mut stream, 3).await, [1, 2, 3]);
    first.stop().await;
    second.node.height.send_replace(6);
    assert_eq!(heights(&mut stream, 3).await, [4, 5, 6]);
    assert_eq!(second.node.subscriptions.lock().unwrap()[0].from_height, 4);
    assert_eq!(client.height_seen(), 6);
}

#[tokio::test]
async fn a_node_that_told_of_a_block_that_does_not_exist_makes_no_stream_deaf_at_the_next_one() {
    let authority = Arc::new(Authority::new());
    let (liar, honest) = (Fake::start(&authority).await, Fake::start(&authority).await);
    liar.node.height.send_replace(2);
    let client = Client::connect(&authority.context(&[&liar, &honest])).await.unwrap();
    let mut stream = client.subscribe(Subscription { from_height: 1, heartbeat: 50, ..Subscription::default() });
    assert_eq!(heights(&mut stream, 2).await, [1, 2]);
    liar.node.beat.store(u64::MAX - 1, Ordering::Relaxed);
    while stream.next_height() < u64::MAX {
        stream.next().await.unwrap();
    }
    liar.stop().await;
    honest.node.height.send_replace(4);
    assert_eq!(heights(&mut stream, 4).await, [1, 2, 3, 4], "from where it was before the liar");
    assert_eq!(stream.next_height(), 5);
}

#[tokio::test]
async fn a_stream_that_begins_at_the_next_block_of_a_liar_misses_nothing_at_the_next_node() {
    for heartbeat in [0, 50] {
        let authority = Arc::new(Authority::new());
        let (liar, honest) = (Fake::start(&authority).await, Fake::start(&authority).await);
        liar.node.height.send_replace(900);
        honest.node.height.send_replace(5);
        let client = Client::connect(&authority.context(&[&liar, &honest])).await.unwrap();
        let mut stream = client.subscribe(Subscription { heartbeat, ..Subscription::default() });
        stream.open().await.unwrap();
        assert_eq!(stream.next_height(), 901, "by the word of the liar");
        // Five blocks are old; two came after the stream had begun.
        *honest.node.times.lock().unwrap() = (1..=5).map(|block| wall_clock() - 60_000_000 + block).collect();
        honest.node.height.send_replace(7);
        liar.stop().await;
        assert_eq!(heights(&mut stream, 2).await, [6, 7], "heartbeat {heartbeat}");
        assert_eq!(stream.next_height(), 8);
    }
}

#[tokio::test]
async fn from_the_next_block_means_the_same_block_after_a_cut() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.node.height.send_replace(5);
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let mut stream = client.subscribe(Subscription::default());
    let reading = tokio::spawn(async move { heights(&mut stream, 2).await });
    until("the subscription is there", || node.node.subscriptions.lock().unwrap().len() == 1).await;
    node.stop().await;
    node.node.height.send_replace(7);
    node.restart().await;
    assert_eq!(reading.await.unwrap(), [6, 7]);
}

#[tokio::test]
async fn heartbeats_are_passed_on_and_their_height_is_not_asked_for_again() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    node.node.height.send_replace(5);
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let mut stream = client.subscribe(Subscription { heartbeat: 50, ..Subscription::default() });
    let beat = stream.next().await.unwrap();
    assert_eq!((beat.height, beat.events.len()), (5, 0));
    assert_eq!(stream.next_height(), 6);
}

#[tokio::test]
async fn asking_for_the_next_delivery_may_be_cancelled() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let client = Client::connect(&authority.context(&[&node])).await.unwrap();
    let mut stream = client.subscribe(Subscription { from_height: 1, ..Subscription::default() });
    for height in 1..=20 {
        // Cancelled at any of its await points; nothing may be lost by it.
        for _ in 0..10 {
            tokio::select! {
                biased;
                _ = stream.next() => panic!("there is no block {height} yet"),
                () = tokio::task::yield_now() => {}
            }
        }
        node.node.height.send_replace(height);
        assert_eq!(heights(&mut stream, 1).await, [height]);
    }
}
