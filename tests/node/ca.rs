//! The CA of an organisation: carried by several nodes, backed up, and never in the way of registering or revoking.

use crate::support::network::{NodePlace, NodeWish, free_address, now};
use crate::support::programs::{run_ledgerd as ledgerd, said};
use crate::support::small_disk::{SmallDisk, fill};
use crate::support::{Ctl, Fleet, Process, eventually};
use ledger_api::Context;
use ledger_identity::Role;
use serde_json::Value;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;

/// Three voters of Org1; the first one carries the CA. An admin with a context for each node, `Admin1` to `Admin3`.
fn three() -> (Fleet, Vec<Process>) {
    let wish = |number: usize| NodeWish {
        name: format!("node{number}"),
        organisation: "Org1".into(),
        voter: true,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&[wish(1), wish(2), wish(3)], now());
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    for (number, node) in (1..).zip(&fleet.nodes) {
        let context = Context { name: format!("Admin{number}"), nodes: vec![node.address.clone()], ..admin.clone() };
        context.save(&fleet.home()).unwrap();
    }
    let nodes = fleet.nodes.iter().map(NodePlace::start).collect();
    (fleet, nodes)
}

/// The admin at one of the nodes, counted from 1.
fn admin(fleet: &Fleet, node: usize) -> Ctl {
    fleet.ctl().as_(&format!("Admin{node}"))
}

/// The nodes that the ledger knows as carriers.
fn carriers(ctl: &Ctl) -> Vec<String> {
    let ran = ctl.run(&["ca", "status", "-o", "json"]);
    if ran.code != 0 {
        return Vec::new();
    }
    let shown = ran.json();
    shown["carriers"].as_array().unwrap().iter().map(|carrier| carrier["node"].as_str().unwrap().to_owned()).collect()
}

fn carried(ctl: &Ctl, count: usize) -> Vec<String> {
    eventually("the ledger knows who carries the CA", || Some(carriers(ctl)).filter(|known| known.len() == count))
}

/// Registers a name; answers with the words behind `ledgerctl` that enrol it.
fn invited(ctl: &Ctl, name: &str) -> Vec<String> {
    let registered = ctl.json(&["identity", "register", name]);
    command(registered["command"].as_str().unwrap())
}

fn command(line: &str) -> Vec<String> {
    line.split_whitespace().skip(1).map(str::to_owned).collect()
}

fn state(ctl: &Ctl, name: &str) -> Value {
    ctl.json(&["identity", "show", name])
}

#[test]
fn with_the_first_carriers_disk_lost_another_one_issues_and_any_node_registers_and_revokes() {
    let (fleet, mut nodes) = three();
    let third = admin(&fleet, 3);
    assert_eq!(carried(&third, 1), ["Org1/node1"]);
    let told = third.run(&["ca", "status"]).ok().stdout;
    assert!(told.contains("ledgerctl ca carry NODE") && told.contains("ledgerctl ca backup FILE"), "{told}");
    third.run(&["ca", "carry", "node2"]).ok();
    third.run(&["ca", "carry", "node2"]).ok();
    assert_eq!(carried(&third, 2), ["Org1/node1", "Org1/node2"]);
    let key = fs::metadata(fleet.nodes[1].data.join("ca/Org1/ca.key")).unwrap();
    assert_eq!(key.permissions().mode() & 0o777, 0o600);

    nodes[0].kill();
    fs::remove_dir_all(&fleet.nodes[0].data).unwrap();
    let salma = eventually("a leader is elected", || {
        let ran = third.run(&["identity", "register", "Salma", "-o", "json"]);
        (ran.code == 0).then(|| ran.json())
    });
    // The command that is printed leads to a carrier; at a node that is none, ledgerctl goes there by itself.
    let mut enrol = command(salma["command"].as_str().unwrap());
    let at = enrol.iter().position(|word| word == "--node").unwrap() + 1;
    enrol[at].clone_from(&fleet.nodes[2].address);
    fleet.ctl().run(&enrol).ok();
    assert_eq!(state(&third, "Salma")["certificates"].as_array().unwrap().len(), 1);
    fleet.ctl().as_("Salma").run(&["robot", "list"]).ok();
    third.run(&["identity", "revoke", "Salma", "--reason", "left"]).ok();
    assert_eq!(state(&third, "Salma")["certificates"][0]["revoked"], true);
    eventually("the carrier that is gone does not answer, and the other one does", || {
        let shown = third.json(&["ca", "status"]);
        (shown["carriers"][0]["answers"] == false && shown["carriers"][1]["answers"] == true).then_some(())
    });
    // The node whose disk is lost is forgotten, and the last carrier does not leave without a question.
    third.run(&["ca", "forget", "node1"]).ok();
    third.run(&["network", "remove", "node2"]).refused(3, &["--i-mean-it", "enrolment and renewal", "ca carry"]);
}

