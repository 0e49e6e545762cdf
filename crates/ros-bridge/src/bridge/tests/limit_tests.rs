//! The limits of a grant, and a hand-over, at a real local graph.

use super::*;
use ledger_contract::{Grant, Limits};

/// A Twist forwards.
fn forwards(speed: f64) -> Sample {
    let body: Vec<u8> = [speed, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().flat_map(f64::to_le_bytes).collect();
    Sample::new(CDR_LE, &body).unwrap()
}

fn speed_of(sample: &Sample) -> f64 {
    f64::from_le_bytes(sample.body()[..8].try_into().unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_robot_hears_no_faster_command_than_the_grant_allows_and_the_bridge_counts_what_it_slowed_down_and_dropped() {
    if !network::isolated(&|| ()) {
        return;
    }
    let limits = Limits { max_linear_mm_s: Some(500), max_rate_mhz: Some(3_000), ..Limits::default() };
    let held = Grant { limits, ..held_by("Org1/Salma", 3, 60_000) };
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_grant(&held)).await;
    let mut reader = bench.reader().await;
    let salma = &bench.network.salma;
    bench.message_of(salma, 3, 1, &forwards(0.25));
    assert_eq!(next(&mut reader).await, forwards(0.25), "slow enough: byte for byte");
    bench.message_of(salma, 3, 2, &forwards(-9.0));
    let slower = speed_of(&next(&mut reader).await);
    assert!((-0.5..-0.499_999).contains(&slower), "{slower}");
    bench.message_of(salma, 3, 3, &forwards(f64::INFINITY));
    bench.until(|summary| summary.gate.contains_key("bad_speed")).await;
    // Three in a second, and what comes at once after them is too much.
    for seq in 4..40 {
        bench.message_of(salma, 3, seq, &forwards(0.0));
    }
    bench.until(|summary| summary.gate.values().sum::<u64>() + summary.published == 39).await;
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!((summary.clamped, summary.gate["bad_speed"]), (1, 1));
    assert!(summary.gate["too_fast"] > 0, "{summary:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_speed_that_is_no_number_does_not_reach_the_robot_and_brings_the_stop_message_without_any_limit() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut reader = bench.reader().await;
    let salma = &bench.network.salma;
    for (number, bad) in [(1, f64::NAN), (3, f64::NEG_INFINITY), (5, 1e300)] {
        bench.message_of(salma, 3, number, &forwards(0.5));
        assert_eq!(next(&mut reader).await, forwards(0.5));
        bench.message_of(salma, 3, number + 1, &forwards(bad));
        assert_eq!(next(&mut reader).await, stop(), "{bad}");
        // A stop message is said three times, or until the next command.
        bench.message_of(salma, 3, number + 1, &forwards(0.25));
        let mut heard = next(&mut reader).await;
        while heard == stop() {
            heard = next(&mut reader).await;
        }
        assert_eq!(heard, forwards(0.25), "it drives on with a number");
    }
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!((summary.gate["bad_speed"], summary.published), (3, 6));
    assert_eq!(stops(summary), [("bad_speed", 3), ("shutdown", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_robot_that_is_handed_over_hears_no_stop_between_its_drivers() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let mut reader = bench.reader().await;
    let (salma, farhad) = (&bench.network.salma, &bench.network.farhad);
    let (sent, _) = bench.message(salma, 3, 1);
    assert_eq!(next(&mut reader).await, sent);
    bench.fake.set_grant(&Grant { follows: Some(3), ..held_by("Org1/Farhad", 4, 60_000) });
    let released =
        json!({ "service": "T/cmd_vel", "holder": "Org1/Salma", "epoch": 3, "reason": "delegated", "goes_on": true });
    bench.fake.deliver(micros(), "released", &released, None);
    bench.message_of(salma, 3, 2, &forwards(0.1));
    bench.message_of(farhad, 4, 1, &forwards(0.2));
    assert_eq!(next(&mut reader).await, forwards(0.2), "nothing in between");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(next(&mut reader).await, stop(), "Farhad moved it last");
    assert_eq!(summary.published, 2);
    assert_eq!(stops(summary), [("shutdown", 1)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_route_with_a_highest_rate_submits_the_newest_samples_and_always_the_last_one() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'to_ledger'\nmax_rate_hz = 2", |fake| fake.set_own_epoch(3)).await;
    let writer = bench.writer().await;
    for number in 0..20 {
        writer.write(&twist(number)).unwrap();
    }
    bench.until(|summary| summary.submitted + summary.thinned == 20).await;
    let sets = bench.sets(2).await;
    assert_eq!(sets.last().unwrap()[3], twist(19).wire(), "the robot shall end where the driver ended");
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert!(summary.thinned > 0, "{summary:?}");
    assert_eq!(summary.samples_in, 20);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_feed_with_a_highest_rate_is_delivered_no_faster_and_its_newest_message_always() {
    if !network::isolated(&|| ()) {
        return;
    }
    let route = "direction = 'from_ledger'\nmax_rate_hz = 2\nqos = { durability = 'volatile' }";
    let bench = bench("open", route, |fake| fake.set_direction("feed")).await;
    let mut reader = bench.reader().await;
    let robot = &bench.network.robot;
    for number in 1..=100 {
        bench.message_of(robot, 0, number, &forwards(number as f64));
    }
    let mut heard = Vec::new();
    while heard.last() != Some(&forwards(100.0)) {
        heard.push(reader.hear().await);
    }
    let summary = bench.bridge.stop().await.routes.pop().unwrap();
    assert_eq!(summary.published, heard.len() as u64, "{summary:?}");
    assert_eq!(summary.published + summary.thinned, 100, "{summary:?}");
    assert!(summary.thinned > 0, "a hundred at once are more than two a second");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_highest_rate_for_commands_is_refused_where_they_would_reach_the_robot() {
    if !network::isolated(&|| ()) {
        return;
    }
    let network = Network::until(2900);
    let route = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\ndirection = 'from_ledger'";
    let text = format!("domain_id = {DOMAIN}\nshared_memory = false\n{route}\nmax_rate_hz = 2");
    let config = Config::parse(&text, Path::new(""), |_| ()).unwrap();
    let refused = Bridge::start_with(config, Fake::new("open", &network), &context(&network)).await.unwrap_err();
    assert_eq!(refused.code, Code::BadConfiguration);
    assert!(refused.message.contains("commands are not thinned out"), "{refused}");
    assert!(refused.found.contains("max_rate_hz = 2 for the commands of T/cmd_vel"), "{refused}");
}
