//! The parameters of a robot's node are read and set from a user's graph, through the ledger: they are services like others.
//! CycloneDDS is the node and its client.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, World};
use crate::{call, network};

/// The services of every node with parameters.
const SERVICES: [(&str, &str); 6] = [
    ("get_parameters", "GetParameters"),
    ("get_parameter_types", "GetParameterTypes"),
    ("set_parameters", "SetParameters"),
    ("set_parameters_atomically", "SetParametersAtomically"),
    ("describe_parameters", "DescribeParameters"),
    ("list_parameters", "ListParameters"),
];

fn routes(domain: u16, direction: &str) -> String {
    let route = |(name, kind): &(&str, &str)| {
        format!(
            "[[route]]\nservice = 'Rover/base/{name}'\ndirection = '{direction}'\ntype = 'rcl_interfaces/srv/{kind}'\n"
        )
    };
    format!("domain_id = {domain}\nshared_memory = false\n{}", SERVICES.iter().map(route).collect::<String>())
}

#[test]
fn parameters_of_a_robots_node_are_set_and_read_by_its_holder_and_by_nobody_else() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let services = SERVICES.iter().flat_map(|(name, kind)| {
            let (topic, kind) = (format!("/base/{name}"), format!("rcl_interfaces/srv/{kind}"));
            [
                serde_json::json!({ "topic": topic, "type": kind, "max_age_ms": 5000 }),
                serde_json::json!({ "topic": format!("{topic}/_reply"), "type": kind, "direction": "feed", "max_age_ms": 5000 }),
            ]
        });
        let services: Vec<_> = services.collect();
        let spec = serde_json::json!({ "name": "Rover", "attribute_required": "Rover", "trusted": ["Org1", "Org2"], "services": services });
        call(&owner_of(&world).await, "replace", &[&spec.to_string()]).await;
        let salma = world.start_bridge_as("Salma", &routes(1, "service_server"), &[]);
        let robot = world.start_bridge_as("Rover", &routes(3, "service_client"), &[]);
        let mut node = Python::start("parameters.py", &["serve", "3", "/base"]);
        assert_eq!(node.line().as_deref(), Some("ready"));
        for (name, _) in SERVICES {
            call(&world.salma, "acquire", &[&format!("Rover/base/{name}"), "600000"]).await;
        }

        let mut client = Python::start("parameters.py", &["call", "1", "/base"]);
        let told: Vec<String> = std::iter::from_fn(|| client.line()).collect();
        assert!(client.finish(), "it said {told:?}\n{}", world.logs());
        assert_eq!(told.first().map(String::as_str), Some("matched"));
        assert_eq!(told.len(), 1 + SERVICES.len());
        let reports = [salma, robot].map(|bridge| bridge.report()["routes"].clone());
        let of_both = reports[0].as_array().unwrap().iter().zip(reports[1].as_array().unwrap());
        for (asked, answered) in of_both {
            assert!(asked["published"].as_u64().unwrap() >= 2, "{asked}");
            assert!(answered["published"].as_u64() >= asked["published"].as_u64(), "{asked}\n{answered}");
        }

        // Nobody sets a parameter around the grant.
        let _farhad = world.start_bridge_as("Farhad", &routes(2, "service_server"), &[]);
        let mut other = Python::start("parameters.py", &["call", "2", "/base"]);
        assert_eq!(other.line().as_deref(), Some("matched"));
        world.line("Farhad", &["the ledger refuses samples", "Org1/Farhad holds no grant of Rover/base/"]).await;
    });
}
