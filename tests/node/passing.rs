//! Delegation, confirmation, several robots at once and limits, as people use them: with `ledgerctl` and a real node.

use crate::support::{Ctl, Dev, eventually};
use serde_json::Value;
use std::process::{Child, Stdio};

/// A Twist that stands still.
const TWIST: &str = "00010000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000";

/// `ledgerctl` that runs until something happens.
fn begin(ctl: &Ctl, line: &[&str]) -> Child {
    ctl.command(line).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn a_holder_passes_a_robot_on_by_name_and_takes_it_back_until_a_link_is_revoked() {
    let mut dev = Dev::start();
    let [salma, farhad] = ["Salma", "Farhad"].map(|name| dev.user(name, &["Turtlebot4"], "ed25519"));
    dev.user("Guest", &[], "ed25519");
    salma.run(&["acquire", "Turtlebot4", "--for", "10m"]).ok();
    let refused = salma.run(&["delegate", "Turtlebot4", "--to", "Org1/Farhad"]);
    refused.refused(5, &["LGR-3022", "ledgerctl robot set Turtlebot4/cmd_vel delegable=true"]);
    dev.owner().run(&["robot", "set", "Turtlebot4/cmd_vel", "delegable=true"]).ok();
    salma.run(&["delegate", "Turtlebot4", "--to", "Org1/Guest"]).refused(2, &["LGR-3001", "Org1/Guest"]);
    salma.run(&["delegate", "Turtlebot4", "--to", "Org1/Nobody"]).refused(3, &["LGR-1013", "identity list"]);
    salma.run(&["delegate", "Turtlebot4", "--to", "Org1/Salma"]).refused(3, &["the receiver is the holder"]);

    let told = salma.run(&["delegate", "Turtlebot4", "--to", "Org1/Farhad", "--for", "1h"]).ok().stdout;
    for part in ["Turtlebot4/cmd_vel is now held by Org1/Farhad", "passed on by  Org1/Salma"] {
        assert!(told.contains(part), "{part:?} in {told}");
    }
    salma
        .publish(&["Turtlebot4/cmd_vel", "--hex", TWIST])
        .refused(2, &["LGR-3006", "ledgerctl recall Turtlebot4/cmd_vel"]);
    farhad.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).ok();
    farhad.run(&["delegate", "Turtlebot4", "--to", "Org1/Guest"]).refused(5, &["LGR-3022", "--may-delegate"]);
    let back = salma.json(&["recall", "Turtlebot4"]);
    assert_eq!((&back["holder"], &back["epoch"], &back["follows"]), (&"Org1/Salma".into(), &3.into(), &2.into()));
    salma.run(&["handover", "Turtlebot4", "--to", "Org1/Farhad"]).ok();
    salma.run(&["recall", "Turtlebot4"]).refused(2, &["LGR-3006"]);
    farhad.run(&["delegate", "Turtlebot4", "--to", "Org1/Salma"]).ok();
    dev.admin().run(&["identity", "revoke", "Farhad", "--reason", "left"]).ok();
    let queue = salma.json(&["queue", "Turtlebot4"]);
    assert_eq!(queue["holders"].as_array().unwrap().len(), 0, "{queue}");
    dev.process.check();
    dev.process.interrupt();
}

#[test]
fn a_dangerous_robot_is_acquired_when_others_have_agreed() {
    let mut dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4", "safety"], "ed25519");
    let officer = dev.user("Officer", &["safety"], "ed25519");
    let owner = dev.owner();
    owner
        .run(&["robot", "set", "Turtlebot4/cmd_vel", "confirm=2", "delegable=true"])
        .refused(3, &["confirm and delegable"]);
    owner.run(&["robot", "set", "Turtlebot4/cmd_vel", "confirm=2", "confirm-within=5m"]).ok();
    let asked = salma.run(&["acquire", "Turtlebot4"]);
    assert_eq!(asked.code, 5, "{asked:?}");
    for part in ["waiting for 2 confirmations", "ledgerctl confirm Turtlebot4/cmd_vel Org1/Salma", "admins of Org2"] {
        assert!(asked.stdout.contains(part), "{part:?} in {asked:?}");
    }
    salma.run(&["confirm", "Turtlebot4", "Org1/Salma"]).refused(3, &["cannot confirm itself"]);
    dev.admin().run(&["confirm", "Turtlebot4", "Org1/Salma"]).refused(2, &["LGR-3002", "an admin of Org2"]);
    officer.run(&["confirm", "Turtlebot4", "Org1/Farhad"]).refused(3, &["LGR-1013", "Org1/Salma"]);
    let waits = begin(&salma, &["acquire", "Turtlebot4", "--wait", "5m", "-o", "json"]);
    let first = officer.run(&["confirm", "Turtlebot4", "Org1/Salma"]).ok().stdout;
    assert!(first.contains("Org1/Salma is confirmed by Org1/Officer (1 of 2)"), "{first}");
    let queue = officer.run(&["queue", "Turtlebot4"]).ok().stdout;
    assert!(queue.contains("Org1/Salma waits for confirmations until"), "{queue}");
    let last = owner.run(&["confirm", "Turtlebot4", "Org1/Salma"]).ok().stdout;
    assert!(last.contains("Org1/Salma holds Turtlebot4/cmd_vel with epoch 1"), "{last}");
    let ended = waits.wait_with_output().unwrap();
    let grant: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((ended.status.code(), &grant["holder"]), (Some(0), &"Org1/Salma".into()));
    salma.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).ok();
    dev.process.check();
    dev.process.interrupt();
}

#[test]
fn several_robots_are_acquired_together_and_policies_limit_their_use() {
    let mut dev = Dev::start();
    let [salma, farhad] = ["Salma", "Farhad"].map(|name| dev.user(name, &["Turtlebot4", "Husky"], "ed25519"));
    let owner = dev.owner();
    salma.run(&["acquire", "Turtlebot4", "Husky"]).refused(64, &["--all-or-none"]);
    farhad.run(&["acquire", "Husky", "--for", "10m"]).ok();
    let together = &["acquire", "Turtlebot4", "Husky/cmd_vel", "--all-or-none"];
    salma.run(together).refused(5, &["none of Turtlebot4/cmd_vel, Husky/cmd_vel is granted", "held by Org1/Farhad"]);
    assert_eq!(salma.json(&["queue", "Turtlebot4"])["holders"].as_array().unwrap().len(), 0);
    let waits = begin(
        &salma,
        &["acquire", "Turtlebot4", "Husky", "--all-or-none", "--for", "10m", "--wait", "5m", "-o", "json"],
    );
    farhad.run(&["release", "Husky"]).ok();
    let ended = waits.wait_with_output().unwrap();
    let grants: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!(grants.as_array().unwrap().len(), 2, "{grants}");
    salma.run(&["release", "Husky"]).ok();

    let policy = "@max_linear(\"0.5\") @max_rate(\"20\") permit (principal, action, resource);";
    owner.run(&["policy", "put", "limits", policy]).ok();
    let told = salma.run(&["acquire", "Husky"]).ok().stdout;
    assert!(told.contains("limits   20 Hz, 0.5 m/s"), "{told}");
    let kept = eventually("the grant before it is limited, too", || {
        let queue = salma.json(&["queue", "Turtlebot4"]);
        queue["holders"][0]["limits"].is_object().then(|| queue["holders"][0]["limits"].clone())
    });
    assert_eq!((&kept["max_linear_mm_s"], &kept["max_rate_mhz"]), (&500.into(), &20_000.into()));
    dev.process.check();
    dev.process.interrupt();
}
