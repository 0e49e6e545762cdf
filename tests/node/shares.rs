//! Sharing robots, and a fleet as a file, with `ledgerctl` and a real node.

use crate::support::Dev;
use std::fs;

#[test]
fn an_owner_shares_a_robot_sees_who_may_what_and_takes_it_back() {
    let dev = Dev::start();
    let owner = dev.owner();
    let (guest, officer) = (dev.user("Guest", &["guest"], "ed25519"), dev.user("Officer", &["safety"], "ed25519"));
    guest.run(&["acquire", "Husky"]).refused(2, &["LGR-3001"]);

    // Without a terminal and without --yes nothing happens, and what would happen is shown.
    let asked = owner.run(&["share", "Husky", "--with", "Org1/Guest", "--max-linear", "0.3"]);
    assert!(asked.code != 0 && asked.stderr.contains("--yes"), "{asked:?}");
    for part in [
        "Org1/Guest may acquire, publish on and subscribe to any service of Husky",
        "at most 0.3 m/s",
        "permit (",
        "the built-in policy stays in force",
        "can do afterwards, and could not before:",
    ] {
        assert!(asked.stdout.contains(part), "{part}: {}", asked.stdout);
    }
    guest.run(&["acquire", "Husky"]).refused(2, &["LGR-3001"]);

    owner.run(&["share", "Husky", "--with", "Org1/Guest", "--max-linear", "0.3", "--yes"]).ok();
    let again = owner.run(&["share", "Husky", "--with", "Org1/Guest", "--max-linear", "0.3"]).ok();
    assert!(again.stdout.contains("nothing to change"), "{again:?}");
    let acquired = guest.json(&["acquire", "Husky", "--for", "10m"]);
    assert_eq!(acquired["limits"]["max_linear_mm_s"], 300);
    guest.run(&["take", "Turtlebot4/cmd_vel", "--reason", "mine"]).refused(2, &["LGR-3002"]);
    guest.run(&["resume", "Husky"]).refused(2, &["LGR-3002"]);
    // The first policy of the owner has taken nothing from safety officers.
    officer.run(&["stop", "Turtlebot4"]).ok();
    owner.run(&["resume", "Turtlebot4"]).ok();

    let listed = owner.run(&["share", "list"]).ok();
    assert!(listed.stdout.contains("share-Husky-Org1-Guest") && listed.stdout.contains("0.3 m/s"), "{listed:?}");
    let shown = guest.run(&["share", "show", "Org2/share-Husky-Org1-Guest"]).ok();
    assert!(shown.stdout.contains("principal == User::\"Org1/Guest\""), "{shown:?}");
    let matrix = owner.run(&["can", "--matrix"]).ok();
    for part in ["Org1/Guest", "Org1/Officer", "confirm", "override", "resume", "0.3 m/s"] {
        assert!(matrix.stdout.contains(part), "{part}: {}", matrix.stdout);
    }
    let of_guest = owner.run(&["can", "--as", "Org1/Guest"]).ok();
    assert!(of_guest.stdout.contains("Husky/cmd_vel") && !of_guest.stdout.contains("Officer"), "{of_guest:?}");

    // A name that is unknown, an attribute that does not count.
    owner.run(&["share", "Husky", "--with", "Org1/Guset", "--yes"]).refused(3, &["Org1/Guset", "--expect"]);
    owner.run(&["share", "Husky", "--with", "Org1/Guset", "--yes", "--expect", "Org1/Guset"]).ok();
    owner.run(&["robot", "set", "Husky", "trust=Org2"]).ok();
    owner
        .run(&["share", "Husky", "--with", "Org1", "--attr", "guest", "--yes"])
        .refused(3, &["does not trust Org1", "ledgerctl robot set Husky trust=Org2,Org1"]);

    owner.run(&["unshare", "Husky", "--with", "Org1/Guset", "--yes"]).ok();
    let ended = owner.run(&["unshare", "share-Husky-Org1-Guest", "--yes"]).ok();
    for part in ["could do before, and cannot afterwards:", "it ends the grant of Husky/cmd_vel by Org1/Guest"] {
        assert!(ended.stdout.contains(part), "{part}: {}", ended.stdout);
    }
    guest.run(&["acquire", "Husky"]).refused(2, &["LGR-3002", "ledgerctl share Husky --with Org1/Guest"]);
}

