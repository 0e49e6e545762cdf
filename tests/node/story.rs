//! People's work with `ledgerctl` on a network for playing, from the first command to the last.

use crate::support::{Ctl, Dev, eventually};
use serde_json::Value;

/// A Twist with its encapsulation header, as any publisher in little endian writes it.
const TWIST: &str = "00010000\
    9a9999999999b93f0000000000000000000000000000000000000000000000000000000000000000000000000000e03f";

fn names(list: &Value, field: &str) -> Vec<String> {
    list.as_array().unwrap().iter().map(|entry| entry[field].as_str().unwrap().to_owned()).collect()
}

/// Every line of `-o json` is one value.
fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn dev_prints_its_facts_and_leaves_nothing_behind_after_ctrl_c() {
    let mut dev = Dev::start();
    assert!(dev.fact("address").starts_with("127.0.0.1:"));
    assert_eq!(dev.fact("ca_fingerprint").len(), 64);
    assert_eq!(dev.facts["contexts"], serde_json::json!(["dev-org1-admin", "dev-org2-admin"]));
    assert!(dev.data().join("genesis.json").is_file());
    assert_eq!(dev.process.stdout().lines().count(), 1, "one line of JSON and nothing else");
    for context in ["dev-org1-admin", "dev-org2-admin"] {
        assert!(dev.home.path().join("contexts").join(context).is_dir());
    }
    dev.process.interrupt();
    assert!(!dev.data().exists(), "the temporary directory is still there");
    assert!(!dev.data().parent().unwrap().exists(), "its parent is still there");
    let left = std::fs::read_dir(dev.home.path().join("contexts")).unwrap().count();
    assert_eq!(left, 0, "contexts of a network that is gone");
}

#[test]
fn two_users_share_a_robot_as_in_the_paper() {
    let mut dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "p256");

    let who = salma.json(&["whoami"]);
    assert_eq!(who["id"], "Org1/Salma");
    assert_eq!(who["attributes"], serde_json::json!({"Husky": "true", "Turtlebot4": "true"}));
    assert_eq!(who["online"]["state"], "accepted");
    assert_eq!(farhad.json(&["whoami"])["id"], "Org1/Farhad");

    // Refused with the reason: the attribute, the holder, the deadline.
    farhad.run(&["acquire", "Husky"]).refused(2, &["LGR-3001", "Husky", "found", "wanted", "try"]);
    let grant = salma.json(&["acquire", "Turtlebot4", "--for", "60s"]);
    assert_eq!((&grant["holder"], &grant["epoch"]), (&"Org1/Salma".into(), &1.into()));
    let held = farhad.run(&["acquire", "Turtlebot4"]).refused(5, &["LGR-3005", "Org1/Salma", "until"]);
    assert!(held.stderr.contains("20"), "a date: {held:?}");
    let held: Value = serde_json::from_str(farhad.run(&["acquire", "Turtlebot4", "-o", "json"]).stderr.trim()).unwrap();
    assert_eq!((&held["code"], &held["name"]), (&"LGR-3005".into(), &"HELD".into()));

    let renewed = salma.json(&["renew", "Turtlebot4", "--for", "90s"]);
    assert!(renewed["expires"].as_u64() > grant["expires"].as_u64(), "{renewed} after {grant}");
    farhad.run(&["renew", "Turtlebot4"]).refused(2, &["LGR-3006"]);

    // Messages: what is published arrives with its sender, and a stranger's does not.
    let sent = salma.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST, "-o", "json"]).ok().json();
    farhad.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).refused(2, &["LGR-3006"]);
    let height = sent["height"].to_string();
    let twist = hex::decode(TWIST).unwrap();
    let from_stdin = salma.publish_with(&["Turtlebot4/cmd_vel", "--stdin"], &twist).ok();
    assert!(from_stdin.stdout.contains("published 52 bytes"), "{from_stdin:?}");
    let echo = ["echo", "Turtlebot4/cmd_vel", "--from", &height, "--count", "2", "-o", "json"];
    let heard = lines(&salma.run(&echo).ok().stdout);
    assert_eq!(heard.len(), 2);
    assert_eq!((&heard[0]["payload"], &heard[0]["sender"]), (&TWIST.into(), &"Org1/Salma".into()));
    assert_eq!(heard[0]["transaction"], sent["transaction"]);
    assert_eq!(heard[1]["payload"], TWIST);
    assert!(heard[0]["seq"].as_u64() < heard[1]["seq"].as_u64());

    // Where it stands on the chain.
    let record = salma.json(&["tx", sent["transaction"].as_str().unwrap()]);
    assert_eq!((&record["height"], &record["code"]), (&sent["height"], &"OK".into()));
    assert_eq!((&record["creator"], &record["function"]), (&"Org1/Salma".into(), &"set".into()));
    let block = salma.json(&["block", &height]);
    assert!(names(&block["transactions"], "id").contains(&sent["transaction"].as_str().unwrap().to_owned()));
    let status = salma.json(&["status"]);
    assert_eq!(status["role"], "leader");
    assert!(status["height"].as_u64() >= sent["height"].as_u64());

    assert_eq!(salma.json(&["release", "Turtlebot4"])["released"][0]["holder"], "Org1/Salma");
    let grant = farhad.json(&["acquire", "Turtlebot4"]);
    assert_eq!((&grant["holder"], &grant["epoch"]), (&"Org1/Farhad".into(), &2.into()));
    // The old epoch is worth nothing any more.
    salma.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).refused(2, &["LGR-300"]);

    // What was refused is told to admins only.
    assert!(names(&dev.admin().json(&["denials"]), "code").contains(&"LGR-3001".to_owned()));
    farhad.run(&["denials"]).refused(2, &["LGR-3010"]);
    assert_eq!(names(&dev.admin().json(&["identity", "list"]), "name").len(), 4, "Admin, node1, Salma, Farhad");
    dev.process.check();
    dev.process.interrupt();
}

