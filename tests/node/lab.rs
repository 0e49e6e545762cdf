//! `ledgerd lab`: a network of several nodes for trials, which leaves nothing behind.

use crate::support::{Ctl, Process, eventually, programs};
use serde_json::Value;
use std::path::Path;

/// Is there a process of this number?
fn is_alive(process: &Value) -> bool {
    Path::new(&format!("/proc/{process}/stat")).exists()
}

#[test]
fn a_lab_of_four_organisations_survives_a_lost_node_and_leaves_nothing_behind() {
    let home = tempfile::tempdir().unwrap();
    let place = tempfile::tempdir().unwrap();
    let mut command = programs::node();
    command.args(["lab", "--organisations", "4", "--voters", "4", "--json"]);
    command.env("LEDGERD_HOME", home.path()).env("TMPDIR", place.path());
    let mut lab = Process::start("lab", home.path(), command);
    let facts: Value = serde_json::from_str(&lab.first_line()).unwrap();
    let nodes = facts["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), 4, "{facts}");
    assert!(nodes.iter().all(|node| node["voter"] == true && is_alive(&node["process"])), "{facts}");

    let ctl = Ctl::at(Path::new(facts["home"].as_str().unwrap()));
    let grant = ctl.as_("Salma").json(&["acquire", "Turtlebot4", "--for", "60s"]);
    assert_eq!(grant["holder"], "Org1/Salma", "{grant}");
    ctl.as_("org4-user").run(&["acquire", "Turtlebot4"]).refused(5, &["LGR-3005"]);
    // Its CA issued her certificate before there was a ledger; she is known since her first call.
    eventually("the node of Org2 has executed her call", || {
        (ctl.as_("org2-admin").run(&["can", "Org1/Salma", "acquire", "Turtlebot4"]).code == 0).then_some(())
    });
    ctl.as_("org3-user").run(&["acquire", "Husky"]).ok();
    ctl.as_("org2-admin").run(&["stop", "Turtlebot4"]).ok();
    for context in facts["contexts"].as_array().unwrap() {
        ctl.as_(context.as_str().unwrap()).run(&["whoami"]).ok();
    }

    // One of four voters is lost, as a trial wants it, and the others order without it.
    let lost = nodes[3]["process"].as_i64().unwrap();
    let pid = rustix::process::Pid::from_raw(i32::try_from(lost).unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::KILL).unwrap();
    eventually("the others order without it", || {
        (ctl.as_("org2-admin").run(&["resume", "Turtlebot4", "--reason", "trial"]).code == 0).then_some(())
    });
    ctl.as_("Salma").run(&["acquire", "Turtlebot4"]).ok();

    lab.interrupt();
    assert!(!nodes.iter().any(|node| is_alive(&node["process"])), "{facts}");
    let left =
        |directory: &Path| std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
    assert!(left(place.path()).is_empty(), "{:?}", left(place.path()));
    assert!(!home.path().join("contexts").exists(), "no context is in the home of the user");
}
