//! Without a majority, nodes count the voters that answer, and clients pass the words of nodes on.

use crate::support::network::{NodeWish, free_address, now};
use crate::support::process::Process;
use crate::support::{Fleet, eventually};
use ledger_api::Context;
use ledger_identity::Role;

#[test]
fn without_a_majority_a_client_says_how_many_voters_answer_and_names_the_call_and_not_an_unreachable_node() {
    let wish = |number: usize| NodeWish {
        name: format!("node{number}"),
        organisation: "Org1".into(),
        voter: true,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&[1, 2, 3].map(wish), now());
    let admin = fleet.issue("Org1", "Boss", Role::Admin, &[]);
    let nodes: Vec<String> = fleet.nodes.iter().map(|node| node.address.clone()).collect();
    Context { nodes, ..admin }.save(&fleet.home()).unwrap();
    let boss = fleet.ctl().as_("Boss");
    let mut processes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    eventually("the network serves", || (boss.run(&["robot", "list"]).code == 0).then_some(()));
    processes[1].kill();
    processes[2].kill();

    let setup =
        r#"{"name":"Late","attribute_required":"Late","services":[{"topic":"/c","type":"std_msgs/msg/String"}]}"#;
    for command in [&["robot", "list"][..], &["invoke", "abac", "setup", setup]] {
        let told = eventually("the node knows that it is alone", || {
            let ran = boss.run(command);
            assert_eq!(ran.code, 4, "{ran:?}");
            ran.stderr.contains("no majority: 1 of 3 voters answers").then_some(ran.stderr)
        });
        assert!(!told.contains("LGR-4001] cannot reach"), "{told}");
        if command[0] == "invoke" {
            let id = told.split(|c: char| !c.is_ascii_hexdigit()).find(|word| word.len() == 64);
            assert!(id.is_some(), "the id of the transaction is missing in {told}");
        } else {
            assert!(told.contains("LGR-4002"), "{told}");
        }
    }
    // It is executed once there is a majority, or never: the id says which.
    processes[1] = fleet.nodes[1].start();
    eventually("the network serves again", || (boss.run(&["robot", "list"]).code == 0).then_some(()));
}