#[test]
fn a_backup_brings_the_ca_back_at_another_node_when_its_only_disk_is_lost() {
    let (fleet, mut nodes) = three();
    let second = admin(&fleet, 2);
    assert_eq!(carried(&second, 1), ["Org1/node1"]);
    let (file, words) = (fleet.path().join("ca-backup.pem"), fleet.path().join("words"));
    fs::write(&words, "five words that nobody guesses\n").unwrap();
    let (file_text, words_text) = (file.to_str().unwrap(), words.to_str().unwrap());
    let backup = ["ca", "backup", file_text, "--passphrase-file", words_text];
    let told = said(&ledgerd(&backup, &fleet.nodes[0].config));
    assert!(told.contains("ledgerd ca restore"), "{told}");
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(!ledgerd(&backup, &fleet.nodes[0].config).status.success(), "a copy is never overwritten");
    let old = invited(&second, "Early");
    fleet.ctl().run(&old).ok();

    nodes[0].kill();
    fs::remove_dir_all(&fleet.nodes[0].data).unwrap();
    let enrol = eventually("a leader is elected", || {
        let ran = second.run(&["identity", "register", "Salma", "-o", "json"]);
        (ran.code == 0).then(|| command(ran.json()["command"].as_str().unwrap()))
    });
    let mut elsewhere = enrol.clone();
    let at = elsewhere.iter().position(|word| word == "--node").unwrap() + 1;
    elsewhere[at].clone_from(&fleet.nodes[1].address);
    fleet.ctl().run(&elsewhere).refused(4, &["LGR-2012", "Org1/node1 at"]);

    let restore = ["ca", "restore", file_text, "--passphrase-file", words_text];
    let wrong = fleet.path().join("wrong");
    fs::write(&wrong, "five words that somebody guesses\n").unwrap();
    let refused =
        ledgerd(&["ca", "restore", file_text, "--passphrase-file", wrong.to_str().unwrap()], &fleet.nodes[1].config);
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("another passphrase"));
    said(&ledgerd(&restore, &fleet.nodes[1].config));
    assert!(!ledgerd(&restore, &fleet.nodes[1].config).status.success(), "a CA is never overwritten");
    // The node runs, and notices it.
    carried(&second, 2);
    fleet.ctl().run(&elsewhere).ok();
    let early = state(&second, "Early");
    assert_eq!(early["certificates"].as_array().unwrap().len(), 1, "the registry was on the ledger: {early}");
    fleet.ctl().as_("Early").run(&["robot", "list"]).ok();
}

