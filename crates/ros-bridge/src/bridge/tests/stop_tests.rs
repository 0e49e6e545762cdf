//! Stop messages that nobody ordered: at the start of a bridge, and when a driver is silent.

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
