//! Routes come and go while their bridge runs: it reads its configuration again on SIGHUP.

use crate::call;
use crate::network;
use crate::world::{self, World};
use ros_bridge::dds::{Matched, Participant};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use rustix::process::Signal;
use std::time::Duration;

const TYPE: &str = "geometry_msgs/msg/Twist";
const HEAD: &str = "domain_id = 1\nshared_memory = false\n";
const DEADLINE: Duration = Duration::from_secs(20);

fn route(direction: &str, topic: &str) -> String {
    format!("[[route]]\nservice = \"Rover/cmd_vel\"\ndirection = {direction:?}\ntopic = {topic:?}\ntype = {TYPE:?}\n")
}

async fn until_matched(matched: &Matched, count: usize) {
    let reached = async {
        while matched.now().matched != count {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(DEADLINE, reached).await.unwrap();
}

#[test]
fn on_sighup_routes_come_and_go_and_the_others_are_not_touched() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let (up, down) = (route("to_ledger", "/cmd_vel"), route("from_ledger", "/watched"));
        let bridge = world.start_bridge_as("Salma", &format!("{HEAD}{up}"), &[]);
        world.line("Salma", &["route 1: /cmd_vel -> Rover/cmd_vel"]).await;
        let graph = Participant::open(1, "operator").await.unwrap();
        let [commands, watched] = ["/cmd_vel", "/watched"].map(|topic| TopicName::parse(topic).unwrap());
        let message = TypeName::parse(TYPE).unwrap();
        let writer = graph.writer(&commands, &message, &Qos::default()).unwrap();
        let reader = graph.reader(&watched, &message, &Qos::default(), Limits::default()).unwrap();
        until_matched(writer.matched(), 1).await;

        world.config_of("Salma", &format!("{HEAD}{up}{down}"));
        bridge.signal(Signal::HUP);
        world.line("Salma", &["route 2: Rover/cmd_vel -> /watched"]).await;
        world.line("Salma", &["0 routes ended, 1 started"]).await;
        until_matched(reader.matched(), 1).await;
        assert_eq!(writer.matched().now().matched, 1, "the first route goes on");

        // A mistake changes nothing.
        world.config_of("Salma", &format!("{HEAD}{up}{down}topik = '/x'\n"));
        bridge.signal(Signal::HUP);
        world.line("Salma", &["ERROR", "topik", "configuration rejected on reload"]).await;

        world.config_of("Salma", &format!("{HEAD}node_name = 'other'\n{down}"));
        bridge.signal(Signal::HUP);
        world.line("Salma", &["WARN", "only routes can be reloaded"]).await;
        world.line("Salma", &["route 1 has ended"]).await;
        world.line("Salma", &["1 routes ended, 0 started"]).await;
        until_matched(writer.matched(), 0).await;
        assert_eq!(reader.matched().now().matched, 1, "the second route goes on");
        let summary = bridge.report();
        let directions: Vec<_> =
            summary["routes"].as_array().unwrap().iter().map(|route| &route["direction"]).collect();
        assert_eq!(directions, ["from_ledger"]);
    });
}

#[test]
fn on_sighup_a_node_reads_the_routes_of_its_bridge_again_and_goes_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start_with_inner_bridge("/cmd_vel", TYPE).await;
        world.line("Org2", &["the bridge of Org2/Rover is ready"]).await;
        world.change_node(1, "Org2", |text| text.replace("topic = \"/cmd_vel\"", "topic = \"/renamed\""));
        world.line("Org2", &["route 2: Rover/cmd_vel -> /renamed"]).await;
        world.line("Org2", &["1 routes ended, 1 started"]).await;
        world.change_node(0, "Org1", |text| text);
        world.line("Org1", &["no bridge on this node"]).await;
        // Both nodes still answer.
        call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
    });
}
