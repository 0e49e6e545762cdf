//! Confidential services with real nodes: what lies on disks, and who reads what with `ledgerctl`.

use crate::support::network::register_robots;
use crate::support::{Ctl, Dev, Fleet, connect};
use ledger::transaction::Transaction;
use ledger_api::{Context, Subscription};
use ledger_confidential::{Keyring, ReadingKey};
use ledger_identity::Role;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// A Twist that nothing else on a disk looks like, in hexadecimal digits with its header.
fn twist(text: &str) -> String {
    format!("00010000{}", hex::encode(format!("{text:-<48}")))
}

/// Is the body of the message in a file below the directory?
fn lies_below(directory: &Path, message: &str) -> bool {
    let wanted = hex::decode(message).unwrap().split_off(4);
    fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).any(|path| {
        if path.is_dir() {
            return lies_below(&path, message);
        }
        let bytes = fs::read(&path).unwrap_or_default();
        bytes.windows(wanted.len()).any(|part| part == wanted)
    })
}

fn publish(who: &Ctl, service: &str, message: &str) -> Value {
    who.publish(&[service, "--hex", message, "-o", "json"]).ok().json()
}

/// The messages of a service from the first block on.
fn echo(who: &Ctl, service: &str, count: &str) -> Vec<Value> {
    let ran = who.run(&["echo", service, "--hex", "--from", "0", "--count", count, "-o", "json"]).ok();
    ran.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_of_an_organisation_without_a_reader_has_no_message_of_a_confidential_service_on_its_disk() {
    let fleet = Fleet::found(2);
    let owner = fleet.owner();
    fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"]);
    let mut nodes = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    register_robots(&connect(&owner).await, "exclusive").await;
    let (admin, salma) = (fleet.ctl().as_("Admin"), fleet.ctl().as_("Salma"));
    tokio::task::spawn_blocking(move || {
        admin.run(&["robot", "set", "Turtlebot4/cmd_vel", "confidential=true"]).ok();
        for (service, message) in [("Turtlebot4/cmd_vel", twist("secret")), ("Husky/cmd_vel", twist("plain"))] {
            salma.json(&["acquire", service]);
            publish(&salma, service, &message);
        }
        let read = echo(&admin, "Turtlebot4/cmd_vel", "1");
        assert_eq!((&read[0]["payload"], &read[0]["sender"]), (&twist("secret").into(), &"Org1/Salma".into()));
    })
    .await
    .unwrap();
    for node in &mut nodes {
        node.interrupt();
    }
    for place in &fleet.nodes {
        assert!(!lies_below(&place.data, &twist("secret")), "{} has it", place.name);
        assert!(lies_below(&place.data, &twist("plain")), "{} lacks what is no secret", place.name);
    }
}

#[test]
fn a_reader_reads_from_its_first_key_until_it_is_taken_out_and_hears_of_what_is_for_others() {
    let dev = Dev::start();
    let (salma, farhad) =
        (dev.user("Salma", &["Turtlebot4"], "ed25519"), dev.user("Farhad", &["Turtlebot4"], "ed25519"));
    let service = "Turtlebot4/cmd_vel";
    let set = dev.owner().run(&["robot", "set", service, "confidential=true"]).ok();
    assert!(set.stderr.contains("you are now one of its readers"), "{}", set.stderr);
    assert!(dev.owner().run(&["robot", "list"]).ok().stdout.contains("exclusive, confidential"));
    salma.json(&["acquire", service]);
    publish(&salma, service, &twist("01"));
    let told = farhad.run(&["readers", service, "--enter"]).ok();
    assert!(told.stdout.contains("Org1/Farhad") && told.stdout.contains("yes"), "{}", told.stdout);
    publish(&salma, service, &twist("02"));
    let before = echo(&farhad, service, "2");
    assert!(before[0]["fault"].as_str().unwrap().contains("not for this reader"), "{before:?}");
    assert_eq!(before[1]["payload"], twist("02"));

    dev.owner().run(&["readers", service, "--remove", "Org1/Farhad"]).ok();
    publish(&salma, service, &twist("03"));
    dev.owner().run(&["robot", "set", "Turtlebot4", "attr-required=licence"]).ok();
    // The stream asks the policies, and so does the list of readers.
    farhad.run(&["readers", service, "--enter"]).refused(2, &["LGR-3001", "licence=true"]);
    farhad.run(&["echo", service]).refused(2, &["LGR-3001"]);
    let all = echo(&dev.owner(), service, "3");
    let payloads: Vec<&str> = all.iter().map(|message| message["payload"].as_str().unwrap()).collect();
    assert_eq!(payloads, ["01", "02", "03"].map(twist), "the owner reads all");

    // A recording of who may read has what was sent.
    let file = dev.home.path().join("run.mcap");
    let file = file.to_str().unwrap();
    let recorded = dev.owner().json(&["record", service, "--since", "0", "--to", file]);
    assert_eq!((&recorded["messages"], recorded.get("unreadable")), (&3.into(), None));
    let bytes = fs::read(file).unwrap();
    let wanted = hex::decode(twist("03")).unwrap();
    assert!(bytes.windows(wanted.len()).any(|part| part == wanted));
}

#[test]
fn a_revoked_reader_keeps_what_it_had_and_gets_nothing_after() {
    let dev = Dev::start();
    let (salma, farhad) =
        (dev.user("Salma", &["Turtlebot4"], "ed25519"), dev.user("Farhad", &["Turtlebot4"], "ed25519"));
    let service = "Turtlebot4/cmd_vel";
    dev.owner().run(&["robot", "set", service, "confidential=true"]).ok();
    salma.json(&["acquire", service]);
    farhad.run(&["readers", service, "--enter"]).ok();
    publish(&salma, service, &twist("01"));
    dev.admin().run(&["identity", "revoke", "Farhad"]).ok();
    let readers = dev.owner().json(&["readers", service]);
    let names: Vec<_> = readers["readers"].as_array().unwrap().iter().map(|reader| reader["reader"].clone()).collect();
    assert_eq!(names, ["Org2/Admin"]);
    publish(&salma, service, &twist("02"));
    // Who has the blocks, and Farhad's key, opens the first message and not the second.
    let context = Context::load(dev.home.path(), Some("Farhad")).unwrap();
    let own = ReadingKey::from_secret(&context.reading_secret().unwrap()).unwrap();
    let mut keyring = Keyring::new(context.network, "Org1/Farhad".into(), own);
    let opened = read_chain(&dev, service, &mut keyring);
    assert_eq!(opened, [true, false]);
}

/// Opens what it can of the first two messages on a service, from the blocks as a node shows them to the owner.
#[tokio::main(flavor = "current_thread")]
async fn read_chain(dev: &Dev, service: &str, keyring: &mut Keyring) -> Vec<bool> {
    let owner = connect(&Context::load(dev.home.path(), Some("dev-org2-admin")).unwrap()).await;
    let mut events = owner.subscribe(Subscription {
        from_height: 1,
        chaincode: "abac".to_owned(),
        subjects: vec![service.to_owned()],
        names: vec!["keyed".to_owned(), "message".to_owned()],
        ..Subscription::default()
    });
    let mut opened = Vec::new();
    while opened.len() < 2 {
        let delivery = events.next().await.unwrap();
        for event in delivery.events {
            let transaction = Transaction::decode(event.transaction).unwrap();
            let args = &transaction.body().args;
            let number = |index: usize| std::str::from_utf8(&args[index]).unwrap().parse().unwrap();
            if event.name == "keyed" {
                keyring.learn(service, "Org1/Salma", delivery.height, &serde_json::from_slice(&args[2]).unwrap());
            } else {
                opened.push(keyring.open(service, "Org1/Salma", number(1), number(2), &args[3]).is_ok());
            }
        }
    }
    opened
}