#[test]
fn who_has_the_disk_makes_an_admin_whether_the_node_runs_or_not() {
    let fleet = Fleet::found(1);
    let node = fleet.nodes[0].start();
    let told = said(&ledgerd(&["admin-secret"], &fleet.nodes[0].config));
    let enrol = |told: &str| {
        let line = told.lines().find(|line| line.trim_start().starts_with("ledgerctl enroll")).unwrap();
        command(line.trim())
    };
    let words = enrol(&told);
    eventually("the node takes the secret", || (fleet.ctl().run(&words).code == 0).then_some(()));
    let boss = fleet.ctl().as_("admin");
    invited(&boss, "Salma");
    // A second secret, while the node is stopped, for another name; the first one is used.
    drop(node);
    let told = said(&ledgerd(&["admin-secret", "other"], &fleet.nodes[0].config));
    let mut node = fleet.nodes[0].start();
    let words = enrol(&told);
    eventually("the node is back", || (fleet.ctl().run(&words).code == 0).then_some(()));
    let other = fleet.ctl().as_("other");
    assert_eq!(state(&other, "other")["role"], "admin");
    let mut again = words.clone();
    again.extend(["--context".into(), "copy".into()]);
    fleet.ctl().run(&again).refused(2, &["LGR-2007"]);
    // It is revoked over the network like everybody else.
    boss.run(&["identity", "revoke", "other"]).ok();
    other.run(&["identity", "list"]).refused(2, &["LGR-2004"]);
    node.interrupt();
    let elsewhere = fleet.path().join("nothing.toml");
    fs::write(&elsewhere, "data = 'nowhere'\n").unwrap();
    assert!(!ledgerd(&["admin-secret"], &elsewhere).status.success());
}

#[test]
fn a_key_that_others_can_read_and_a_missing_ca_refuse_the_start_and_say_what_to_do() {
    let fleet = Fleet::found(1);
    let context = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let place = &fleet.nodes[0];
    let refused = |words: &[&str]| {
        let mut node = place.start();
        assert!(!node.wait().success());
        for word in words {
            assert!(node.stderr().contains(word), "{word:?} is missing in {}", node.stderr());
        }
    };
    let key = place.data.join("node.key");
    for mode in [0o640, 0o604, 0o620] {
        fs::set_permissions(&key, Permissions::from_mode(mode)).unwrap();
        let path = key.display().to_string();
        refused(&[&path, &format!("mode {mode:04o}"), "mode 0600", &format!("chmod 600 {path}")]);
    }
    fs::set_permissions(&key, Permissions::from_mode(0o600)).unwrap();

    let mut node = place.start();
    let ctl = fleet.ctl().as_(&context.name);
    eventually("the node carries the CA", || (carriers(&ctl) == ["Org1/org1-node"]).then_some(()));
    node.interrupt();
    let directory = place.data.join("ca/Org1");
    let away = fleet.path().join("away");
    fs::rename(&directory, &away).unwrap();
    refused(&[
        "the CA key of Org1 is missing",
        &directory.display().to_string(),
        "ledgerd ca restore",
        "ledgerd ca give-up Org1",
    ]);
    // Put back, it starts; given up, it starts too, and the ledger learns it.
    fs::rename(&away, &directory).unwrap();
    let mut node = place.start();
    eventually("the node is back", || (ctl.run(&["status"]).code == 0).then_some(()));
    node.interrupt();
    fs::rename(&directory, &away).unwrap();
    said(&ledgerd(&["ca", "give-up", "Org1"], &place.config));
    let _node = place.start();
    eventually("the ledger knows that nobody carries the CA", || {
        let ran = ctl.run(&["ca", "status", "-o", "json"]);
        (ran.code == 0 && ran.json()["carriers"].as_array().unwrap().is_empty()).then_some(())
    });
    let told = ctl.run(&["ca", "status"]).ok().stdout;
    assert!(told.contains("no node holds the CA key of Org1"), "{told}");
}

