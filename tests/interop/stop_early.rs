//! An emergency stop stands the robot still although nothing can be ordered.

use crate::nodes_die::Trio;
use crate::world::{Process, run};
use crate::{call, network};
use ledger_api::{Client, Committed};
use ledger_base::rejection::Rejection;
use ledger_gate::sample::Sample;
use ros_bridge::{names::TopicName, queue::Limits, shm};
use rustix::process::Signal;
use std::time::{Duration, Instant};

/// The robot stops for nothing else: not for the silence of its driver, of its node or of the voters.
const PATIENT: &str = "command_timeout_ms = 0\nstale_after_ms = 600000";

/// Three nodes, a robot that Salma drives, and the bridges of both.
struct Scene {
    trio: Trio,
    owner: Client,
    teleop: shm::Publisher,
    robot: shm::Subscriber,
    _nodes: [shm::Node; 2],
    _bridges: [Process; 2],
}

impl Scene {
    /// The robot is driven.
    async fn begin() -> Self {
        let mut trio = Trio::found();
        (0..3).for_each(|node| trio.start(node));
        let owner = trio.register().await;
        let salma = Client::connect(&trio.context("Salma")).await.unwrap();
        call(&salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        let bridges = [trio.bridge("Salma", 211, "to_ledger", ""), trio.bridge("Rover", 212, "from_ledger", PATIENT)];
        let topic = TopicName::parse("/cmd_vel").unwrap();
        let operator = shm::Node::open(211, "operator", [7; 16]).await.unwrap();
        let teleop = operator.publisher(&topic).await.unwrap();
        let node = shm::Node::open(212, "robot", [8; 16]).await.unwrap();
        let robot = node.subscriber(&topic, Limits::default()).await.unwrap();
        let mut scene = Self { trio, owner, teleop, robot, _nodes: [operator, node], _bridges: bridges };
        scene.until_heard("the robot is driven", false).await;
        scene
    }

    /// Drives, and says what the robot hears soon: true for a stop.
    async fn drive(&mut self) -> Option<bool> {
        self.teleop.write(&Sample::new([0, 1], &[1; 48]).unwrap()).unwrap();
        let heard = tokio::time::timeout(Duration::from_millis(50), self.robot.next()).await.ok()??;
        Some(heard.sample.body().iter().all(|byte| *byte == 0))
    }

    async fn until_heard(&mut self, what: &str, stop: bool) {
        let deadline = Instant::now() + Duration::from_secs(90);
        while self.drive().await != Some(stop) {
            assert!(Instant::now() < deadline, "never happened: {what}\n{}", self.trio.logs());
        }
    }

    fn signal(&self, signal: Signal) {
        for node in [0, 1] {
            self.trio.nodes[node].as_ref().unwrap().signal(signal);
        }
    }

    fn stop(&self) -> tokio::task::JoinHandle<Result<Committed, Rejection>> {
        let owner = self.owner.clone();
        tokio::spawn(async move { owner.invoke("abac", "stop", vec!["Rover".into()]).await })
    }

    /// Is the robot stopped, as the ledger has it?
    async fn is_stopped(&self) -> bool {
        let Ok(robot) = self.owner.query("abac", "robot", vec!["Rover".into()]).await else { return false };
        let robot: serde_json::Value = serde_json::from_slice(&robot.response).unwrap();
        !robot["stopped"].is_null()
    }
}

#[test]
fn a_stop_stands_the_robot_still_while_two_of_three_voters_are_silent() {
    if !network::isolated(&|| ()) {
        return;
    }
    run(async {
        let mut scene = Scene::begin().await;
        scene.signal(Signal::STOP);
        let stop = scene.stop();
        scene.until_heard("the robot hears the stop", true).await;
        assert!(!stop.is_finished(), "nobody has ordered it");
        scene.signal(Signal::CONT);
        stop.await.unwrap().unwrap();
    });
}

#[test]
fn a_stopped_robot_does_not_drive_on_when_the_majority_comes_back_and_nobody_waits_for_the_stop() {
    if !network::isolated(&|| ()) {
        return;
    }
    run(async {
        let mut scene = Scene::begin().await;
        scene.signal(Signal::STOP);
        let stop = scene.stop();
        scene.until_heard("the robot hears the stop", true).await;
        // As if the person had closed the terminal.
        stop.abort();
        scene.signal(Signal::CONT);
        let deadline = Instant::now() + Duration::from_secs(90);
        while !scene.is_stopped().await {
            assert_ne!(scene.drive().await, Some(false), "it drove on\n{}", scene.trio.logs());
            assert!(Instant::now() < deadline, "the stop is not ordered\n{}", scene.trio.logs());
        }
        for _ in 0..40 {
            assert_ne!(scene.drive().await, Some(false), "it drove on\n{}", scene.trio.logs());
        }
        call(&scene.owner, "resume", &["Rover"]).await;
        let salma = Client::connect(&scene.trio.context("Salma")).await.unwrap();
        call(&salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        scene.until_heard("it drives again", false).await;
    });
}
