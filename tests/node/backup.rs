//! Backups of nodes, and the ways back: to the others under a new number, or alone when nothing of the network is left.

use crate::support::ctl::verify;
use crate::support::network::{NodeWish, free_address, message, now, register_robots};
use crate::support::process::Process;
use crate::support::programs::{refused, run_ledgerd as ledgerd, said};
use crate::support::{Ctl, Fleet, connect, eventually};
use ledger_api::Context;
use ledger_identity::Role;
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Voters of Org1, and an admin with a context for each: `Admin1`, `Admin2` and so on.
fn voters(count: usize) -> Fleet {
    let wish = |number: usize| NodeWish {
        name: format!("node{number}"),
        organisation: "Org1".into(),
        voter: true,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&(1..=count).map(wish).collect::<Vec<_>>(), now());
    let admin = fleet.issue("Org1", "Boss", Role::Admin, &[]);
    for (number, node) in (1..).zip(&fleet.nodes) {
        let context = Context { name: format!("Admin{number}"), nodes: vec![node.address.clone()], ..admin.clone() };
        context.save(&fleet.home()).unwrap();
    }
    fleet
}

fn admin(fleet: &Fleet, node: usize) -> Ctl {
    fleet.ctl().as_(&format!("Admin{node}"))
}

/// A robot that only this call registers: what must be there afterwards.
fn order(ctl: &Ctl, robot: &str) {
    eventually("something is ordered", || {
        let text = json!({"name": robot, "attribute_required": robot, "services": [{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"}]});
        let ran = ctl.run(&["invoke", "abac", "setup", &text.to_string()]);
        (ran.code == 0 || ran.stderr.contains("LGR-3011")).then_some(())
    });
}

/// Does the node that this context knows have the robot?
fn has(ctl: &Ctl, robot: &str) -> bool {
    eventually("the node answers", || {
        let ran = ctl.run(&["robot", "list"]);
        (ran.code == 0).then(|| ran.stdout.contains(&format!("{robot}/cmd_vel")))
    })
}

/// The audit of the node that this context knows; nothing if it does not answer yet.
fn audited(ctl: &Ctl) -> String {
    ctl.run(&["audit", "-o", "csv"]).stdout
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn manifest(backup: &Path) -> Value {
    serde_json::from_slice(&fs::read(backup.join("backup.json")).unwrap()).unwrap()
}

/// Makes backups until one has all that was committed before: the newest blocks of a running node follow within seconds.
fn back_up(ctl: &Ctl, config: &Path, to: &Path) -> String {
    let height = ctl.json(&["status"])["height"].as_u64().unwrap();
    eventually("the backup has it", || {
        let told = said(&ledgerd(&["backup", text(to)], config));
        (manifest(to)["height"].as_u64().unwrap() >= height).then_some(told)
    })
}

#[test]
fn a_backup_of_a_running_node_is_whole_and_verified_and_the_next_one_adds_to_it() {
    let fleet = voters(1);
    let (boss, place) = (admin(&fleet, 1), &fleet.nodes[0]);
    let _node = place.start();
    order(&boss, "Before");
    let backup = fleet.path().join("backup");
    let told = back_up(&boss, &place.config, &backup);
    for word in ["every signature verified", "contains the private key", "ledgerctl ca backup", "ledgerd restore"] {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    let first = manifest(&backup)["height"].as_u64().unwrap();
    verify(&backup).ok();
    assert_eq!(fs::metadata(backup.join("node.key")).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(!backup.join("ca").exists(), "the key of a CA is in no backup");
    order(&boss, "After");
    back_up(&boss, &place.config, &backup);
    assert!(manifest(&backup)["height"].as_u64().unwrap() > first);
    // A directory of something else is never written to.
    let other = fleet.path().join("other");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("letter"), "dear").unwrap();
    refused(&ledgerd(&["backup", text(&other)], &place.config), &["is in use"]);
    assert_eq!(fs::read_dir(&other).unwrap().count(), 1);
}

#[test]
fn a_restored_voter_does_not_start_as_it_was_and_comes_back_under_a_new_number() {
    let fleet = voters(3);
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    let (second, place) = (admin(&fleet, 2), &fleet.nodes[2]);
    order(&second, "Before");
    let backup = fleet.path().join("backup");
    said(&ledgerd(&["backup", text(&backup)], &place.config));
    order(&second, "After");
    nodes[2].kill();
    fs::remove_dir_all(&place.data).unwrap();

    let told = said(&ledgerd(&["restore", text(&backup)], &place.config));
    assert!(told.contains("ledgerd rejoin") && told.contains("ledgerd recover --force-single"), "{told}");
    refused(&ledgerd(&["restore", text(&backup)], &place.config), &["in use"]);
    refused(&ledgerd(&["run"], &place.config), &["restored from a backup", "remembers its votes", "ledgerd rejoin"]);
    refused(&ledgerd(&["backup", text(&backup)], &place.config), &["restored from a backup"]);
    // The others live: nothing is forced.
    let forced = ["recover", "--force-single", "--confirm", "test"];
    refused(
        &ledgerd(&forced, &place.config),
        &["a majority of the voters is not lost", "Org1/node1", "ledgerd rejoin"],
    );

    // While the original answers, its backup does not take its place; and not unasked.
    let rejoin = ["rejoin", "--node", fleet.nodes[0].address.as_str()];
    let original = std::net::TcpListener::bind(&place.address).unwrap();
    let agreed = [&rejoin[..], &["--original-is-gone"]].concat();
    refused(&ledgerd(&agreed, &place.config), &["node Org1/node3 is running", "answers at"]);
    drop(original);
    refused(&ledgerd(&rejoin, &place.config), &["was not confirmed", "Org1/node3", "--original-is-gone"]);
    let back = said(&ledgerd(&agreed, &place.config));
    assert!(back.contains("node Org1/node3 is node 4"), "{back}");
    nodes[2] = place.start();
    eventually("the node has what was ordered after its backup", || {
        let ran = admin(&fleet, 3).run(&["robot", "list"]);
        (ran.code == 0 && ran.stdout.contains("After")).then_some(())
    });
}

#[test]
fn a_rejoin_that_fails_halfway_leaves_nothing_that_starts_and_is_finished_by_the_same_command() {
    let fleet = voters(3);
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    let place = &fleet.nodes[2];
    order(&admin(&fleet, 1), "Before");
    nodes[2].kill();
    // Its new number cannot be written. Without it a founder has its old one.
    let in_the_way = place.data.join("node.json.new");
    fs::create_dir(&in_the_way).unwrap();
    let rejoin = ["rejoin", "--node", fleet.nodes[0].address.as_str()];
    refused(&ledgerd(&rejoin, &place.config), &["node.json"]);
    let backup = fleet.path().join("backup");
    let force = ["recover", "--force-single", "--confirm", "test"];
    for command in [&["backup", text(&backup)][..], &force, &["run"]] {
        refused(&ledgerd(command, &place.config), &["ledgerd rejoin was interrupted", "run it again"]);
    }

    fs::remove_dir(&in_the_way).unwrap();
    let back = said(&ledgerd(&rejoin, &place.config));
    assert!(back.contains("node Org1/node3 is node 5"), "{back}");
    nodes[2] = place.start();
    order(&admin(&fleet, 1), "After");
    eventually("the node has what was ordered since", || {
        let ran = admin(&fleet, 3).run(&["robot", "list"]);
        (ran.code == 0 && ran.stdout.contains("After")).then_some(())
    });
}

#[test]
fn a_damaged_backup_is_refused_before_anything_is_written() {
    let fleet = voters(1);
    let place = &fleet.nodes[0];
    let mut node = place.start();
    order(&admin(&fleet, 1), "Robot");
    let backup = fleet.path().join("backup");
    back_up(&admin(&fleet, 1), &place.config, &backup);
    node.interrupt();
    let data = fleet.path().join("moved");
    fs::rename(&place.data, &data).unwrap();

    let segment = first_segment(&backup.join("blocks"));
    let whole = fs::read(&segment).unwrap();
    let mut bytes = whole.clone();
    bytes[300] ^= 0x40;
    fs::write(&segment, &bytes).unwrap();
    refused(&ledgerd(&["restore", text(&backup)], &place.config), &["blocks/"]);
    assert!(!place.data.exists());
    fs::write(&segment, &whole).unwrap();
    // One that was never finished is none.
    let kept = fs::read(backup.join("backup.json")).unwrap();
    fs::remove_file(backup.join("backup.json")).unwrap();
    refused(&ledgerd(&["restore", text(&backup)], &place.config), &["is not a backup of a node"]);
    // One whose end was cut off was changed since it was made.
    let mut changed: Value = serde_json::from_slice(&kept).unwrap();
    changed["height"] = json!(changed["height"].as_u64().unwrap() + 1);
    fs::write(backup.join("backup.json"), changed.to_string()).unwrap();
    refused(&ledgerd(&["restore", text(&backup)], &place.config), &["was changed since it was made"]);
    assert!(!place.data.exists());
    fs::write(backup.join("backup.json"), kept).unwrap();
    said(&ledgerd(&["restore", text(&backup)], &place.config));
}

#[test]
fn a_restore_takes_no_configuration_over_unseen_and_deletes_nothing_that_is_there() {
    let fleet = voters(1);
    let place = &fleet.nodes[0];
    let mut node = place.start();
    order(&admin(&fleet, 1), "Robot");
    let backup = fleet.path().join("backup");
    back_up(&admin(&fleet, 1), &place.config, &backup);
    node.interrupt();

    // Without a configuration, that of the backup is shown, and nothing is done without a terminal or a word.
    let (data, settings) = (fleet.path().join("moved"), fs::read(&place.config).unwrap());
    fs::rename(&place.data, &data).unwrap();
    fs::remove_file(&place.config).unwrap();
    let listens = format!("listen = {:?}", place.address);
    let shown = [listens.as_str(), text(&place.data), "--take-config", "a terminal"];
    refused(&ledgerd(&["restore", text(&backup)], &place.config), &shown);
    assert!(!place.config.exists() && !place.data.exists());

    // What an earlier restore has left, or somebody else, is kept and named.
    let left = place.data.with_file_name(format!("{}.restoring", place.data.file_name().unwrap().to_str().unwrap()));
    fs::create_dir(&left).unwrap();
    fs::write(left.join("thesis"), "years of work").unwrap();
    let told = said(&ledgerd(&["restore", text(&backup), "--take-config"], &place.config));
    assert!(told.contains(&format!("kept     {}", text(&left))), "{told}");
    assert_eq!(fs::read_to_string(left.join("thesis")).unwrap(), "years of work");
    assert_eq!(fs::read(&place.config).unwrap(), settings);
    assert!(place.data.join("restored.json").exists());

    // A configuration that is there is used, and the differences are shown.
    fs::remove_dir_all(&place.data).unwrap();
    place.configure("[limits]\nin_flight_max = 7");
    let told = said(&ledgerd(&["restore", text(&backup)], &place.config));
    assert!(told.contains("limits.in_flight_max: 7 here, not set in the backup"), "{told}");
}

fn first_segment(blocks: &Path) -> PathBuf {
    let names = fs::read_dir(blocks).unwrap().map(|entry| entry.unwrap().path());
    names.filter(|path| path.extension().is_some_and(|kind| kind == "seg")).min().unwrap()
}

#[test]
fn the_only_node_of_a_network_comes_back_from_its_backup_by_force() {
    let fleet = voters(1);
    let (boss, place) = (admin(&fleet, 1), &fleet.nodes[0]);
    let mut node = place.start();
    order(&boss, "Kept");
    let backup = fleet.path().join("backup");
    back_up(&boss, &place.config, &backup);
    node.kill();
    let ca = place.data.join("ca");
    let away = fleet.path().join("ca");
    fs::rename(&ca, &away).unwrap();
    fs::remove_dir_all(&place.data).unwrap();
    said(&ledgerd(&["restore", text(&backup)], &place.config));
    fs::rename(&away, &ca).unwrap();
    said(&ledgerd(&["recover", "--force-single", "--confirm", "test"], &place.config));
    node = place.start();
    assert!(has(&boss, "Kept"));
    order(&boss, "New");
    // It votes alone as before, so there is nothing more to recover.
    node.interrupt();
    refused(&ledgerd(&["recover", "--force-single", "--confirm", "test"], &place.config), &["no voter is lost"]);
}

#[test]
fn after_the_loss_of_most_voters_one_goes_on_by_force_loudly_and_the_ledger_says_so_for_ever() {
    let fleet = voters(3);
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    let (first, survivor) = (admin(&fleet, 1), &fleet.nodes[0]);
    order(&first, "Kept");
    let force = ["recover", "--force-single", "--confirm", "test", "--reason", "fire in hall 2"];
    // While it runs nobody touches its directory.
    refused(&ledgerd(&force, &survivor.config), &["cannot open"]);
    nodes[1].kill();
    nodes[0].interrupt();
    // One of three answers, and two are a majority.
    refused(&ledgerd(&force, &survivor.config), &["a majority of the voters is not lost", "Org1/node3 answer"]);
    nodes[2].kill();

    assert_eq!(ledgerd(&["recover"], &survivor.config).status.code(), Some(64), "it is asked for by its name");
    let told = refused(
        &ledgerd(&["recover", "--force-single"], &survivor.config),
        &[
            "nothing was done",
            "Org1/node1 would be the only voter",
            "Org1/node2, Org1/node3 would vote no longer",
            "--confirm \"test\"",
        ],
    );
    assert!(told.contains("are lost"), "{told}");
    refused(&ledgerd(&["recover", "--force-single", "--confirm", "Test"], &survivor.config), &["\"Test\""]);
    let told = said(&ledgerd(&force, &survivor.config));
    for word in ["FORCED RECOVERY", "members_forced", "ledgerd rejoin", "ledgerctl network remove"] {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    let height: u64 = told.split("from block ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();

    nodes[0] = survivor.start();
    assert!(has(&first, "Kept"));
    order(&first, "New");
    let block = first.run(&["block", &height.to_string(), "-o", "json"]).ok().stdout;
    assert!(block.contains("members_forced"), "{block}");
    // The ledger wants no vote of the others any more, so none that starts as it was votes again by itself.
    let wanted = first.json(&["network", "nodes"]);
    let learners = wanted["nodes"].as_array().unwrap().iter().filter(|node| node["role"] == "learner").count();
    assert_eq!(learners, 2, "{wanted}");
    let backup = fleet.path().join("backup");
    said(&ledgerd(&["backup", text(&backup)], &survivor.config));

    // Light clients follow no change that the voters before have not signed. They begin anew where they are told.
    let light = first.run(&["light", "Kept"]);
    assert!(light.code != 0 && light.stderr.contains("LGR-2001"), "{light:?}");
    let checkpoint = fleet.path().join("checkpoint");
    let make = ["checkpoint", text(&checkpoint)];
    refused(&ledgerd(&make, &survivor.config), &["cannot open"]);
    // It is made of a block that the new voter has certified after the last change of who governs.
    let mut more = 0;
    eventually("a checkpoint is made", || {
        for _ in 0..2 {
            more += 1;
            order(&first, &format!("More{more}"));
            std::thread::sleep(std::time::Duration::from_millis(500));
        }
        nodes[0].interrupt();
        let made = ledgerd(&make, &survivor.config).status.success();
        nodes[0] = survivor.start();
        made.then_some(())
    });
    let shown = eventually("the light client goes on from the checkpoint", || {
        let ran = first.run(&["light", "Kept", "--checkpoint", text(&checkpoint)]);
        (ran.code == 0).then_some(ran.stdout)
    });
    assert!(shown.contains("1 of 1 voters"), "{shown}");

    // So does evidence: for its maker and for its reader.
    let text_of = json!({"name": "Proved", "attribute_required": "Proved", "services": [{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"}]});
    let set_up = first.json(&["invoke", "abac", "setup", &text_of.to_string()]);
    let id = set_up["id"].as_str().unwrap();
    let [evidence, genesis, checkpoint] =
        ["proved.evidence", "genesis.json", "checkpoint"].map(|name| text(&fleet.path().join(name)).to_owned());
    first.run(&["prove", id]).refused(2, &["--checkpoint"]);
    let proved = first.json(&["prove", id, "--file", &evidence, "--genesis", &genesis, "--checkpoint", &checkpoint]);
    let alone = fleet.ctl();
    let check = ["prove", "--check", &evidence, "--genesis", &genesis];
    alone.run(&check).refused(2, &[]);
    let checked = alone.json(&[&check[..], &["--checkpoint", &checkpoint]].concat());
    assert_eq!((&checked["transaction"], &checked["signed_by"]), (&proved["transaction"], &proved["signed_by"]));
    assert_eq!(checked["signed_by"], serde_json::json!(["Org1/node1"]));

    // One of the lost nodes is found: as it was it takes no part, and comes back under a new number.
    let back = said(&ledgerd(&["rejoin", "--node", &survivor.address], &fleet.nodes[1].config));
    assert!(back.contains("node Org1/node2 is node 4"), "{back}");
    nodes[1] = fleet.nodes[1].start();
    eventually("it has what was ordered since", || {
        let ran = admin(&fleet, 2).run(&["robot", "list"]);
        (ran.code == 0 && ran.stdout.contains("New")).then_some(())
    });
    first.run(&["network", "remove", "node3", "--i-mean-it"]).ok();
    // It votes again when the organisations have agreed, as any other node.
    let promoted = first.json(&["network", "promote", "node2"]);
    let owner = Context { nodes: vec![survivor.address.clone()], ..fleet.owner() };
    owner.save(&fleet.home()).unwrap();
    fleet.ctl().as_(&owner.name).run(&["network", "approve", promoted["proposal"]["id"].as_str().unwrap()]).ok();
    eventually("node2 votes again", || {
        let status = first.json(&["network", "status"]);
        let nodes = status["nodes"].as_array().unwrap().clone();
        nodes.iter().any(|node| node["name"] == "node2" && node["role"] == "voter").then_some(())
    });
    order(&admin(&fleet, 2), "Both");
}

#[test]
fn a_node_of_another_organisation_comes_back_to_a_recovered_node_with_the_blocks_of_its_backup_alone() {
    let wish = |name: &str, organisation: &str| NodeWish {
        name: name.into(),
        organisation: organisation.into(),
        voter: true,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org1"), wish("node3", "Org2")], now());
    let [lost, _, survivor] = [0, 1, 2].map(|number| &fleet.nodes[number]);
    let owner = Context { nodes: vec![survivor.address.clone()], ..fleet.owner() };
    let boss = Context { nodes: vec![lost.address.clone()], ..fleet.issue("Org1", "Boss", Role::Admin, &[]) };
    [&owner, &boss].into_iter().for_each(|context| context.save(&fleet.home()).unwrap());
    let (owner, boss) = (fleet.ctl().as_("Admin"), fleet.ctl().as_("Boss"));
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    order(&owner, "Kept");
    nodes[2].kill();
    order(&boss, "Lost");
    eventually("the audit knows what will be lost", || audited(&boss).contains("Lost").then_some(()));
    nodes.iter_mut().for_each(Process::kill);
    let proofs = ["certificates/newest.proof", "certificates/00000000000000000003.passed"];
    proofs.iter().for_each(|proof| fs::write(lost.data.join(proof), "of the lost history").unwrap());
    said(&ledgerd(&["recover", "--force-single", "--confirm", "test"], &survivor.config));
    nodes[2] = survivor.start();
    order(&owner, "New");
    let backup = fleet.path().join("backup");
    back_up(&owner, &survivor.config, &backup);

    let rejoin = ["rejoin", "--node", survivor.address.as_str(), "--blocks", text(&backup)];
    let other = voters(1);
    let _running = other.nodes[0].start();
    order(&admin(&other, 1), "Foreign");
    let foreign = fleet.path().join("foreign");
    said(&ledgerd(&["backup", text(&foreign)], &other.nodes[0].config));
    let wrong = ["rejoin", "--node", survivor.address.as_str(), "--blocks", text(&foreign)];
    refused(&ledgerd(&wrong, &lost.config), &["is of another network"]);
    let back = said(&ledgerd(&rejoin, &lost.config));
    assert!(back.contains("node Org1/node1 is node 4"), "{back}");
    // Nothing that it knew of the lost history counts as true.
    assert!(proofs.iter().all(|proof| !lost.data.join(proof).exists()));
    nodes[0] = lost.start();
    eventually("the audit knows what is true", || {
        let told = audited(&boss);
        assert!(!told.contains("Lost"), "{told}");
        told.contains("New").then_some(())
    });
    order(&owner, "Newest");
    eventually("it has what was ordered since", || {
        let ran = boss.run(&["robot", "list"]);
        (ran.code == 0 && ran.stdout.contains("Newest")).then_some(())
    });
}

#[test]
fn a_lost_voter_that_starts_again_as_it_was_changes_nothing_that_was_recovered() {
    let fleet = voters(3);
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(|place| place.start()).collect();
    let (first, survivor) = (admin(&fleet, 1), &fleet.nodes[0]);
    order(&first, "Kept");
    nodes.iter_mut().for_each(Process::kill);
    said(&ledgerd(&["recover", "--force-single", "--confirm", "test"], &survivor.config));
    nodes[0] = survivor.start();
    order(&first, "New");
    // Somebody in a hurry starts one of the others as it was.
    nodes[2] = fleet.nodes[2].start();
    for round in 0..5 {
        order(&first, &format!("More{round}"));
    }
    assert!(has(&first, "New") && has(&first, "More4"));
    let shown = first.json(&["network", "status"]);
    assert_eq!(shown["voters"], 1, "{shown}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_under_load_is_verified_and_soon_holds_what_was_acknowledged() {
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let place = &fleet.nodes[0];
    let _node = place.start();
    register_robots(&connect(&owner).await, "open").await;
    let client = connect(&salma).await;
    let (backup, mut seq, mut acknowledged) = (fleet.path().join("backup"), 0u64, 0);
    for _ in 0..4 {
        let (to, config) = (backup.clone(), place.config.clone());
        let copying = tokio::task::spawn_blocking(move || said(&ledgerd(&["backup", text(&to)], &config)));
        while !copying.is_finished() {
            seq += 1;
            acknowledged = client.invoke("abac", "set", message(0, seq, &seq.to_be_bytes())).await.unwrap().height;
        }
        copying.await.unwrap();
    }
    eventually("a backup has what was acknowledged", || {
        said(&ledgerd(&["backup", text(&backup)], &place.config));
        (manifest(&backup)["height"].as_u64().unwrap() >= acknowledged).then_some(())
    });
}