#[test]
fn a_fleet_is_a_file_that_changes_nothing_when_it_is_applied_again() {
    let dev = Dev::start();
    let (owner, salma) = (dev.owner(), dev.user("Salma", &["Husky"], "ed25519"));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("fleet.toml");
    let file = path.to_str().unwrap();
    owner.run(&["share", "Turtlebot4", "--with", "Org1", "--hours", "08:00-18:00 Z", "--yes"]).ok();
    salma.run(&["acquire", "Husky", "--for", "10m"]).ok();

    let exported = owner.run(&["export"]).ok().stdout;
    fs::write(&path, &exported).unwrap();
    for prune in [&[][..], &["--prune"]] {
        let diff = owner.run(&[&["diff", file], prune].concat()).ok();
        assert!(diff.stdout.contains("nothing to change"), "{exported}: {diff:?}");
    }

    // Trust goes, a share comes, a robot comes: no holder who may continue is stopped in between.
    let text =
        exported.replace("[robot.Husky.service", "[robot.Husky.attributes]\nkind = \"rover\"\n\n[robot.Husky.service");
    let more = "\n[[share]]\nresource = \"Husky\"\nwith = \"Org1/Salma\"\n\n[robot.Spot]\nattr-required = \"Spot\"\n\
                [robot.Spot.service.\"/cmd_vel\"]\ntype = \"geometry_msgs/msg/Twist\"\nlease = \"20s\"\n";
    fs::write(&path, text + more).unwrap();
    let asked = owner.run(&["apply", file]);
    assert!(asked.code != 0 && asked.stderr.contains("--yes"), "{asked:?}");
    for part in ["robot Spot is new", "attribute kind", "share-Husky-Org1-Salma"] {
        assert!(asked.stdout.contains(part), "{part}: {}", asked.stdout);
    }
    owner.run(&["apply", file, "--yes", "-m", "spring"]).ok();
    assert!(owner.run(&["apply", file]).ok().stdout.contains("nothing to change"));
    let spot = owner.json(&["robot", "show", "Spot"]);
    assert_eq!((&spot["trusted"], &spot["services"][0]["lease_ms"]), (&serde_json::json!(["Org2"]), &20_000.into()));
    assert_eq!(owner.json(&["robot", "show", "Husky"])["services"][0]["holder"], "Org1/Salma");

    // Pruned to what was there before.
    fs::write(&path, &exported).unwrap();
    let pruned = owner.run(&["apply", file, "--prune", "--yes"]).ok();
    assert!(pruned.stdout.contains("robot Spot is removed"), "{pruned:?}");
    assert_eq!(owner.run(&["export"]).ok().stdout, exported);
    salma.run(&["apply", file, "--prune", "--yes"]).refused(2, &[]);
}

#[test]
fn a_robot_and_its_identity_are_registered_in_one_step_and_a_name_in_another_case_is_rejected() {
    let dev = Dev::start();
    let owner = dev.owner();
    let spot = ["robot", "add", "Spot", "--attr-required", "Spot", "--service", "/cmd_vel=geometry_msgs/msg/Twist"];
    owner
        .run(&["identity", "register", "husky", "--role", "robot"])
        .refused(3, &["robot Husky", "upper and lower case"]);
    owner.run(&[&["robot", "add", "husky"], &spot[3..]].concat()).refused(3, &["robot Husky", "upper and lower case"]);
    let added = owner.run(&[&spot[..], &["--enrol"]].concat()).ok();
    assert!(
        added.stdout.contains("registered Org2/Spot") && added.stdout.contains("ledgerctl enroll Spot --node"),
        "{added:?}"
    );
    assert_eq!(owner.json(&["robot", "show", "Spot"])["trusted"], serde_json::json!(["Org2"]));
    // Revoked before it has done anything, the name is free again.
    owner.run(&["identity", "revoke", "Spot"]).ok();
    owner.run(&["identity", "register", "Spot", "--role", "robot"]).ok();
}
