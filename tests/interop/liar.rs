//! A robot whose own node lies to it, with a node's key, in another language.

use crate::network;
use crate::python::Python;
use crate::support::programs::repository;
use crate::world::{self, Process, World, default_route};
use bytes::Bytes;
use serde_json::Value;
use std::time::Duration;

const TWIST: &str = "geometry_msgs/msg/Twist";
const ROVER: &str = "Rover/cmd_vel";

/// A network whose robot knows no node but the liar.
async fn lied_to() -> (World, Python) {
    let world = World::start("/cmd_vel", TWIST).await;
    let [home, data, lie] = ["home", "net", "lie"].map(|name| world.path(name));
    let repository = repository().to_str().unwrap();
    let arguments = [&home, &data, &lie].map(|path| path.to_str().unwrap());
    let mut liar = Python::start("lying_node.py", &[arguments[0], arguments[1], arguments[2], repository]);
    let port = liar.line().expect("the liar tells its port");
    let context = home.join("contexts/Rover/context.toml");
    let mut settings: toml::Table = std::fs::read_to_string(&context).unwrap().parse().unwrap();
    settings.insert("nodes".into(), vec![format!("127.0.0.1:{port}")].into());
    std::fs::write(&context, settings.to_string()).unwrap();
    let _learnt_at_enrolment = std::fs::remove_file(home.join("contexts/Rover/nodes.json"));
    (world, liar)
}

fn rover(world: &World) -> Process {
    let routes = default_route("from_ledger", "/cmd_vel", TWIST);
    world.start_bridge_as("Rover", &format!("domain_id = 3\nshared_memory = false\n{routes}"), &[])
}

/// Salma takes the robot, and sends it so many commands.
async fn drive(world: &World, count: u64) {
    let grant = world.salma.invoke("abac", "acquire", vec![Bytes::from(ROVER)]).await.unwrap().response;
    let grant: Value = serde_json::from_slice(&grant).unwrap();
    let (epoch, next) = (grant["epoch"].as_u64().unwrap(), grant["next_seq"].as_u64().unwrap());
    let twist = Bytes::from([&[0, 1, 0, 0][..], &[0; 48]].concat());
    for number in next..next + count {
        let numbers = [epoch, number].map(|number| Bytes::from(number.to_string()));
        let args = [Bytes::from(ROVER)].into_iter().chain(numbers).chain([twist.clone()]).collect();
        world.salma.invoke("abac", "set", args).await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn release(world: &World) {
    world.salma.invoke("abac", "release", vec![Bytes::from(ROVER)]).await.unwrap();
}

#[test]
fn a_node_that_lies_to_its_robot_drives_it_for_nobody_and_keeps_it_from_nobody() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let (world, _liar) = lied_to().await;
        let lies = |lie: &str| std::fs::write(world.path("lie"), lie).unwrap();

        let bridge = rover(&world);
        world.line("Rover", &["the bridge of Org2/Rover is ready"]).await;
        drive(&world, 1).await;
        lies("grant");
        world.line("Rover", &["the gate dropped a message", "unknown_epoch"]).await;
        let route = bridge.report()["routes"][0].clone();
        assert_eq!(route["published"], 1, "Farhad moved the robot: {route}");

        lies("end");
        let bridge = rover(&world);
        world.line("Rover", &["the bridge of Org2/Rover is ready"]).await;
        drive(&world, 100).await;
        world.line("Rover", &["stop", "released"]).await;
        let route = bridge.report()["routes"][0].clone();
        assert!(route["published"].as_u64().unwrap() > 50, "she holds the robot all the time: {route}");

        release(&world).await;
        std::fs::remove_file(world.path("lie")).unwrap();
        let bridge = rover(&world);
        world.line("Rover", &["the bridge of Org2/Rover is ready"]).await;
        world.line("Rover", &["the route is silent"]).await;
        let moves = world.line("Rover", &["the route carries messages"]);
        tokio::join!(drive(&world, 150), moves);
        lies("withhold");
        release(&world).await;
        world.line("Rover", &["INFO stop service"]).await;
        world.line("Rover", &["the gate dropped a message"]).await;
        let route = bridge.report()["routes"][0].clone();
        let stops = route["stops"].as_object().unwrap();
        assert!(stops.contains_key("uncertified") || stops.contains_key("released"), "the robot moves on: {route}");
    });
}
