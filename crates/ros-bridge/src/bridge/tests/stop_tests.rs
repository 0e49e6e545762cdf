//! Stop messages that nobody ordered: at the start of a bridge, when a driver is silent, and beside a side door.

use super::*;
use crate::graph::shm;

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_bridge_that_comes_back_stops_the_robot_that_the_one_before_it_left_moving() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut robot = bench.reader().await;
    for time in 1..=3 {
        assert_eq!(robot.hear().await, stop(), "time {time}");
    }
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    assert_eq!(robot.hear().await, sent);
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    for time in 1..=3 {
        assert_eq!(robot.hear().await, stop(), "at the end, time {time}");
    }
    assert_eq!(summary.stops.into_iter().collect::<Vec<_>>(), [("shutdown", 1), ("start", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_bridge_that_comes_back_stops_the_robot_before_the_voters_have_answered() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.hangs.store(true, Ordering::Relaxed)).await;
    assert_eq!(bench.fake.given_up.load(Ordering::Relaxed), 0, "the route is open before anybody has given up");
    let mut robot = bench.reader().await;
    for time in 1..=3 {
        assert_eq!(robot.hear().await, stop(), "time {time}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_driver_that_falls_silent_stands_still_long_before_its_lease_ends_and_drives_on_with_its_next_command() {
    if !network::isolated(&|| ()) {
        return;
    }
    let more = "direction = 'from_ledger'\ncommand_timeout_ms = 300";
    let bench = bench("exclusive", more, |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut robot = bench.reader().await;
    let alive = async {
        loop {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let drives = async {
        for seq in 1..=2 {
            let (sent, _) = bench.message(&bench.network.salma, 3, seq);
            assert_eq!(next(&mut robot).await, sent);
            assert_eq!(next(&mut robot).await, stop());
        }
    };
    tokio::select! {
        () = alive => {}
        () = drives => {}
    }
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(stops(summary), [("silent", 2)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn while_somebody_publishes_beside_the_bridge_the_robot_stands_if_its_owner_wants_that() {
    if !network::isolated(&|| ()) {
        return;
    }
    let more = "direction = 'from_ledger'\nside_door = 'stop'";
    let bench = bench("exclusive", more, |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut robot = bench.reader().await;
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    assert_eq!(next(&mut robot).await, sent);
    let (topic, message) = names();
    let stranger = Beside::open("stranger").await;
    let writer = stranger.writer(&topic, &message, &Qos::default()).await.unwrap();
    bench.fake.heartbeat(micros());
    let stopped = async { while next(&mut robot).await != stop() {} };
    let alive = async {
        loop {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::select! {
        () = stopped => {}
        () = alive => {}
    }
    bench.message(&bench.network.salma, 3, 2);
    bench.until(|summary| summary.gate.get("side_door") == Some(&1)).await;
    drop((writer, stranger));
    let mut seq = 3;
    let passes = async {
        while bench.bridge.summary().routes[0].published < 2 {
            bench.message(&bench.network.salma, 3, seq);
            seq += 1;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(DEADLINE, passes).await.unwrap();
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(summary.stops["side_door"], 1);
}

/// The publishers that a bridge sees beside its route.
fn beside(bridge: &Bridge) -> usize {
    bridge.roster.slots()[0].counters.lock().live.beside
}

/// Waits until a bridge sees so many publishers beside its route, while the ledger is there.
async fn sees(bench: &Bench, publishers: usize) {
    let seen = async {
        while beside(&bench.bridge) != publishers {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(DEADLINE, seen).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_publisher_in_shared_memory_is_beside_the_bridge_as_one_on_dds_is() {
    if !network::isolated(&|| ()) {
        return;
    }
    // Shared memory has no namespaces: a topic of this test's own.
    let topic = format!("/beside{}", std::process::id());
    let more = format!("direction = 'from_ledger'\nside_door = 'stop'\ntopic = '{topic}'");
    let prepare = |fake: &Fake| fake.set_holder("Org1/Salma", 3, 60_000);
    let bench = bench_with("shared_memory = true", "exclusive", &more, prepare).await;
    let topic = TopicName::parse(&topic).unwrap();
    let robot = shm::Node::open(DOMAIN, "robot", [1; 16]).await.unwrap();
    let mut robot = robot.subscriber(&topic, Limits::default()).await.unwrap();
    let (sent, _) = bench.message(&bench.network.salma, 3, 1);
    let heard = async { while robot.next().await.unwrap().sample != sent {} };
    tokio::time::timeout(DEADLINE, heard).await.unwrap();
    assert_eq!(beside(&bench.bridge), 0, "a subscriber is nobody beside it");

    let stranger = shm::Node::open(DOMAIN, "stranger", [2; 16]).await.unwrap();
    let publisher = stranger.publisher(&topic).await.unwrap();
    sees(&bench, 1).await;
    let stopped = async { while robot.next().await.unwrap().sample != stop() {} };
    tokio::time::timeout(DEADLINE, stopped).await.unwrap();
    bench.until(|summary| summary.stops.get("side_door") == Some(&1)).await;
    bench.message(&bench.network.salma, 3, 2);
    bench.until(|summary| summary.gate.get("side_door") == Some(&1)).await;
    drop((publisher, stranger));
    sees(&bench, 0).await;
}

/// Tells the process below which topic to publish on.
const CHILD_TOPIC: &str = "LEDGERD_TEST_BESIDE";

/// Not a test of its own: a stranger in shared memory.
#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn child_publishes_beside_a_bridge_until_it_is_killed() {
    let Ok(topic) = std::env::var(CHILD_TOPIC) else { return };
    let stranger = shm::Node::open(DOMAIN, "stranger", [3; 16]).await.unwrap();
    let publisher = stranger.publisher(&TopicName::parse(&topic).unwrap()).await.unwrap();
    loop {
        publisher.write(&twist(9)).unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_publisher_in_shared_memory_whose_process_was_killed_is_beside_nobody() {
    if !network::isolated(&|| ()) {
        return;
    }
    let topic = format!("/killed{}", std::process::id());
    let more = format!("direction = 'from_ledger'\ntopic = '{topic}'");
    let bench = bench_with("shared_memory = true", "exclusive", &more, |_| ()).await;
    let mut child = std::process::Command::new(std::env::current_exe().unwrap());
    child.args(["--exact", "bridge::tests::stop_tests::child_publishes_beside_a_bridge_until_it_is_killed"]);
    let mut child = child.env(CHILD_TOPIC, &topic).stdout(std::process::Stdio::null()).spawn().unwrap();
    sees(&bench, 1).await;
    child.kill().unwrap();
    child.wait().unwrap();
    sees(&bench, 0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn another_bridge_of_the_service_in_shared_memory_is_no_side_door() {
    if !network::isolated(&|| ()) {
        return;
    }
    let topic = format!("/twice{}", std::process::id());
    let more = format!("direction = 'from_ledger'\ntopic = '{topic}'");
    let bench = bench_with("shared_memory = true", "exclusive", &more, |_| ()).await;
    let other = bench_with("shared_memory = true", "exclusive", &more, |_| ()).await;
    // Each sees the publisher of the other, and knows it by its participant of DDS as soon as that is discovered.
    let since = std::time::Instant::now();
    let known = async {
        loop {
            tokio::time::sleep(Duration::from_millis(50)).await;
            assert_eq!([&bench, &other].map(|bench| beside(&bench.bridge)), [0, 0]);
            let routes = [&bench, &other].map(|bench| bench.bridge.roster.open().next().unwrap());
            let publishers = routes.map(|route| route.in_memory().unwrap().publishers().len());
            if publishers == [1, 1] && since.elapsed() > Duration::from_secs(5) {
                return;
            }
        }
    };
    tokio::time::timeout(DEADLINE, known).await.unwrap();
}