#[test]
fn an_owner_registers_a_robot_that_reads_as_in_the_paper() {
    let dev = Dev::start();
    let service = "/cmd_vel=geometry_msgs/msg/Twist,mode=open";
    let add = ["robot", "add", "Go2", "--attr-required", "Go2", "--trust", "Org1", "--service", service];
    let member = dev.user("Salma", &["Go2"], "ed25519");
    member.run(&add).refused(2, &["LGR-3010"]);
    dev.owner().run(&add).ok();
    let robot = dev.owner().json(&["robot", "show", "Go2"]);
    for (field, value) in [("Name", "Go2"), ("SubTopic", "/cmd_vel"), ("PubTopic", ""), ("owner", "")] {
        assert_eq!(robot[field], value, "{field} of {robot}");
    }
    assert_eq!(robot["UnderOp"], false);
    let mut listed = names(&member.json(&["robot", "list"]), "Name");
    listed.sort();
    assert_eq!(listed, ["Go2", "Husky", "OptiTrack", "Turtlebot4"]);
    member.run(&["robot", "show", "Go"]).refused(3, &["LGR-3003", "Go2"]);

    // Calls by name of chaincode and function.
    let asked = member.json(&["query", "abac", "robot", "Go2"]);
    assert!(asked.to_string().contains("\"Name\":\"Go2\""), "{asked}");
    let acquired = member.json(&["invoke", "abac", "acquire", "Go2/cmd_vel"]);
    assert!(acquired.to_string().contains("\"holder\":\"Org1/Salma\""), "{acquired}");
}

#[test]
fn an_unreachable_node_is_exit_4_and_a_wrong_command_line_64() {
    let mut dev = Dev::start();
    let admin = dev.admin();
    dev.process.kill();
    admin.run(&["status"]).refused(4, &["LGR-4001", dev.fact("address")]);
    admin.run(&["acquire", "Husky"]).refused(4, &["LGR-4001"]);
    assert_eq!(admin.run(&["aquire", "Husky"]).code, 64);
    dev.ctl().as_("nobody").run(&["status"]).refused(3, &["LGR-7003"]);
}

