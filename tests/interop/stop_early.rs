//! An emergency stop stands the robot still although nothing can be ordered.

use crate::nodes_die::Trio;
use crate::world::run;
use crate::{call, network};
use ledger_api::Client;
use ledger_gate::sample::Sample;
use ros_bridge::{names::TopicName, queue::Limits, shm};
use rustix::process::Signal;
use std::time::Duration;

/// The robot stops for nothing else: not for the silence of its driver, of its node or of the voters.
const PATIENT: &str = "command_timeout_ms = 0\nstale_after_ms = 600000";

#[test]
fn a_stop_stands_the_robot_still_while_two_of_three_voters_are_silent() {
    if !network::isolated(&|| ()) {
        return;
    }
    run(async {
        let mut trio = Trio::found();
        (0..3).for_each(|node| trio.start(node));
        let owner = trio.register().await;
        let salma = Client::connect(&trio.context("Salma")).await.unwrap();
        call(&salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let _bridges = [trio.bridge("Salma", 211, "to_ledger", ""), trio.bridge("Rover", 212, "from_ledger", PATIENT)];
        let topic = TopicName::parse("/cmd_vel").unwrap();
        let teleop = shm::Node::open(211, "operator", [7; 16]).await.unwrap().publisher(&topic).await.unwrap();
        let robot = shm::Node::open(212, "robot", [8; 16]).await.unwrap();
        let mut robot = robot.subscriber(&topic, Limits::default()).await.unwrap();
        // True for a stop.
        let mut hears = async || {
            let heard = tokio::time::timeout(Duration::from_millis(50), robot.next()).await.ok()??;
            Some(heard.sample.body().iter().all(|byte| *byte == 0))
        };
        trio.until("the robot is driven", async || {
            teleop.write(&Sample::new([0, 1], &[1; 48]).unwrap()).unwrap();
            hears().await.filter(|stop| !stop)
        })
        .await;
        for silent in [0, 1] {
            trio.nodes[silent].as_ref().unwrap().signal(Signal::STOP);
        }
        let stop = tokio::spawn(async move { owner.invoke("abac", "stop", vec!["Rover".into()]).await });
        trio.until("the robot hears the stop", async || hears().await.filter(|stop| *stop)).await;
        assert!(!stop.is_finished(), "nobody has ordered it");
        for silent in [0, 1] {
            trio.nodes[silent].as_ref().unwrap().signal(Signal::CONT);
        }
        stop.await.unwrap().unwrap();
    });
}
