//! The audit: who commanded, who was refused and under which policy, after a restart and at another node; and proofs that need
//! no network.

use crate::support::network::{SERVICE, message, register_robots};
use crate::support::{Dev, Fleet, Process, connect, eventually, until};
use bytes::Bytes;
use ledger_api::v1::{AuditRequest, AuditRow};
use ledger_api::{Client, Context};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use serde_json::Value;
use std::time::Duration;

/// Everybody but Farhad.
const NOT_FARHAD: &str = r#"permit (principal, action, resource) unless { principal.name == "Farhad" };"#;
/// A Twist in little endian: forwards with 0.1 m/s, and a turn of 0.5 rad/s.
const TWIST: &str = "9a9999999999b93f0000000000000000000000000000000000000000000000000000000000000000000000000000e03f";

/// All rows that a node answers to this question.
async fn rows(client: &Client, request: AuditRequest) -> Vec<AuditRow> {
    let (mut found, mut request) = (Vec::new(), request);
    loop {
        let answer = client.audit(request.clone()).await.unwrap();
        found.extend(answer.rows);
        if !answer.more {
            return found;
        }
        request.after = answer.after;
    }
}

fn about(robot: &str) -> AuditRequest {
    AuditRequest { robot: robot.into(), ..AuditRequest::default() }
}

/// The part of rows that is the same at each node, in their order.
fn said(rows: &[AuditRow]) -> Vec<(u64, String, String, u64)> {
    rows.iter().map(|row| (row.height, row.decision.clone(), row.who.clone(), row.count)).collect()
}

struct Story {
    fleet: Fleet,
    nodes: Vec<Process>,
    owner: Context,
    salma: Context,
    farhad: Context,
    /// The grant, and the last command.
    transactions: [Hash; 2],
}

impl Story {
    /// Salma drives the Turtlebot; Farhad wants to, and is refused by a policy.
    async fn play() -> Self {
        let fleet = Fleet::found(2);
        let owner = fleet.owner();
        let [salma, farhad] = ["Salma", "Farhad"].map(|name| fleet.issue("Org1", name, Role::Member, &["Turtlebot4"]));
        let nodes: Vec<_> = fleet.nodes.iter().map(|place| place.start()).collect();
        let boss = connect(&owner).await;
        register_robots(&boss, "exclusive").await;
        let set = serde_json::json!({ "policies": [{ "id": "drivers", "text": NOT_FARHAD }] }).to_string();
        boss.invoke("abac", "policy", vec!["apply".into(), set.into()]).await.unwrap();
        let driver = connect(&salma).await;
        let granted = driver.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
        let mut last = Hash::ZERO;
        for seq in 1..=3 {
            let args = message(1, seq, &hex::decode(TWIST).unwrap());
            last = driver.invoke("abac", "set", args).await.unwrap().id;
        }
        let other = connect(&farhad).await;
        for _ in 0..4 {
            let refused = other.invoke("abac", "acquire", vec![SERVICE.into()]).await.unwrap_err();
            assert_eq!(refused.code, Code::DeniedByPolicy, "{refused}");
        }
        until("the refusals are on the ledger", || async {
            let rows = rows(&boss, AuditRequest { code: 3002, ..about("Turtlebot4") }).await;
            (rows.iter().map(|row| row.count).sum::<u64>() == 4).then_some(())
        })
        .await;
        Self { fleet, nodes, owner, salma, farhad, transactions: [granted.id, last] }
    }

