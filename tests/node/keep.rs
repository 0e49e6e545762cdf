//! `ledgerctl acquire --keep` with real nodes, and the words about leases.

use crate::support::network::register_robots;
use crate::support::process::Process;
use crate::support::{Ctl, Dev, Fleet, connect, eventually};
use ledger_identity::Role;
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;

const SERVICE: &str = "Turtlebot4/cmd_vel";

/// Starts a command that keeps grants.
fn keep(ctl: &Ctl, logs: &Path, name: &str, line: &[&str]) -> Process {
    let mut kept = Process::start(name, logs, ctl.command(&[&["acquire", "--keep"], line].concat()));
    kept.first_line();
    kept
}

/// When the grant ends, if somebody holds it.
fn expires(ctl: &Ctl, service: &str) -> Option<u64> {
    let ran = ctl.run(&["queue", service, "-o", "json"]);
    if ran.code != 0 {
        return None;
    }
    let line: Value = ran.json();
    line["holders"][0]["expires"].as_u64()
}

/// It has ended with this exit code, and these words on standard error.
#[track_caller]
fn ended(kept: &mut Process, code: i32, words: &[&str]) {
    let status = kept.wait();
    assert_eq!(status.code(), Some(code), "{}", kept.stderr());
    for word in words {
        assert!(kept.stderr().contains(word), "{word:?} is missing in: {}", kept.stderr());
    }
    kept.no_panic();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grant_is_renewed_over_a_restart_of_the_node_until_ctrl_c_releases_it() {
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let mut node = fleet.nodes[0].start();
    register_robots(&connect(&owner).await, "exclusive").await;
    let ctl = fleet.ctl().as_(&salma.name);
    let mut kept = keep(&ctl, fleet.path(), "kept", &[SERVICE, "--for", "15s"]);
    let shown = kept.stdout();
    assert!(shown.contains("15 s after each message or renewal, at most 10 min"), "{shown}");
    let first = expires(&ctl, SERVICE).unwrap();
    let later = |than: u64| eventually("the grant is renewed", || expires(&ctl, SERVICE).filter(|end| *end > than));
    let second = later(first);
    node.kill();
    node = fleet.nodes[0].start();
    let third = later(second);
    later(third);
    kept.check();
    kept.interrupt();
    assert!(kept.stderr().contains("Turtlebot4/cmd_vel: released"), "{}", kept.stderr());
    assert_eq!(expires(&ctl, SERVICE), None, "nobody holds it");
    node.interrupt();
}

#[test]
fn the_end_of_a_kept_grant_has_its_reason_and_an_exit_code_of_its_kind() {
    let mut dev = Dev::start();
    let logs = tempfile::tempdir().unwrap();
    let (salma, owner) = (dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519"), dev.owner());

    let mut kept = keep(&salma, logs.path(), "stopped", &[SERVICE]);
    let stopped = owner.run(&["stop", "Turtlebot4"]).ok().stdout;
    assert!(stopped.contains("the holders must acquire again after `ledgerctl resume`"), "{stopped}");
    ended(&mut kept, 5, &["the robot was stopped", "[LGR-3020]", "once it is resumed: ledgerctl acquire"]);
    let resumed = owner.run(&["resume", "Turtlebot4"]).ok().stdout;
    assert!(resumed.contains("grants that the stop ended are not restored"), "{resumed}");

    let mut kept = keep(&salma, logs.path(), "taken", &[SERVICE]);
    owner.run(&["take", SERVICE, "--reason", "test"]).ok();
    ended(&mut kept, 2, &["overridden by Org2/Admin in an emergency", "[LGR-3006]"]);
    owner.run(&["release", SERVICE]).ok();

    // Of several grants that are kept together, the loss of one ends the other.
    let both = ["Turtlebot4", "Husky", "--all-or-none"];
    let mut kept = keep(&salma, logs.path(), "together", &both);
    owner.run(&["release", SERVICE, "--holder", "Org1/Salma"]).ok();
    ended(&mut kept, 2, &["Turtlebot4/cmd_vel is no longer held: its owner revoked the grant"]);
    assert_eq!(expires(&salma, "Husky/cmd_vel"), None);

    let mut kept = keep(&salma, logs.path(), "terminated", &["Husky", "--for", "5m"]);
    assert!(kept.signal(Signal::TERM).success(), "{}", kept.stderr());
    assert_eq!(expires(&salma, "Husky/cmd_vel"), None);

    let mut kept = keep(&salma, logs.path(), "alone", &["Husky", "--for", "2s"]);
    dev.process.kill();
    ended(&mut kept, 4, &["no node has renewed the grant within its lease", "[LGR-4001]"]);
}

#[test]
fn a_grant_says_how_long_it_may_be_and_a_longer_one_is_rejected_with_the_way_to_it() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let shown = salma.run(&["acquire", "Turtlebot4"]).ok().stdout;
    for part in [
        "10 s after each message or renewal, at most 10 min",
        "ledgerctl renew Turtlebot4/cmd_vel --for 10m, or ledgerctl acquire Turtlebot4/cmd_vel --keep",
    ] {
        assert!(shown.contains(part), "{part:?} in {shown}");
    }
    let longer = ["--keep", "an admin of Org2", "ledgerctl robot set Turtlebot4/cmd_vel lease-max="];
    salma.run(&["renew", "Turtlebot4", "--for", "1h"]).refused(3, &longer);
    dev.owner().run(&["robot", "set", SERVICE, "lease-max=2h"]).ok();
    let renewed = salma.json(&["renew", "Turtlebot4", "--for", "1h"]);
    assert_eq!((&renewed["lease_ms"], &renewed["lease_ms_max"]), (&3_600_000.into(), &7_200_000.into()));
    // Shorter than any lease: there is no longer one to ask for.
    let shorter = salma.run(&["renew", "Turtlebot4", "--for", "10ms"]);
    assert!(shorter.code == 3 && !shorter.stderr.contains("lease-max"), "{shorter:?}");
}
