//! Procedures of docs/operations.md for bad days, with real processes: those that no other file of these tests has.

use crate::support::directory::copy;
use crate::support::network::{NodeWish, free_address, now};
use crate::support::page::get;
use crate::support::{Ctl, Fleet, Process, eventually, programs};
use ledger_api::Context;
use ledger_identity::Role;
use serde_json::json;

fn robot(name: &str) -> String {
    let service = json!({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "exclusive"});
    json!({"name": name, "attribute_required": name, "trusted": ["Org1", "Org2"], "services": [service]}).to_string()
}

fn answers(ctl: &Ctl) {
    eventually("the network answers", || (ctl.run(&["robot", "list"]).code == 0).then_some(()));
}

#[test]
fn the_stolen_key_of_a_person_is_worth_nothing_from_its_revocation_on_and_the_person_comes_back() {
    let fleet = Fleet::found(1);
    fleet.owner();
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let (owner, boss) = (fleet.ctl().as_("Admin"), fleet.ctl().as_("Boss"));
    answers(&owner);
    owner.run(&["invoke", "abac", "setup", &robot("Turtlebot4")]).ok();
    let invited = boss.json(&["identity", "register", "Salma", "--attr", "Turtlebot4"]);
    let enrol = |line: &serde_json::Value| -> Vec<String> {
        line.as_str().unwrap().split_whitespace().skip(1).map(str::to_owned).collect()
    };
    fleet.ctl().run(&enrol(&invited["command"])).ok();
    fleet.ctl().as_("Salma").run(&["acquire", "Turtlebot4", "--for", "10m"]).ok();
    // Somebody copies her home.
    let thief = fleet.path().join("thief");
    copy(&fleet.home(), &thief);
    let thief = Ctl::at(&thief).as_("Salma");
    thief.run(&["renew", "Turtlebot4"]).ok();

    boss.run(&["identity", "revoke", "Salma", "--reason", "stolen laptop"]).ok();
    thief.run(&["renew", "Turtlebot4"]).refused(2, &["LGR-2004"]);
    thief.run(&["acquire", "Turtlebot4"]).refused(2, &["LGR-2004"]);
    let shown = owner.run(&["robot", "show", "Turtlebot4"]).ok().stdout;
    assert!(!shown.contains("Org1/Salma"), "{shown}");

    let again = boss.json(&["identity", "register", "Salma", "--attr", "Turtlebot4", "--reissue"]);
    fleet.ctl().run(&enrol(&again["command"])).ok();
    fleet.ctl().as_("Salma").run(&["acquire", "Turtlebot4"]).ok();
    thief.run(&["acquire", "Turtlebot4"]).refused(2, &["LGR-2004"]);
}

#[test]
fn the_stolen_key_of_a_node_opens_nothing_once_its_certificate_is_revoked() {
    let wish = |number: usize, voter| NodeWish {
        name: format!("node{number}"),
        organisation: "Org1".into(),
        voter,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&[wish(1, true), wish(2, false)], now());
    let admin = fleet.issue("Org1", "Boss", Role::Admin, &[]);
    Context { nodes: vec![fleet.nodes[0].address.clone()], ..admin.clone() }.save(&fleet.home()).unwrap();
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    let boss = fleet.ctl().as_("Boss");
    answers(&boss);
    nodes[1].interrupt();
    boss.run(&["network", "remove", "node2", "--i-mean-it"]).ok();
    eventually("the ledger knows the certificate of the node", || {
        (boss.run(&["identity", "revoke", "node2", "--reason", "stolen disk"]).code == 0).then_some(())
    });
    // Whoever has the disk comes in no more, neither as a new node nor as the old one.
    let mut command = programs::node();
    let address = fleet.nodes[0].address.as_str();
    let refused = command.args(["rejoin", "--node", address, "--config"]).arg(&fleet.nodes[1].config).output().unwrap();
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && told.contains("LGR-"), "{told}");
    let mut stolen = fleet.nodes[1].start();
    boss.run(&["invoke", "abac", "setup", &robot("Husky")]).ok();
    let at_it = Context { name: "AtIt".into(), nodes: vec![fleet.nodes[1].address.clone()], ..admin };
    at_it.save(&fleet.home()).unwrap();
    let height = boss.json(&["status"])["height"].as_u64().unwrap();
    let behind = eventually("the stolen node answers whoever asks it", || {
        let ran = fleet.ctl().as_("AtIt").run(&["status", "-o", "json"]);
        serde_json::from_str::<serde_json::Value>(&ran.stdout).ok()?["height"].as_u64()
    });
    assert!(behind < height, "it has block {behind}, the network {height}");
    stolen.kill();
    boss.run(&["robot", "list"]).ok();
    nodes[0].check();
    nodes[0].no_panic();
}

#[test]
fn a_node_whose_clock_is_behind_block_time_orders_nothing_until_an_operator_vouches_for_the_clock() {
    // Block time begins four minutes ahead: as if the clock had been ahead before, or is behind now.
    let fleet = Fleet::found_at(1, now() + 240_000_000);
    let owner = fleet.owner();
    owner.save(&fleet.home()).unwrap();
    let page = free_address();
    fleet.nodes[0].configure(&format!("[admin]\nlisten = \"{page}\""));
    let mut node = fleet.nodes[0].start();
    let owner = fleet.ctl().as_("Admin");
    eventually("the node answers", || (owner.run(&["status"]).code != 4).then_some(()));
    let ran = owner.run(&["invoke", "abac", "setup", &robot("Turtlebot4")]);
    assert!(ran.code != 0 && ran.stderr.contains("LGR-4007"), "{ran:?}");
    // It says so itself, wherever somebody watches it.
    let (status, body) = get(&page, "/readyz");
    assert_eq!(status, "HTTP/1.1 503 Service Unavailable");
    let reason = "the clock of the only voter is behind block time since the start";
    assert!(body.contains(&format!("[-] clock failed: {reason}")), "{body}");
    for command in [&["status", "--check"][..], &["network", "status", "--check"]] {
        let ran = owner.run(command);
        assert!(ran.code == 1 && ran.stdout.contains(&format!("attention: Org1/org1-node: {reason}")), "{ran:?}");
    }
    node.interrupt();

    let mut command = fleet.nodes[0].command();
    command.arg("--trust-clock");
    let mut node = fleet.nodes[0].start_as(command);
    eventually("it orders", || (owner.run(&["invoke", "abac", "setup", &robot("Turtlebot4")]).code == 0).then_some(()));
    // Block time stays ahead of the machine for an hour.
    let body = get(&page, "/readyz").1;
    assert!(body.contains("[-] clock failed: block time is "), "{body}");
    node.interrupt();
}