#[test]
fn revoking_an_identity_ends_its_grants_in_the_same_block() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    salma.json(&["acquire", "Turtlebot4", "--for", "5m"]);
    dev.owner().run(&["identity", "revoke", "Salma"]).refused(3, &["LGR-1013"]);
    let revoked = dev.admin().json(&["identity", "revoke", "Salma", "--reason", "laptop stolen"]);
    let height = revoked["certificates"][0]["height"].to_string();

    // The block that revokes the certificate is the block that ends the grant.
    let block = dev.owner().json(&["block", &height]);
    assert_eq!(names(&block["transactions"], "function"), ["revoke_identity"]);
    let events = &block["transactions"][0]["events"];
    assert_eq!(names(events, "name"), ["revoked", "released"]);
    assert_eq!(events[1]["payload"]["response"]["reason"], "revoked");
    let robot = farhad.json(&["robot", "show", "Turtlebot4"]);
    assert_eq!((&robot["UnderOp"], &robot["owner"]), (&false.into(), &"".into()));
    let grant = farhad.json(&["acquire", "Turtlebot4"]);
    assert_eq!(grant["holder"], "Org1/Farhad");

    salma.run(&["acquire", "Turtlebot4"]).refused(2, &["LGR-2004"]);
    salma.run(&["status"]).refused(2, &["LGR-2004"]);
    let shown = dev.admin().json(&["identity", "show", "Salma"]);
    assert_eq!(shown["certificates"][0]["revoked"], true);
}

#[test]
fn a_holder_that_dies_frees_the_robot_when_block_time_passes_the_lease() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let lost = salma.json(&["acquire", "Turtlebot4", "--for", "1s"]);
    // Salma is never heard of again; nobody sends anything that would move block time.
    eventually("the lease ends by itself", || {
        (farhad.json(&["robot", "show", "Turtlebot4"])["UnderOp"] == false).then_some(())
    });
    let grant = farhad.json(&["acquire", "Turtlebot4"]);
    assert_eq!((&grant["holder"], &grant["epoch"]), (&"Org1/Farhad".into(), &2.into()));
    assert!(grant["time"].as_u64() > lost["expires"].as_u64());
}

#[test]
fn in_open_mode_both_publish_and_everybody_hears_both() {
    let dev = Dev::start();
    let users: Vec<Ctl> = ["Salma", "Farhad"].iter().map(|name| dev.user(name, &["Turtlebot4"], "ed25519")).collect();
    dev.owner().run(&["robot", "set", "Turtlebot4", "mode=open"]).ok();
    let first =
        users[0].publish(&["Turtlebot4/cmd_vel", "--hex", TWIST, "-o", "json"]).ok().json()["height"].to_string();
    users[1].publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).ok();
    let echo = ["echo", "Turtlebot4/cmd_vel", "--from", &first, "--count", "2", "-o", "json"];
    let heard = lines(&users[1].run(&echo).ok().stdout);
    let mut senders: Vec<_> = heard.iter().map(|message| message["sender"].as_str().unwrap()).collect();
    senders.sort_unstable();
    assert_eq!(senders, ["Org1/Farhad", "Org1/Salma"]);
    let stranger = dev.user("Mallory", &[], "ed25519");
    stranger.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).refused(2, &["LGR-3001", "Turtlebot4"]);
}

#[test]
fn a_kept_network_goes_on_where_it_was_even_after_kill_9() {
    let place = tempfile::tempdir().unwrap();
    let data = place.path().join("kept");
    let mut dev = Dev::start_in(tempfile::tempdir().unwrap(), Some(&data));
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let grant = salma.json(&["acquire", "Turtlebot4", "--for", "5m"]);
    let network = dev.fact("network").to_owned();
    dev.process.interrupt();
    assert!(data.is_dir());
    for round in 0..2 {
        let home = std::mem::replace(&mut dev.home, tempfile::tempdir().unwrap());
        dev = Dev::start_in(home, Some(&data));
        assert_eq!(dev.fact("network"), network);
        let robot = dev.owner().json(&["robot", "show", "Turtlebot4"]);
        assert_eq!(robot["owner"], "Org1/Salma", "round {round}");
        let record = dev.owner().json(&["tx", grant["transaction"].as_str().unwrap()]);
        assert_eq!(record["height"], grant["height"]);
        dev.process.kill();
    }
}

#[test]
fn a_network_for_playing_that_cannot_start_leaves_nothing_behind() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let home = tempfile::tempdir().unwrap();
    let started = crate::support::programs::node()
        .args(["dev", "--listen", &taken.local_addr().unwrap().to_string()])
        .env("LEDGERD_HOME", home.path())
        .env("TMPDIR", home.path())
        .output()
        .unwrap();
    assert_eq!(started.status.code(), Some(3));
    assert!(String::from_utf8(started.stderr).unwrap().contains("cannot listen"));
    let left: Vec<_> = std::fs::read_dir(home.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| name == ".dev.lock"), "{left:?}");
}
