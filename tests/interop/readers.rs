//! A feed with one place for a subscriber: the bridges of two users take it one after the other. CycloneDDS is at every end.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, World};
use crate::{call, network};
use serde_json::{Value, json};
use std::time::Duration;

const TYPE: &str = "geometry_msgs/msg/Twist";
/// More than anybody waits for.
const MANY: &str = "3000";

fn listens(domain: &str) -> Python {
    let mut subscriber = Python::start("twist_subscriber.py", &[domain, "rt/cmd_vel", "0", "0", "0", "240"]);
    assert_eq!((subscriber.line().unwrap(), subscriber.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));
    subscriber
}

async fn readers(world: &World) -> Value {
    let answer = world.farhad.query("abac", "robot", vec!["Rover".into()]).await.unwrap();
    let mut robot: Value = serde_json::from_slice(&answer.response).unwrap();
    robot["services"][0]["readers"].take()
}

#[test]
fn the_bridge_of_a_subscriber_keeps_its_place_and_another_one_gets_it_when_that_bridge_is_killed() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let owner = owner_of(&world).await;
        let settings = r#"{"mode":"limited","direction":"feed","lease_ms":8000,"sharing":{"subscribers":1}}"#;
        call(&owner, "configure", &["Rover/cmd_vel", settings]).await;
        let _robot = world.start_bridge("Rover", 3, "to_ledger", "/cmd_vel", TYPE);
        let mut sensor = Python::start("twist_publisher.py", &["3", "rt/cmd_vel", MANY, "20", "0"]);
        assert_eq!(sensor.line().unwrap(), "matched");

        let salmas = world.start_bridge("Salma", 1, "from_ledger", "/cmd_vel", TYPE);
        listens("1").line().expect("Salma's side hears the robot");
        assert_eq!(readers(&world).await, json!(["Org1/Salma"]));
        let _farhads = world.start_bridge("Farhad", 2, "from_ledger", "/cmd_vel", TYPE);
        let mut farhad = listens("2");
        world.line("Farhad", &["the ledger has ended the subscription", "Rover/cmd_vel:subscribe"]).await;
        // Longer than her lease.
        tokio::time::sleep(Duration::from_secs(10)).await;
        assert_eq!(readers(&world).await, json!(["Org1/Salma"]), "she keeps her place while her bridge reads");

        drop(salmas);
        farhad.line().expect("Farhad's side hears the robot");
        assert_eq!(readers(&world).await, json!(["Org1/Farhad"]));
    });
}
