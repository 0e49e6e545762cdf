//! Topics with keys: messages of every instance pass both bridges, and stay of their instance. CycloneDDS is at both ends, and keeps
//! one message of each instance: an end without keys would keep one of all.

use crate::python::Python;
use crate::world::{self, World};
use crate::{call, network};

const TYPE: &str = "tracking_msgs/msg/Tracked";

#[test]
fn messages_of_a_topic_with_keys_pass_and_each_instance_keeps_its_own() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/tracked", TYPE).await;
        call(&world.salma, "acquire", &["Rover/tracked", "600000"]).await;
        let salma = world.start_bridge("Salma", 1, "to_ledger", "/tracked", TYPE);
        let _robot = world.start_bridge("Rover", 3, "from_ledger", "/tracked", TYPE);
        let _publisher = Python::start("keyed.py", &["pub", "1", "rt/tracked"]);
        let mut subscriber = Python::start("keyed.py", &["sub", "3", "rt/tracked", "3"]);
        for name in ["Salma", "Rover"] {
            world.line(name, &["reliable, volatile, with keys: as the others on /tracked"]).await;
        }
        let told: Vec<String> = std::iter::from_fn(|| subscriber.line()).collect();
        assert!(subscriber.finish(), "{told:?}\n{}", world.logs());
        // The end of an instance is no message, and stays in its graph.
        let report = salma.report()["routes"][0].clone();
        assert_eq!(report["refused"], serde_json::json!({}), "{report}");
    });
}
