//! Stop messages that nobody ordered: at the start of a bridge, when a driver is silent, and beside a side door.

use super::*;

#[tokio::test]
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

#[tokio::test]
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

#[tokio::test]
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
    let stranger = Participant::open(DOMAIN, "stranger").await.unwrap();
    let writer = stranger.writer(&topic, &message, &Qos::default()).unwrap();
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
