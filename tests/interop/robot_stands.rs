//! A robot that nobody drives any more stands still: its driver fell silent, or its bridge was killed. CycloneDDS is at both
//! ends.

use crate::sharing::{Heard, Robot, drives};
use crate::world::{self, World};
use crate::{call, network};
use ros_bridge::dds::{Change, Participant};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::time::Duration;

const TYPE: &str = "geometry_msgs/msg/Twist";

async fn is_held(world: &World) -> bool {
    let answer = world.farhad.query("abac", "grants", vec!["Rover/cmd_vel".into()]).await.unwrap();
    serde_json::from_slice::<Vec<Value>>(&answer.response).unwrap().iter().any(|grant| grant["holder"] == "Org1/Salma")
}

#[test]
fn a_robot_stands_still_when_its_driver_is_killed_and_when_its_bridge_is_killed_and_comes_back() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let _salma = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TYPE);
        let bridge = world.start_default_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
        let mut robot = Robot::listen();
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let teleop = drives("1", "1");
        robot.hears_driving(Heard::Salma, 20);
        drop(teleop);
        robot.hears(Heard::Salma, Heard::Stop);
        assert!(is_held(&world).await, "it stands long before the lease ends");

        // The same driver comes back, and drives on under the same grant.
        let teleop = drives("1", "1");
        robot.hears_driving(Heard::Salma, 20);
        drop(bridge);
        drop(teleop);
        // Longer than any command is young enough for.
        tokio::time::sleep(Duration::from_secs(3)).await;
        let _bridge = world.start_default_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE);
        robot.hears(Heard::Salma, Heard::Stop);
        assert!(is_held(&world).await);
    });
}

#[test]
fn bridges_that_were_stopped_and_continued_carry_messages_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let mut bridges = [
            world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TYPE),
            world.start_bridge("Rover", 3, "from_ledger", "/cmd_vel", TYPE),
        ];
        let mut robot = Robot::listen();
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let teleop = drives("1", "1");
        robot.hears_only(Heard::Salma, 20);
        // As a suspended laptop or a debugger does it.
        for _ in 0..3 {
            for signal in [Signal::STOP, Signal::CONT] {
                bridges.iter().for_each(|bridge| bridge.signal(signal));
                tokio::time::sleep(Duration::from_millis(300)).await;
            }
        }
        drop(teleop);
        // Another teleop of hers is discovered, and heard.
        let _teleop = drives("1", "5000");
        robot.hears_number(5000.0);
        assert!(bridges.iter_mut().all(|bridge| bridge.is_running()), "{}", world.logs());
    });
}

#[test]
fn a_killed_bridge_leaves_the_graph_long_before_half_a_minute() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let graph = Participant::open(1, "watcher").await.unwrap();
        let (tell, mut changes) = tokio::sync::mpsc::unbounded_channel();
        let (_unchanged, topics) = tokio::sync::watch::channel(BTreeSet::from(["rt/cmd_vel".to_owned()]));
        let follower = graph.clone();
        tokio::spawn(async move { follower.follow(topics, |change| drop(tell.send(change))).await });
        let bridge = world.start_bridge("Salma", 1, "to_ledger", "/cmd_vel", TYPE);
        let came = tokio::time::timeout(Duration::from_secs(20), changes.recv()).await.unwrap().unwrap();
        assert!(matches!(came, Change::Came(_)), "{came:?}");
        drop(bridge);
        // RustDDS alone takes 50 s.
        let left = tokio::time::timeout(Duration::from_secs(25), changes.recv()).await.expect("it leaves").unwrap();
        assert!(matches!(left, Change::Left(_)), "{left:?}");
    });
}