    async fn at(&self, node: usize, who: &Context) -> Client {
        connect(&Context { nodes: vec![self.fleet.nodes[node].address.clone()], ..who.clone() }).await
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_commanded_who_was_refused_and_under_which_policy_is_found_after_a_restart_and_at_another_node() {
    let mut story = Story::play().await;
    let before = said(&rows(&story.at(0, &story.owner).await, about("Turtlebot4")).await);
    for node in 0..2 {
        story.nodes[node].interrupt();
    }
    // One index is lost. It is made again.
    std::fs::remove_dir_all(story.fleet.nodes[1].data.join("audit")).unwrap();
    story.nodes = story.fleet.nodes.iter().map(|place| place.start()).collect();
    for node in 0..2 {
        let boss = story.at(node, &story.owner).await;
        let found = until("the node knows as much as before", || async {
            let found = rows(&boss, about("Turtlebot4")).await;
            (found.len() >= before.len()).then_some(found)
        })
        .await;
        assert_eq!(said(&found), before, "node {node}");
        let of = |decision: &str| found.iter().filter(|row| row.decision == decision).collect::<Vec<_>>();
        let used = of("used");
        assert_eq!(used.iter().map(|row| row.count).sum::<u64>(), 3);
        assert!(
            used.iter().all(|row| row.who == "Org1/Salma" && row.epoch == 1 && row.policy_version == 1)
                && used.iter().all(|row| row.policies == ["drivers"]),
            "{used:?}"
        );
        let refused = of("refused");
        assert!(refused.iter().all(|row| row.who == "Org1/Farhad" && row.code == 3002 && row.policy_version == 1));
        assert!(
            refused.iter().all(|row| row.told_by == "Org1/org1-node" && row.transaction.len() == 32),
            "{refused:?}"
        );
        // The node's report is on the ledger, and can be proved.
        for row in &refused {
            let report = boss.transaction(Hash::from_slice(&row.transaction).unwrap()).await.unwrap();
            assert_eq!(report.height, row.height, "{row:?}");
        }
        assert_eq!(of("granted")[0].who, "Org1/Salma");
        let policies = rows(&boss, AuditRequest { organisation: "Org2".into(), ..AuditRequest::default() }).await;
        assert!(
            policies.iter().any(|row| row.decision == "policy" && row.who == "Org2/Admin" && row.policy_version == 1)
        );
    }

    // A robot of their own organisation, and their own people: nobody else's refusals are told to a member.
    let stranger = story.fleet.issue("Org2", "Max", Role::Member, &[]);
    let own = rows(&story.at(0, &stranger).await, about("Turtlebot4")).await;
    assert!(own.iter().any(|row| row.decision == "refused"), "Max looks after the robots of Org2");
    let own = rows(&story.at(0, &story.salma).await, AuditRequest { user: "Org1/Farhad".into(), ..about("") }).await;
    assert!(own.iter().any(|row| row.decision == "refused"), "they are of one organisation");
    story.nodes.iter_mut().for_each(Process::interrupt);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ledgerctl_shows_the_audit_and_the_history_with_decoded_values() {
    let mut story = Story::play().await;
    let ctl = |who: &Context| story.fleet.ctl().as_(&who.name);
    let lines = |text: &str| text.lines().map(|line| serde_json::from_str(line).unwrap()).collect::<Vec<Value>>();
    for command in [&["audit"][..], &["history", "Turtlebot4/cmd_vel"]] {
        let future = [command, &["--since", "2999-01-01T00:00:00Z"]].concat();
        ctl(&story.owner).run(&future).refused(3, &["LGR-1011", "--since is in the future", "time zone"]);
    }
    let shown = ctl(&story.owner).run(&["audit", "--robot", "Turtlebot4", "--since", "10m", "-o", "json"]).ok();
    let shown = lines(&shown.stdout);
    let used = shown.iter().find(|row| row["decision"] == "used").unwrap();
    assert_eq!((&used["who"], &used["policy_version"]), (&"Org1/Salma".into(), &1.into()));
    assert!(used["time"].is_u64() && used["time_utc"].as_str().unwrap().ends_with('Z'));
    let refused = ctl(&story.owner).run(&["audit", "--user", "Org1/Farhad", "--code", "LGR-3002", "--csv"]).ok().stdout;
    assert!(refused.starts_with("time,time_utc,height,decision,") && refused.lines().count() >= 2, "{refused}");
    let table = ctl(&story.farhad).run(&["audit", "--user", "Farhad"]).ok().stdout;
    assert!(table.contains("refused LGR-3002") && table.contains("version 1"), "{table}");
    ctl(&story.owner).run(&["audit", "--code", "9"]).refused(64, &[]);

    let history = ctl(&story.owner).run(&["history", "Turtlebot4/cmd_vel", "--since", "10m", "-o", "json"]).ok();
    let history = lines(&history.stdout);
    assert_eq!(history.len(), 3, "{history:?}");
    assert_eq!(history[0]["message"]["linear"]["x"], 0.1);
    assert_eq!((&history[2]["sender"], &history[2]["message"]["angular"]["z"]), (&"Org1/Salma".into(), &0.5.into()));
    let none = ctl(&story.owner).run(&[
        "history",
        "Turtlebot4/cmd_vel",
        "--since",
        "2000-01-01T00:00:00Z",
        "--until",
        "2000-01-02T00:00:00Z",
    ]);
    assert_eq!(none.ok().stdout, "");
    story.nodes.iter_mut().for_each(Process::interrupt);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_file_proves_a_transaction_on_a_machine_without_a_network() {
    let mut story = Story::play().await;
    let ctl = story.fleet.ctl().as_(&story.owner.name);
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).display().to_string();
    let (file, genesis) = (path("a.evidence"), path("genesis.json"));
    let [granted, command] = story.transactions.map(|id| id.to_string());
    let proved = ctl.json(&["prove", &granted, "--file", &file, "--genesis", &genesis]);
    assert_eq!((&proved["signer"], &proved["code"]), (&"Org1/Salma".into(), &"LGR-0000".into()), "{proved}");
    let late = path("late.evidence");
    let later = until("a certificate covers the command", || async {
        let ran = ctl.run(&["prove", &command, "--file", &late, "-o", "json"]);
        (ran.code == 0).then(|| ran.json())
    })
    .await;
    assert_eq!((&later["function"], &later["args"][0]["response"]), (&"set".into(), &SERVICE.into()), "{later}");
    assert_eq!(later["code"], "LGR-0000", "{later}");
    // Verdicts are proved as long as their blocks are kept, also after all nodes were restarted: by a later certificate.
    story.nodes.iter_mut().for_each(Process::interrupt);
    story.nodes = story.fleet.nodes.iter().map(|place| place.start()).collect();
    let again = path("again.evidence");
    for id in [&granted, &command] {
        let proved = until("a node proves it", || async {
            let ran = ctl.run(&["prove", id, "--file", &again, "-o", "json"]);
            (ran.code == 0).then(|| ran.json())
        })
        .await;
        assert_eq!((&proved["transaction"], &proved["code"]), (&id.as_str().into(), &"LGR-0000".into()), "{proved}");
    }
    if std::env::var_os("STORE_EVIDENCE").is_some() {
        store(&story.at(0, &story.owner).await, story.transactions).await;
    }
    story.nodes.iter_mut().for_each(Process::interrupt);

    // On another machine: no context, no node.
    let alone = crate::support::Ctl::at(directory.path());
    for (file, id) in [(&file, &granted), (&late, &command)] {
        let checked = alone.json(&["prove", "--check", file, "--genesis", &genesis]);
        assert_eq!((&checked["transaction"], &checked["signer"]), (&id.as_str().into(), &"Org1/Salma".into()));
        assert!(checked["strict_since"].is_null() && checked["began_at"] == 0, "{checked}");
    }
    let other = path("other.json");
    std::fs::write(&other, std::fs::read_to_string(&genesis).unwrap().replace("\"test\"", "\"tost\"")).unwrap();
    alone.run(&["prove", "--check", &file, "--genesis", &other]).refused(3, &[]);

    let mut damaged = std::fs::read(&file).unwrap();
    damaged[100] ^= 1;
    std::fs::write(&file, damaged).unwrap();
    alone.run(&["prove", "--check", &file, "--genesis", &genesis]).refused(1, &["LGR-"]);
}

/// The vectors of evidence, for a maintainer who has changed its form: STORE_EVIDENCE=1.
async fn store(owner: &Client, transactions: [Hash; 2]) {
    let mut files = Vec::new();
    let mut genesis = Bytes::new();
    for id in transactions {
        let (document, evidence, proved) = owner.evidence(id, None).await.unwrap();
        genesis = document;
        files.push(serde_json::json!({
            "transaction": id.to_string(), "signer": proved.signer.id(), "height": proved.header.height,
            "code": proved.verdict.code, "evidence": hex::encode(evidence.to_bytes()),
        }));
    }
    let vectors = serde_json::json!({"genesis": hex::encode(&genesis), "files": files});
    let path = crate::support::programs::repository().join("tests/fixtures/evidence.json");
    std::fs::write(path, vectors.to_string() + "\n").unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_refusals_makes_at_most_one_transaction_a_second_and_no_count_is_lost() {
    const FLOOD: u64 = 600;
    let fleet = Fleet::found(1);
    // The node says nothing of its own.
    fleet.nodes[0].configure("[order]\nattest_ms = 3600000");
    let owner = fleet.owner();
    let farhad = fleet.issue("Org1", "Farhad", Role::Member, &[]);
    let mut node = fleet.nodes[0].start();
    let boss = connect(&owner).await;
    register_robots(&boss, "exclusive").await;
    let began = boss.status().await.unwrap().height;
    let client = connect(&farhad).await;
    for number in 0..FLOOD {
        let robot = if number % 2 == 0 { "Turtlebot4" } else { "Husky" };
        client.invoke("abac", "acquire", vec![robot.into()]).await.unwrap_err();
    }
    until("all refusals are on the ledger", || async {
        let rows = rows(&boss, AuditRequest { user: "Org1/Farhad".into(), ..AuditRequest::default() }).await;
        (rows.iter().map(|row| row.count).sum::<u64>() == FLOOD).then_some(())
    })
    .await;
    let ended = boss.status().await.unwrap().height;
    let mut told = Vec::new();
    for height in began + 1..=ended {
        let block = boss.block(height).await.unwrap();
        told.extend(
            block.transactions.iter().flat_map(|call| &call.events).filter(|e| e.name == "refused").map(|_| block.time),
        );
    }
    assert!(!told.is_empty() && told.len() <= 12, "{} tellings of {FLOOD} refusals", told.len());
    assert!(told.windows(2).all(|two| two[1] - two[0] >= 1_000_000), "{told:?}");
    // Where nobody is refused, nothing is told.
    until("nothing is told for ten seconds", || async {
        let before = boss.status().await.unwrap().executed;
        tokio::time::sleep(Duration::from_secs(10)).await;
        (boss.status().await.unwrap().executed == before).then_some(())
    })
    .await;
    node.interrupt();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_accomplice_with_many_different_rejections_hides_no_try_of_a_thief() {
    const TRIES: u64 = 28;
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let [thief, accomplice] = ["Thief", "Accomplice"].map(|name| fleet.issue("Org1", name, Role::Member, &[]));
    let mut node = fleet.nodes[0].start();
    let boss = connect(&owner).await;
    register_robots(&boss, "exclusive").await;
    let (thief, accomplice) = (connect(&thief).await, connect(&accomplice).await);
    let flood = async {
        for number in 0..270 {
            let robot = format!("Nothing{}/cmd_vel", number % 90);
            accomplice.invoke("abac", "acquire", vec![robot.into()]).await.unwrap_err();
        }
    };
    let tries = async {
        for number in 0..TRIES {
            let service = format!("Husky/topic{number}");
            thief.invoke("abac", "acquire", vec![service.into()]).await.unwrap_err();
        }
    };
    tokio::join!(flood, tries);
    until("each try of the thief has a row of its own", || async {
        let rows = rows(&boss, AuditRequest { user: "Org1/Thief".into(), ..AuditRequest::default() }).await;
        let subjects: std::collections::BTreeSet<_> = rows.iter().map(|row| row.subject.clone()).collect();
        let count = rows.iter().map(|row| row.count).sum::<u64>();
        (count == TRIES && subjects.len() as u64 == TRIES).then_some(())
    })
    .await;
    node.interrupt();
}

#[test]
fn recorded_decisions_are_asked_again_under_other_policies() {
    let dev = Dev::start();
    let (owner, salma, farhad) =
        (dev.owner(), dev.user("Salma", &["Husky"], "ed25519"), dev.user("Farhad", &[], "p256"));
    salma.run(&["acquire", "Husky/cmd_vel", "--for", "10m"]).ok();
    farhad.run(&["acquire", "Husky/cmd_vel"]).refused(2, &["LGR-3001"]);
    eventually("the refusal is on the ledger", || {
        let shown = owner.run(&["audit", "--robot", "Husky", "--code", "LGR-3001", "--csv"]).ok().stdout;
        (shown.lines().count() == 2).then_some(())
    });
    let file = dev.home.path().join("all.cedar");
    std::fs::write(&file, "permit (principal, action, resource);").unwrap();
    let file = file.to_str().unwrap();
    let shadow = owner.json(&["policy", "shadow", file])[0].clone();
    assert_eq!(
        (&shadow["decisions"], &shadow["times"], &shadow["unknown"]),
        (&2.into(), &2.into(), &0.into()),
        "{shadow}"
    );
    let differ = shadow["differ"].as_array().unwrap();
    assert_eq!(differ.len(), 1, "{shadow}");
    assert_eq!((&differ[0]["who"], &differ[0]["was"]), (&"Org1/Farhad".into(), &"denied".into()));
    let diff = owner.json(&["policy", "diff", file, "--decisions", "5"]);
    assert_eq!((&diff["ended"], diff["recorded"]["differ"].as_array().unwrap().len()), (&0.into(), 1), "{diff}");

    // A proposed set runs beside the one in force, from its proposal on.
    let proposed = owner.json(&["policy", "propose", file, "--shadow"]);
    let id = proposed["id"].as_str().unwrap();
    let beside = || owner.json(&["policy", "shadow"])[0].clone();
    let before = beside();
    assert_eq!((&before["proposal"], &before["decisions"]), (&id.into(), &0.into()), "{before}");
    farhad.run(&["acquire", "Husky/cmd_vel"]).refused(2, &["LGR-3001"]);
    salma.run(&["release", "Husky/cmd_vel"]).ok();
    salma.run(&["acquire", "Husky/cmd_vel"]).ok();
    let after = eventually("both decisions are compared", || {
        let after = beside();
        (after["decisions"] == 2).then_some(after)
    });
    let differ = after["differ"].as_array().unwrap();
    assert_eq!((differ.len(), &differ[0]["who"]), (1, &"Org1/Farhad".into()), "{after}");
    assert_eq!(owner.json(&["policy", "history"]).as_array().unwrap().len(), 0, "nothing is in force by it");
    owner.run(&["policy", "withdraw", id]).ok();
    assert_eq!(owner.json(&["policy", "shadow"]).as_array().unwrap().len(), 0);

    // Somebody whom a command names is found by the name.
    dev.admin().run(&["identity", "revoke", "Farhad", "--reason", "lost"]).ok();
    let revoked = dev.admin().run(&["audit", "--user", "Farhad", "-o", "json"]).ok().stdout;
    assert!(revoked.lines().any(|row| row.contains("\"revoked\"") && row.contains("Org1/Farhad")), "{revoked}");
}

#[test]
fn under_the_set_in_force_no_recorded_decision_differs_whatever_was_decided() {
    let dev = Dev::start();
    let (owner, salma, farhad) =
        (dev.owner(), dev.user("Salma", &["Husky"], "ed25519"), dev.user("Farhad", &[], "p256"));
    let file = dev.home.path().join("in-force.cedar");
    std::fs::write(&file, owner.run(&["policy", "show", "default"]).ok().stdout).unwrap();
    let file = file.to_str().unwrap();
    salma.run(&["acquire", "Husky/cmd_vel"]).ok();
    farhad.run(&["acquire", "Husky/cmd_vel"]).refused(2, &["LGR-3001"]);
    farhad.run(&["take", "Husky/cmd_vel", "--reason", "mine"]).refused(2, &["LGR-3002"]);
    farhad.run(&["stop", "Husky"]).refused(2, &["LGR-3002"]);
    farhad.run(&["echo", "Husky/cmd_vel"]).refused(2, &["LGR-3001"]);
    owner.run(&["take", "Husky/cmd_vel", "--reason", "it turns in circles"]).ok();
    let shadow = eventually("all of them are asked again, but for what the owner took", || {
        let shadow = owner.json(&["policy", "shadow", file])[0].clone();
        (shadow["decisions"] == 5).then_some(shadow)
    });
    assert_eq!((&shadow["differ"], &shadow["unknown"]), (&serde_json::json!([]), &0.into()), "{shadow}");
    let shown = owner.run(&["audit", "--user", "Org1/Farhad", "-o", "json"]).ok().stdout;
    let rows = shown.lines().map(|row| serde_json::from_str::<Value>(row).unwrap());
    let mut actions: Vec<_> = rows.map(|row| row["action"].as_str().unwrap_or_default().to_owned()).collect();
    actions.retain(|action| !action.is_empty());
    actions.sort();
    actions.dedup();
    assert_eq!(actions, ["acquire", "override", "stop", "subscribe"], "{shown}");
}

#[test]
fn the_audit_names_whose_certificate_was_revoked_however_it_ended() {
    let dev = Dev::start();
    let admin = dev.admin();
    dev.user("Salma", &["Husky"], "ed25519");
    dev.user("Farhad", &["Husky"], "p256");
    // One by its number, the other as there is one with other attributes.
    let shown = admin.json(&["identity", "show", "Farhad"]);
    let serial = shown["certificates"][0]["serial"].as_str().unwrap();
    admin.run(&["identity", "revoke", "Farhad", "--serial", serial]).ok();
    let again = admin.json(&["identity", "register", "Salma", "--attr", "Turtlebot4", "--reissue"]);
    let (node, fingerprint) = (dev.fact("address"), dev.fact("ca_fingerprint"));
    let secret = again["secret"].as_str().unwrap();
    let enroll = ["enroll", "Salma", "--node", node, "--ca-fingerprint", fingerprint, "--secret", secret, "--force"];
    dev.ctl().run(&enroll).ok();
    for who in ["Org1/Farhad", "Org1/Salma"] {
        let row = eventually("the audit finds the end by its holder", || {
            let shown = admin.run(&["audit", "--user", who, "-o", "json"]).ok().stdout;
            let mut rows = shown.lines().map(|row| serde_json::from_str::<Value>(row).unwrap());
            rows.find(|row| row["decision"] == "revoked")
        });
        assert_eq!(row["who"], who, "{row}");
        assert!(row["by"].as_str().is_some_and(|by| !by.is_empty() && by != who), "{row}");
    }
}
