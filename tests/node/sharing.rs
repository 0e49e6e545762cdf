//! Lines, preemption and the emergency stop, as people use them: with `ledgerctl` and a real node.

use crate::support::{Ctl, Dev, eventually};
use serde_json::Value;
use std::fs::File;
use std::process::{Child, Output, Stdio};

/// A Twist that stands still.
const TWIST: &str = "00010000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000";

/// `ledgerctl` that runs until something happens.
fn begin(ctl: &Ctl, line: &[&str]) -> Child {
    ctl.command(line).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn ended(child: Child) -> (i32, String, String) {
    let Output { status, stdout, stderr } = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (status.code().unwrap(), text(stdout), text(stderr))
}

fn contenders(ctl: &Ctl) -> Vec<String> {
    let state = ctl.json(&["queue", "Turtlebot4"]);
    state["line"].as_array().unwrap().iter().map(|place| place["contender"].as_str().unwrap().to_owned()).collect()
}

fn interrupt(child: &Child) {
    let pid = rustix::process::Pid::from_child(child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
}

#[test]
fn people_wait_in_line_until_the_service_is_theirs_or_until_they_leave() {
    let mut dev = Dev::start();
    let [salma, farhad, maria] = ["Salma", "Farhad", "Maria"].map(|name| dev.user(name, &["Turtlebot4"], "ed25519"));
    dev.owner().run(&["robot", "set", "Turtlebot4/cmd_vel", "on_conflict=queue", "queue-max=2"]).ok();
    salma.run(&["acquire", "Turtlebot4", "--for", "10m"]).ok();

    // Without --wait the place is told, and the exit code says that others hold the service.
    let joined = maria.run(&["acquire", "Turtlebot4", "--for", "5s"]);
    assert_eq!(joined.code, 5, "{joined:?}");
    for part in ["Turtlebot4/cmd_vel is held by others: you are in the queue", "position  1", "ledgerctl release"] {
        assert!(joined.stdout.contains(part), "{part:?} in {joined:?}");
    }
    maria.run(&["release", "Turtlebot4"]).ok();
    maria.run(&["acquire", "Turtlebot4", "--no-wait"]).refused(5, &["LGR-3005", "held by Org1/Salma"]);

    let farhad_waits = begin(&farhad, &["acquire", "Turtlebot4", "--for", "10m", "--wait", "5m", "-o", "json"]);
    eventually("Farhad is in line", || (contenders(&salma) == ["Org1/Farhad"]).then_some(()));
    let maria_waits = begin(&maria, &["acquire", "Turtlebot4", "--wait", "5m"]);
    eventually("Maria is behind him", || (contenders(&salma) == ["Org1/Farhad", "Org1/Maria"]).then_some(()));
    let shown = salma.run(&["queue", "Turtlebot4"]).ok().stdout;
    assert!(shown.contains("held by Org1/Salma") && shown.contains("1         Org1/Farhad"), "{shown}");
    let listed = salma.run(&["robot", "list"]).ok().stdout;
    assert!(listed.contains("WAITING"), "{listed}");
    let nobody = dev.admin();
    nobody.run(&["acquire", "Turtlebot4"]).refused(2, &["LGR-300"]);

    // Ctrl-C leaves the line.
    interrupt(&maria_waits);
    let (code, _, stderr) = ended(maria_waits);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("you left the queue of Turtlebot4/cmd_vel"), "{stderr}");
    assert_eq!(contenders(&salma), ["Org1/Farhad"]);

    // A release gives it to whoever is next.
    salma.run(&["release", "Turtlebot4"]).ok();
    let (code, stdout, stderr) = ended(farhad_waits);
    assert_eq!(code, 0, "{stderr}");
    let grant: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((&grant["holder"], &grant["epoch"]), (&"Org1/Farhad".into(), &2.into()));
    farhad.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).ok();

    // Who waits in vain hears it.
    let vain = begin(&salma, &["acquire", "Turtlebot4", "--wait", "1s"]);
    let (code, _, stderr) = ended(vain);
    assert_eq!(code, 5, "{stderr}");
    assert!(stderr.contains("others held it for your whole waiting time") && stderr.contains("timed_out"), "{stderr}");
    dev.process.check();
    dev.process.interrupt();
}

