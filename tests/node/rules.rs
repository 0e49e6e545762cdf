//! A network activates newer rules while its nodes run, and proposes other calls.

use crate::older::{newer, start_newer};
use crate::support::ctl::Ctl;
use crate::support::{Fleet, until};
use ledger::Rules;
use ledger_identity::Role;
use serde_json::Value;

/// The output of `network rules`, once it comes and this holds.
pub(crate) async fn rules(ctl: &Ctl, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    until(what, || async {
        let ran = ctl.run(&["network", "rules", "-o", "json"]);
        (ran.code == 0).then(|| ran.json()).filter(&holds)
    })
    .await
}

/// Any call that needs approval is proposed, by a quorum that is data.
fn proposals(boss: &Ctl, owner: &Ctl) {
    let text = boss.run(&["network", "quorums"]).ok().stdout;
    let set_role = "msp set_node_role organisations = majority default";
    assert!(text.lines().any(|line| line.split_whitespace().eq(set_role.split(' '))), "{text}");
    let set = ["network", "quorums", "--set", "msp", "set_node_role", "admins of Org2 = 1"];
    let proposed = boss.run(&set).ok().stdout;
    assert!(proposed.starts_with("proposed: call msp set_quorum chaincode=msp, function=set_node_role"), "{proposed}");
    assert_eq!(owner.run(&set).ok().stdout, "msp set_node_role now needs admins of Org2 = 1\n");
    let node = serde_json::json!({ "organisation": "Org2", "name": "org2-node", "role": "voter" }).to_string();
    let shown = boss.run(&["network", "propose", "msp", "set_node_role", &node]).ok().stdout;
    assert!(shown.contains("  needs        admins of Org2 = 1\n"), "{shown}");
    let waiting = boss.run(&["network", "proposals", "-o", "json"]).ok().json();
    assert_eq!((&waiting[0]["missing"], &waiting[0]["pending"][0]), (&1.into(), &"Org2".into()), "{waiting}");
    boss.run(&["network", "withdraw", waiting[0]["proposal"]["id"].as_str().unwrap()]).ok();
    boss.run(&["network", "quorums", "--set", "msp", "approve", "admins = 1"])
        .refused(3, &["LGR-1011", "set_node_role"]);
    boss.run(&["network", "propose", "abac", "robots"]).refused(3, &["LGR-1011", "set_policy_approvals"]);

    // A rule of the network about policies holds for every organisation.
    let approvals = ["network", "propose", "abac", "set_policy_approvals", "organisations = 2"];
    assert!(boss.run(&approvals).ok().stdout.starts_with("proposed: call abac set_policy_approvals"));
    assert_eq!(owner.run(&approvals).ok().stdout, "abac set_policy_approvals was executed\n");
    let put = ["policy", "put", "all", "permit (principal, action, resource);"];
    boss.run(&put).refused(2, &["LGR-3018", "organisations = 2, as the network requires: 1 more"]);
    let told = owner.run(&["policy", "approvals"]).ok().stdout;
    assert!(told.contains("organisations = 2"), "{told}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn organisations_activate_the_rules_that_nodes_speak_and_old_blocks_keep_theirs() {
    let fleet = Fleet::found(2);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let mut nodes: Vec<_> = fleet.nodes.iter().map(start_newer).collect();
    let (first, newest) = (Rules::NEWEST.number(), Rules::OF_TESTS.number());
    let all_speak = |shown: &Value| shown["nodes"].as_array().unwrap().iter().all(|node| node["newest"] == newest);
    let shown = rules(&boss, "both nodes have said what they speak", all_speak).await;
    assert_eq!((&shown["active"], &shown["pending"]), (&first.into(), &Value::Null), "{shown}");
    let text = boss.run(&["network", "rules"]).ok().stdout;
    assert!(text.contains(&format!("ledgerctl network rules --activate {newest}\n")), "{text}");

    let number = newest.to_string();
    let activate = ["network", "rules", "--activate", &number];
    boss.run(&["network", "rules", "--activate", "77"]).refused(3, &["LGR-3017", "Org1/org1-node"]);
    assert!(boss.run(&activate).ok().stdout.starts_with(&format!("proposed: activate rules {newest}\n")));
    let done = owner.run(&activate).ok().stdout;
    assert_eq!(done, format!("rules {newest} are activated; ledgerctl network rules shows from which block\n"));
    let shown = rules(&boss, "they are in force", |shown| shown["active"] == newest).await;
    assert_eq!(shown["activations"][0]["number"], newest, "{shown}");
    boss.run(&activate).refused(3, &["LGR-1011", "rules are never reverted"]);

    proposals(&boss, &owner);

    // Every block is executed again by the rules that it had.
    nodes.iter_mut().for_each(|node| node.interrupt());
    for place in &fleet.nodes {
        let data = place.data.to_str().unwrap();
        let verified = newer(&["verify", data]).output().unwrap();
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
    }
    let _again: Vec<_> = fleet.nodes.iter().map(start_newer).collect();
    rules(&boss, "they are in force after a restart", |shown| shown["active"] == newest).await;
}
