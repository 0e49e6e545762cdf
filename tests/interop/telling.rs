//! A bridge says what it is doing.

use std::time::Duration;

use ledger_gate::sample::Sample;
use ros_bridge::{
    dds::Participant,
    names::{TopicName, TypeName},
    qos::{Qos, Reliability},
    queue::Limits,
};

use crate::{
    call, network,
    world::{self, World},
};

const TWIST: &str = "geometry_msgs/msg/Twist";

fn settings(domain: u16, direction: &str, more: &str) -> String {
    format!(
        "domain_id = {domain}\nshared_memory = false\nreport_s = 1\n[[route]]\nservice = \"Rover/cmd_vel\"\n\
         direction = {direction:?}\ntype = {TWIST:?}\n{more}"
    )
}

fn names() -> (TopicName, TypeName) {
    (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse(TWIST).unwrap())
}

fn twist() -> Sample {
    Sample::new([0, 1], &[1; 48]).unwrap()
}

#[test]
fn a_bridge_to_the_ledger_says_who_publishes_and_why_nothing_passes() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let _salma =
            world.start_bridge_as("Salma", &settings(1, "to_ledger", "qos = { reliability = 'reliable' }\n"), &[]);
        let ready = [
            "INFO",
            "the bridge of Org1/Salma is ready: ROS domain 1 (from domain_id), local processes only, node 127.0.0.1:",
            "context=\"Salma\"",
        ];
        world.line("Salma", &ready).await;
        let route = [
            "route 1: /cmd_vel -> Rover/cmd_vel",
            TWIST,
            "reliability=\"reliable\"",
            "durability=\"volatile\"",
            "depth=100",
        ];
        world.line("Salma", &route).await;
        world.line("Salma", &["the route is silent: nobody publishes on /cmd_vel", "why=\"no_publisher\""]).await;

        let graph = Participant::open(1, "teleop").await.unwrap();
        let (topic, kind) = names();
        let other = TypeName::parse("std_msgs/msg/String").unwrap();
        let wrong = graph.writer(&topic, &other, &Qos::default()).unwrap();
        world
            .line("Salma", &["WARN", "a publisher on /cmd_vel has another type: nothing passes", "String_", "Twist_"])
            .await;
        world.line("Salma", &["WARN", "the route is silent: the publisher on /cmd_vel has another type"]).await;
        drop(wrong);
        let best_effort = Qos { reliability: Reliability::BestEffort, ..Qos::default() };
        let wrong = graph.writer(&topic, &kind, &best_effort).unwrap();
        world.line("Salma", &["WARN", "the qos of a publisher on /cmd_vel does not fit", "reliability"]).await;
        world.line("Salma", &["WARN", "the route is silent: the qos", "why=\"other_qos\""]).await;
        drop(wrong);

        let writer = graph.writer(&topic, &kind, &Qos::default()).unwrap();
        world.line("Salma", &["INFO", "a publisher on /cmd_vel has come"]).await;
        let second = graph.writer(&topic, &kind, &Qos::default()).unwrap();
        let both = ["WARN", "2 publishers on /cmd_vel now", "takes the commands of all of them to Rover/cmd_vel"];
        world.line("Salma", &both).await;
        drop(second);
        world.line("Salma", &["the route is silent: you do not hold it: ledgerctl acquire Rover/cmd_vel"]).await;
        let mut tick = tokio::time::interval(Duration::from_millis(50));
        let mut publish = async || loop {
            tick.tick().await;
            writer.write(&twist()).unwrap();
        };
        tokio::select! {
            () = publish() => {}
            () = async {
                let counters = ["WARN", "not everything passes", "NOT_HOLDER", "committed=0", "samples_in="];
                world.line("Salma", &counters).await;
                call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
                world.line("Salma", &["grant held"]).await;
                world.line("Salma", &["the route carries messages"]).await;
            } => {}
        }
        drop(writer);
        world.line("Salma", &["INFO", "a publisher on /cmd_vel has left"]).await;
    });
}

#[test]
fn a_bridge_waits_for_its_robot_and_says_so() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let later = settings(1, "to_ledger", "").replace("Rover/cmd_vel", "Latecomer/cmd_vel");
        let salma = world.start_bridge_as("Salma", &later, &[]);
        world.line("Salma", &["WARN", "the bridge waits", "Latecomer", "UNKNOWN_ROBOT"]).await;
        world.register("Latecomer", "/cmd_vel", TWIST).await;
        world.line("Salma", &["route 1: /cmd_vel -> Latecomer/cmd_vel"]).await;
        assert_eq!(salma.report()["routes"][0]["service"], "Latecomer/cmd_vel");
    });
}

#[test]
fn a_bridge_says_as_json_that_its_node_is_lost_and_back() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let json = format!("{}[log]\nformat = \"json\"\n", settings(3, "from_ledger", ""));
        let _rover = world.start_bridge_as("Rover", &json, &[]);
        let field = |line: &str, name: &str| {
            let line: serde_json::Value = serde_json::from_str(line).unwrap();
            line["fields"][name].clone()
        };
        let ready = world.line("Rover", &["is ready"]).await;
        assert_eq!((field(&ready, "domain"), field(&ready, "domain_from")), (3.into(), "domain_id".into()));
        assert_eq!(field(&ready, "context"), "Rover");
        let route = world.line("Rover", &["route 1: Rover/cmd_vel -> /cmd_vel"]).await;
        assert_eq!((field(&route, "type"), field(&route, "depth")), (TWIST.into(), 100.into()));
        let silent = world.line("Rover", &["the route is silent"]).await;
        assert_eq!(field(&silent, "why"), "no_subscriber");
        let graph = Participant::open(3, "driver").await.unwrap();
        let (topic, kind) = names();
        let _reader = graph.reader(&topic, &kind, &Qos::default(), Limits::default()).unwrap();
        world.line("Rover", &["a subscriber on /cmd_vel has come"]).await;
        let silent = world.line("Rover", &["the route is silent: nobody holds Rover/cmd_vel"]).await;
        assert_eq!(field(&silent, "why"), "no_holder");

        world.node().send(rustix::process::Signal::STOP);
        let lost = world.line("Rover", &["\"WARN\"", "lost: the ledger gives no sign of life"]).await;
        let node = field(&lost, "node");
        assert!(node.as_str().unwrap().starts_with("127.0.0.1:"), "{lost}");
        world.node().send(rustix::process::Signal::CONT);
        let back = world.line("Rover", &["connected to node", "the ledger is back"]).await;
        assert_eq!((field(&back, "node"), field(&back, "was")), (node.clone(), node));
    });
}