#[test]
fn an_enrolment_that_breaks_off_anywhere_is_finished_by_the_same_command_with_the_same_certificate() {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let ctl = fleet.ctl().as_("Admin");
    eventually("the node is there", || (ctl.run(&["status"]).code == 0).then_some(()));
    for name in ["Sal ma", "-salma", ".salma", "a/b"] {
        ctl.run(&["identity", "register", "--", name]).refused(3, &["LGR-1011", "no identity can be registered"]);
    }
    let salma = invited(&ctl, "Salma");
    // A home where nothing can be written: the secret is not even sent.
    let blocked = fleet.path().join("blocked");
    fs::write(&blocked, "a file").unwrap();
    Ctl::at(&blocked).run(&salma).refused(3, &["LGR-7002"]);
    assert_eq!(state(&ctl, "Salma")["enrolled"], false);
    // The context cannot be stored: the certificate is out, the key is kept.
    let home = fleet.path().join("salma");
    let user = Ctl::at(&home);
    fs::create_dir_all(home.join("contexts")).unwrap();
    fs::write(home.join("contexts/.Salma.new"), "in the way").unwrap();
    user.run(&salma).refused(3, &["LGR-7002", "run the same command again"]);
    let first = state(&ctl, "Salma")["certificates"].clone();
    assert_eq!(first.as_array().unwrap().len(), 1);
    fs::remove_file(home.join("contexts/.Salma.new")).unwrap();
    user.run(&salma).ok();
    assert_eq!(state(&ctl, "Salma")["certificates"], first);
    user.as_("Salma").run(&["robot", "list"]).ok();
    // From another machine, or later, the secret is good for nothing.
    Ctl::at(&fleet.path().join("mallory")).run(&salma).refused(2, &["LGR-2007"]);

    // Killed as soon as the key is on the disk: whether the certificate was issued or not, the next try finishes it.
    let farhad = invited(&ctl, "Farhad");
    let home = fleet.path().join("farhad");
    let user = Ctl::at(&home);
    let mut child = user.command(&farhad).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    eventually("the key is on the disk", || {
        let entries = fs::read_dir(home.join("contexts")).ok()?;
        let begun = entries.flatten().any(|entry| entry.path().join("key.pem").exists());
        (begun || child.try_wait().unwrap().is_some()).then_some(())
    });
    let _ended = child.kill();
    child.wait().unwrap();
    let ran = user.run(&farhad);
    assert!(ran.code == 0 || ran.stderr.contains("exists already"), "{ran:?}");
    user.as_("Farhad").run(&["robot", "list"]).ok();
    assert_eq!(state(&ctl, "Farhad")["certificates"].as_array().unwrap().len(), 1);
}

#[test]
fn what_is_pending_is_listed_and_cancelled() {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let ctl = fleet.ctl().as_("Admin");
    eventually("the node is there", || (ctl.run(&["status"]).code == 0).then_some(()));
    let salma = invited(&ctl, "Salma");
    let listed = ctl.run(&["identity", "list"]).ok().stdout;
    assert!(listed.lines().any(|line| line.contains("Salma") && line.contains("can enrol until")), "{listed}");
    ctl.run(&["identity", "cancel", "Salma"]).ok();
    fleet.ctl().run(&salma).refused(2, &["LGR-2007"]);
    ctl.run(&["identity", "cancel", "Salma"]).refused(3, &["LGR-1013"]);

    let token = ctl.json(&["network", "invite", "--node", "node9"]);
    let listed = ctl.run(&["network", "invite", "--list"]).ok().stdout;
    assert!(listed.contains("Org1/node9"), "{listed}");
    ctl.run(&["network", "invite", "--cancel", "node9"]).ok();
    let join = ledgerd(
        &["join", token["token"].as_str().unwrap(), "--address", &free_address()],
        &fleet.path().join("nine/ledgerd.toml"),
    );
    assert!(!join.status.success() && String::from_utf8_lossy(&join.stderr).contains("LGR-2007"), "{join:?}");
    assert_eq!(ctl.json(&["network", "invite", "--list"]), serde_json::json!([]));
    ctl.run(&["network", "invite", "--cancel", "node9"]).refused(3, &["LGR-1013"]);
}

#[test]
fn an_enrolment_on_a_full_disk_sends_no_secret_and_succeeds_when_there_is_space() {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let admin = fleet.ctl().as_("Admin");
    eventually("the node is there", || (admin.run(&["status"]).code == 0).then_some(()));
    let salma = invited(&admin, "Salma");
    let home = fleet.path().join("salma");
    fs::create_dir(&home).unwrap();
    let disk = SmallDisk::over(&home, fleet.path());
    let enroll = || disk.enter(&Ctl::at(&home).command(&salma)).output().unwrap();
    let ballast = disk.seen(&home).join("ballast");
    fill(&ballast);
    let refused = enroll();
    assert_eq!(refused.status.code(), Some(3), "{refused:?}");
    let text = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(text.contains("LGR-7002") && text.contains("No space left on device"), "{text}");
    assert_eq!(state(&admin, "Salma")["enrolled"], false);
    fs::remove_file(&ballast).unwrap();
    let done = enroll();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(state(&admin, "Salma")["certificates"].as_array().unwrap().len(), 1);
}