#[test]
fn a_higher_priority_takes_the_place_and_the_owner_stops_resumes_and_takes() {
    let mut dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let doctor = dev.user("Doctor", &["Turtlebot4", "rank=7"], "p256");
    let owner = dev.owner();
    owner.run(&["robot", "set", "Turtlebot4/cmd_vel", "on-conflict=preempt", "priority=attribute:rank"]).ok();
    owner.run(&["robot", "set", "Turtlebot4/cmd_vel", "aging=1s"]).refused(3, &["no queue-max and aging"]);
    salma.run(&["acquire", "Turtlebot4", "--for", "10m"]).ok();
    let grant = doctor.json(&["acquire", "Turtlebot4", "--for", "10m"]);
    assert_eq!((&grant["holder"], &grant["epoch"]), (&"Org1/Doctor".into(), &2.into()));
    salma.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).refused(2, &["LGR-300"]);
    salma.run(&["acquire", "Turtlebot4"]).refused(5, &["LGR-3005", "Org1/Doctor"]);

    salma.run(&["stop", "Turtlebot4"]).refused(2, &["LGR-3002", "an admin of Org2"]);
    let stopped = owner.json(&["stop", "Turtlebot4", "--reason", "person in the cell"]);
    assert_eq!((&stopped["robots"][0], &stopped["ended"][0]["reason"]), (&"Turtlebot4".into(), &"stopped".into()));
    doctor.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).refused(5, &["LGR-3020", "person in the cell"]);
    doctor.run(&["acquire", "Turtlebot4"]).refused(5, &["LGR-3020", "Org2/Admin", "ledgerctl resume Turtlebot4"]);
    assert!(salma.run(&["robot", "list"]).ok().stdout.contains("stopped by Org2/Admin"));
    doctor.run(&["resume", "Turtlebot4"]).refused(2, &["LGR-3002"]);
    owner.run(&["resume", "--all"]).ok();
    doctor.run(&["acquire", "Turtlebot4"]).ok();
    let taken = owner.json(&["take", "Turtlebot4", "--reason", "it turns in circles"]);
    assert_eq!(taken["taken"], "it turns in circles");
    doctor.run(&["acquire", "Turtlebot4"]).refused(5, &["LGR-3005", "Org2/Admin"]);
    dev.process.check();
    dev.process.interrupt();
}

#[test]
fn one_more_reader_than_the_owner_allows_waits_until_a_place_is_free() {
    let mut dev = Dev::start();
    let [salma, farhad, maria] = ["Salma", "Farhad", "Maria"].map(|name| dev.user(name, &["Turtlebot4"], "ed25519"));
    let settings = ["mode=limited", "publishers=1", "subscribers=1", "on-conflict=queue", "lease=15s"];
    dev.owner().run(&[&["robot", "set", "Turtlebot4/cmd_vel"][..], &settings[..]].concat()).ok();
    salma.run(&["acquire", "Turtlebot4", "--for", "5m"]).ok();
    let readers = |names: &str| {
        let listed = salma.run(&["robot", "list"]).ok().stdout;
        let row = listed.lines().find(|line| line.starts_with("Turtlebot4/cmd_vel:subscribe")).unwrap().to_owned();
        row.ends_with(names).then_some(())
    };
    eventually("nobody reads", || readers(" -"));

    let file = dev.home.path().join("maria.txt");
    let mut maria_reads = maria.command(&["echo", "Turtlebot4/cmd_vel", "--hex"]);
    maria_reads.stdin(Stdio::null()).stdout(File::create(&file).unwrap()).stderr(Stdio::piped());
    let maria_reads = maria_reads.spawn().unwrap();
    eventually("Maria has the place", || readers("Org1/Maria"));
    let farhad_reads = begin(&farhad, &["echo", "Turtlebot4/cmd_vel", "--hex", "--count", "1"]);
    let waits = || {
        let state = salma.json(&["queue", "Turtlebot4/cmd_vel:subscribe"]);
        (state["line"][0]["contender"] == "Org1/Farhad").then_some(())
    };
    eventually("Farhad waits", waits);
    // A second is five messages, and the lease fifteen seconds. A busy node refuses a command, and the rest is not sent.
    eventually("she keeps her place for longer than its lease", || {
        salma.run(&["publish", "Turtlebot4/cmd_vel", "--hex", TWIST, "--rate", "5", "--count", "90"]);
        (std::fs::read_to_string(&file).unwrap().lines().count() > 80).then_some(())
    });
    interrupt(&maria_reads);
    let (code, _, stderr) = ended(maria_reads);
    assert_eq!(code, 0, "{stderr}");

    // Her place is free at once.
    eventually("Farhad has the place", || readers("Org1/Farhad"));
    salma.run(&["acquire", "Turtlebot4", "--for", "5m"]).ok();
    salma.publish(&["Turtlebot4/cmd_vel", "--hex", TWIST]).ok();
    let (code, stdout, stderr) = ended(farhad_reads);
    assert_eq!((code, stdout.lines().count()), (0, 1), "{stderr}");
    eventually("nobody reads any more", || readers(" -"));
    farhad
        .run(&["publish", "Turtlebot4/cmd_vel:subscribe", "--hex", TWIST])
        .refused(3, &["publish on Turtlebot4/cmd_vel"]);
    dev.process.check();
    dev.process.interrupt();
}
