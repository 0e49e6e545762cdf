//! A network that was founded with older rules activates newer ones while its nodes run.

use crate::support::ctl::{Ctl, verify};
use crate::support::{Fleet, until};
use ledger::Rules;
use ledger_identity::Role;
use serde_json::Value;

/// Founds the network as an older release did.
fn older(fleet: &Fleet) {
    let [newest, first] = [Rules::NEWEST, Rules::FIRST].map(|rules| format!("\"rules\": {rules}"));
    for node in &fleet.nodes {
        let path = node.data.join("genesis.json");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(&newest), "{text}");
        std::fs::write(path, text.replace(&newest, &first)).unwrap();
    }
}

/// What `network rules` shows, once it does and this holds.
async fn rules(ctl: &Ctl, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    until(what, || async {
        let ran = ctl.run(&["network", "rules", "-o", "json"]);
        (ran.code == 0).then(|| ran.json()).filter(&holds)
    })
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn organisations_activate_the_rules_that_nodes_speak_and_old_blocks_keep_theirs() {
    let fleet = Fleet::found(2);
    older(&fleet);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let mut nodes: Vec<_> = fleet.nodes.iter().map(|node| node.start()).collect();
    let (first, newest) = (Rules::FIRST.number(), Rules::NEWEST.number());
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
    assert_eq!(done, format!("rules {newest} are activated; ledgerctl network rules shows from which block on\n"));
    let shown = rules(&boss, "they are in force", |shown| shown["active"] == newest).await;
    assert_eq!(shown["activations"][0]["number"], newest, "{shown}");
    boss.run(&activate).refused(3, &["LGR-1011", "rules are never taken back"]);

    // Every block is executed again by the rules that it had.
    nodes.iter_mut().for_each(|node| node.interrupt());
    for place in &fleet.nodes {
        verify(&place.data).ok();
    }
    let _again: Vec<_> = fleet.nodes.iter().map(|node| node.start()).collect();
    rules(&boss, "they are in force after a restart", |shown| shown["active"] == newest).await;
}
