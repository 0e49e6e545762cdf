//! `ledgerctl network …`: nodes come, vote, lead and go, as organisations decide.

use crate::join::Newcomer;
use crate::support::ctl::Ctl;
use crate::support::{Fleet, until};
use ledger_identity::Role;
use serde_json::Value;

/// The nodes in `network status`; none while nobody leads.
fn nodes(ctl: &Ctl) -> Option<Vec<Value>> {
    let ran = ctl.run(&["network", "status", "-o", "json"]);
    if ran.code == 4 {
        return None;
    }
    Some(ran.ok().json()["nodes"].as_array().unwrap().clone())
}

async fn becomes(ctl: &Ctl, name: &str, role: &str) {
    until(&format!("{name} becomes a {role}"), || async {
        let node = nodes(ctl)?.into_iter().find(|node| node["name"] == name)?;
        (node["role"] == role && node["reachable"] == true).then_some(())
    })
    .await;
}

/// The leader; 0 if nobody knows, or nobody answers yet.
fn leader(ctl: &Ctl) -> u64 {
    let ran = ctl.run(&["network", "status", "-o", "json"]);
    if ran.code == 0 { ran.json()["leader_id"].as_u64().unwrap() } else { 0 }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_joins_votes_leads_follows_and_leaves_by_commands_of_two_organisations() {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.issue("Org1", "Salma", Role::Member, &[]);
    fleet.owner();
    let (boss, salma, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Salma"), fleet.ctl().as_("Admin"));
    let _first = fleet.nodes[0].start();
    until("the first node leads", || async { (leader(&boss) == 1).then_some(()) }).await;
    let first = fleet.nodes[0].name.clone();

    let invited = boss.json(&["network", "invite", "--node", "second"]);
    let newcomer = Newcomer::new(&fleet, "second");
    newcomer.join(invited["token"].as_str().unwrap()).ok();
    let mut second = newcomer.run("second", &fleet);
    becomes(&boss, "second", "learner").await;
    // The same command changes nothing of a node that runs, and says so.
    newcomer
        .join(invited["token"].as_str().unwrap())
        .refused(&["is running already: it cannot join again", "is in use"]);
    for (node, id) in [("second", "node 2, a learner"), (&*first, "node 1, a voter")] {
        let refused = boss.run(&["network", "invite", "--node", node]);
        refused.refused(3, &["is running: it cannot join again", id, "ledgerd renew"]);
    }

    salma
        .run(&["network", "promote", "second"])
        .refused(2, &["LGR-3010", "wanted  an admin of Org1", "--context NAME"]);
    let waits = boss.json(&["network", "promote", "second"]);
    assert_eq!((&waits["executed"], &waits["pending"][0]), (&false.into(), &"Org2".into()), "{waits}");
    let listed = salma.run(&["network", "proposals"]).ok().stdout;
    assert!(
        listed.contains("make node Org1/second (id 2) a voter, at 127.0.0.1:") && listed.contains("Boss"),
        "{listed}"
    );
    let id = &waits["proposal"]["id"].as_str().unwrap()[..12];
    let done = owner.run(&["network", "approve", id]).ok().stdout;
    assert_eq!(done, "approved and executed: make node Org1/second (id 2) a voter\n");
    becomes(&boss, "second", "voter").await;

    // A leader hands over on demand only after it has led for a while, and says when.
    let transferred = until("the leader may hand over", || async {
        let ran = boss.run(&["network", "transfer", "second", "-o", "json"]);
        // On a busy machine nobody leads for a moment, or the other node does not take over in time.
        if ran.code != 0 && !["LGR-4002", "LGR-4004"].iter().any(|code| ran.stderr.contains(code)) {
            ran.refused(4, &["LGR-4003", "in 10 s", "try again in"]);
            return None;
        }
        (ran.code == 0).then(|| ran.json())
    })
    .await;
    assert_eq!(transferred["leader_id"], 2);
    until("all know who leads", || async { (leader(&boss) == 2).then_some(()) }).await;
    salma.run(&["network", "transfer"]).refused(2, &["LGR-3010"]);
    // A leader that is to lose its vote hands over first.
    boss.run(&["network", "demote", "2"]).ok();
    becomes(&boss, "second", "learner").await;
    until("the first node leads again", || async { (leader(&boss) == 1).then_some(()) }).await;
    boss.run(&["network", "demote", &first]).refused(3, &["LGR-3015", "is the last voter"]);

    boss.run(&["network", "remove", "Org1/second"]).ok();
    until("the node has left", || async { nodes(&boss)?.iter().all(|node| node["name"] != "second").then_some(()) })
        .await;
    let table = boss.run(&["network", "nodes"]).ok().stdout;
    assert!(table.lines().any(|line| line.contains("Org1/second") && line.ends_with("removed  removed")), "{table}");
    boss.run(&["network", "promote", "second"]).refused(3, &["LGR-1013", &first]);
    // Its number does not come back.
    second.kill();
    newcomer.join(invited["token"].as_str().unwrap()).refused(&["was removed from the network", "node 2", "move "]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_invitation_of_an_organisation_names_who_must_approve_and_can_be_taken_back() {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let _first = fleet.nodes[0].start();
    until("the node leads", || async { (leader(&boss) == 1).then_some(()) }).await;
    let invited = boss.run(&["network", "invite", "--organisation", "Org3"]).ok().stdout;
    for word in
        ["proposed: invite organisation Org3", "an admin of Org2 runs:", "machine of Org3/node1:\n  ledgerd join"]
    {
        assert!(invited.contains(word), "{word:?} is missing in {invited}");
    }
    let standing = owner.json(&["network", "proposals"]);
    let id = standing[0]["proposal"]["id"].as_str().unwrap().to_owned();
    owner.run(&["network", "withdraw", &id]).refused(3, &["LGR-1013", "Org2 has not approved this"]);
    boss.run(&["network", "withdraw", &id]).ok();
    owner.run(&["network", "approve", &id]).refused(3, &["LGR-1013", "no such proposal"]);
    assert_eq!(boss.run(&["network", "proposals"]).ok().stdout, "no proposal waits for approval\n");

    let again = boss.json(&["network", "invite", "--organisation", "Org3", "--first-node", "edge"]);
    let id = again["decision"]["proposal"]["id"].as_str().unwrap();
    owner.run(&["network", "approve", id]).ok();
    let newcomer = Newcomer::new(&fleet, "third");
    newcomer.join(again["token"].as_str().unwrap()).ok();
    let organisations = boss.json(&["network", "organisations"]);
    let named: Vec<_> = organisations.as_array().unwrap().iter().map(|one| (&one["name"], &one["nodes"])).collect();
    assert_eq!(named[2], (&"Org3".into(), &1.into()));
}
