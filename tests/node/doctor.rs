//! The findings of `ledgerctl doctor` in a network. crates/cli/tests/doctor.rs provokes those on one machine.

use crate::support::network::{NodeWish, free_address, now};
use crate::support::{Ctl, Dev, Fleet, eventually};
use serde_json::Value;

fn findings(ctl: &Ctl) -> Vec<Value> {
    let ran = ctl.run(&["doctor", "--json"]);
    assert!(ran.code == 0 || ran.code == 1, "{ran:?}");
    let report = ran.json();
    assert_eq!(report["ok"] == true, ran.code == 0, "{ran:?}");
    report["findings"].as_array().unwrap().clone()
}

fn has(findings: &[Value], check: &str, state: &str, words: &str, repair: &str) -> bool {
    findings.iter().any(|finding| {
        finding["check"] == check
            && finding["state"] == state
            && finding["message"].as_str().unwrap().contains(words)
            && finding["try"].as_str().unwrap().contains(repair)
    })
}

#[test]
fn a_network_that_lacks_nothing_is_well_and_stops_side_doors_and_revocations_are_found() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let wanted = [
        ("context", "Salma is Org1/Salma of network dev"),
        ("certificate", "Org1/Salma (yours)"),
        ("certificate", "Org1/node1"),
        ("certificate", "(CA)"),
        ("port", "accepts connections"),
        ("identity", "accepted by the ledger"),
        ("clock", "agrees with the nodes"),
        ("quorum", "1 of 1 answers"),
        ("peers", "Org1/node1"),
        ("side doors", "none reported for 3 robots"),
        ("policy", "the built-in policy decides"),
    ];
    eventually("nothing is lacking", || {
        let well = findings(&salma);
        let missing = wanted.iter().find(|(check, words)| !has(&well, check, "ok", words, ""));
        missing.inspect(|(check, words)| println!("{check} {words} in {well:#?}")).is_none().then_some(())
    });

    // The robot's bridge reports who publishes beside it.
    let invited = dev.owner().json(&["identity", "register", "Turtlebot4", "--role", "robot"]);
    let fact = |name: &str| invited[name].as_str().unwrap().to_owned();
    let (node, ca, secret) = (fact("node"), fact("ca_fingerprint"), fact("secret"));
    let enroll = ["enroll", "Org2/Turtlebot4", "--node", &node, "--ca-fingerprint", &ca, "--secret", &secret];
    dev.ctl().run(&enroll).ok();
    let robot = dev.ctl().as_("Turtlebot4");
    robot.run(&["invoke", "abac", "report_side_door", "Turtlebot4/cmd_vel", "/cmd_vel", "2"]).ok();
    let door = findings(&salma);
    let words = "2 publish on /cmd_vel of Turtlebot4/cmd_vel in addition to the bridge, reported by Org2/Turtlebot4";
    assert!(has(&door, "side doors", "wrong", words, "ros2 topic info -v /cmd_vel"), "{door:#?}");
    dev.owner().run(&["stop", "Husky", "--reason", "cell is open"]).ok();
    let stopped = findings(&salma);
    assert!(
        has(&stopped, "stops", "advice", "Husky was stopped by Org2/Admin", "ledgerctl resume Husky"),
        "{stopped:#?}"
    );

    dev.owner().run(&["policy", "put", "night", "permit(principal, action, resource);"]).ok();
    let own = findings(&dev.owner());
    assert!(has(&own, "policy", "ok", "1 of Org2, none with errors", ""), "{own:#?}");

    dev.admin().run(&["identity", "revoke", "Salma"]).ok();
    let revoked = findings(&salma);
    let is_refused = |check| has(&revoked, check, "wrong", "LGR-2", "");
    assert!(is_refused("identity") || is_refused("node"), "{revoked:#?}");
}

#[test]
fn a_voter_that_is_gone_is_named_with_its_repair_and_a_lost_majority_is_told() {
    let wish = |name: &str, organisation: &str| NodeWish {
        name: name.into(),
        organisation: organisation.into(),
        voter: true,
        address: free_address(),
    };
    let wishes = [wish("a", "Org1"), wish("b", "Org2"), wish("c", "Org1")];
    let fleet = Fleet::found_with(&wishes, now());
    let owner = fleet.ctl().as_(&fleet.owner().name);
    let mut nodes: Vec<_> = fleet.nodes.iter().map(|place| place.start()).collect();
    let when = |what: &str, state: &str, words: &str, repair: &str| {
        eventually(what, || has(&findings(&owner), "quorum", state, words, repair).then_some(()));
    };
    when("all three answer", "ok", "3 of 3 answer", "");
    nodes[2].kill();
    when("one is silent", "advice", "2 of 3 voters are connected", "restart it if it runs and does not answer");
    eventually("it is named", || {
        let address = &fleet.nodes[2].address;
        has(&findings(&owner), "peers", "wrong", address, "systemctl status ledgerd").then_some(())
    });
    nodes[1].kill();
    when("nobody leads", "wrong", "1 of 3 voters are connected", "restart it if it runs and does not answer");
}