#[test]
fn an_admin_copies_restores_and_moves_the_ca_with_a_passphrase_and_the_ledger_knows_of_each_copy() {
    let (fleet, mut nodes) = three();
    let second = admin(&fleet, 2);
    assert_eq!(carried(&second, 1), ["Org1/node1"]);
    let (file, words) = (fleet.path().join("org1-ca.pem"), fleet.path().join("words"));
    fs::write(&words, "five words that nobody guesses\n").unwrap();
    let (file_text, words_text) = (file.to_str().unwrap(), words.to_str().unwrap());
    let backup = ["ca", "backup", file_text, "--passphrase-file", words_text];
    // No stranger to the organisation, no member, no short passphrase.
    fleet.issue("Org1", "Member", Role::Member, &[]).save(&fleet.home()).unwrap();
    fleet.ctl().as_("Member").run(&backup).refused(2, &["LGR-3010"]);
    let short = fleet.path().join("short");
    fs::write(&short, "short\n").unwrap();
    second.run(&["ca", "backup", file_text, "--passphrase-file", short.to_str().unwrap()]).refused(3, &["too short"]);
    assert!(!file.exists());

    let told = second.run(&backup).ok().stdout;
    assert!(told.contains("ledgerctl ca restore") && told.contains("Org1/node1"), "{told}");
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    second.run(&backup).refused(3, &["org1-ca.pem"]);
    let record = second.run(&["query", "msp", "carriers"]).ok().stdout;
    assert!(record.contains("copied") && record.contains("Org1/Admin"), "{record}");

    // It moves: the second node has it, and the first one has no key any more.
    second.run(&["ca", "move", "node2"]).refused(3, &["--i-mean-it", "removes the CA key"]);
    second.run(&["ca", "move", "node2", "--i-mean-it"]).ok();
    assert_eq!(carriers(&second), ["Org1/node2"]);
    assert!(!fleet.nodes[0].data.join("ca/Org1").exists());
    second.run(&["ca", "move", "node2", "--i-mean-it"]).refused(4, &["no other node holds"]);
    fleet.ctl().run(&invited(&second, "Salma")).ok();
    // The first node starts again without it.
    nodes[0].kill();
    nodes[0] = fleet.nodes[0].start();
    eventually("the first node is back", || (admin(&fleet, 1).run(&["robot", "list"]).code == 0).then_some(()));

    // The disk of the only carrier is lost; the copy brings the CA to another node over the network.
    nodes[1].kill();
    fs::remove_dir_all(&fleet.nodes[1].data).unwrap();
    let third = admin(&fleet, 3);
    let wrong = fleet.path().join("wrong");
    fs::write(&wrong, "five words that somebody guesses\n").unwrap();
    let restore = |words: &str| third.run(&["ca", "restore", file_text, "--node", "node3", "--passphrase-file", words]);
    eventually("a leader is elected", || (third.run(&["robot", "list"]).code == 0).then_some(()));
    restore(wrong.to_str().unwrap()).refused(3, &["another passphrase"]);
    restore(words_text).ok();
    restore(words_text).refused(3, &["holds this CA key already"]);
    carried(&third, 2);
    fleet.ctl().run(&invited(&admin(&fleet, 3), "Farhad")).ok();
    // The ledger still names the second node, whose disk is lost. The last key is not given up to it.
    third.run(&["ca", "move", "node2", "--i-mean-it"]).refused(4, &[]);
    assert!(fleet.nodes[2].data.join("ca/Org1").exists());
}
