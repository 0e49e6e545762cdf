//! The findings of `ledgerctl doctor` on a machine without a node. Each finding is provoked. tests/node/doctor.rs provokes the others.

use crate::machine::{Machine, closed_address, transcript};
use serde_json::Value;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};

/// The findings of a run with these variables.
fn findings(machine: &Machine, arguments: &[&str], variables: &[(&str, &str)]) -> Vec<Value> {
    let mut command = machine.command(&[&["doctor", "--json"][..], arguments].concat());
    command.envs(variables.iter().copied());
    told(&mut command)
}

fn told(command: &mut Command) -> Vec<Value> {
    let said = transcript(&command.output().unwrap());
    let report: Value = serde_json::from_str(&said.stdout).unwrap_or_else(|error| panic!("{error}: {said:?}"));
    let findings = report["findings"].as_array().unwrap().clone();
    let wrong = findings.iter().filter(|finding| finding["state"] == "wrong").count();
    assert_eq!((report["ok"] == true, said.code), (wrong == 0, i32::from(wrong > 0)), "{said:?}");
    for finding in &findings {
        assert_eq!(finding["try"] == "", finding["state"] == "ok", "only what is ok has no repair: {finding}");
    }
    findings
}

/// The finding about this has that state, these words, and that repair.
#[track_caller]
fn found(findings: &[Value], check: &str, state: &str, words: &str, repair: &str) {
    let is_it = |finding: &&Value| {
        finding["check"] == check
            && finding["state"] == state
            && finding["message"].as_str().unwrap().contains(words)
            && finding["try"].as_str().unwrap().contains(repair)
    };
    assert!(findings.iter().any(|finding| is_it(&finding)), "{check} {state} {words:?} {repair:?} in {findings:#?}");
}

#[test]
fn without_a_context_the_way_to_one_is_told() {
    found(&findings(&Machine::new(), &[], &[]), "context", "wrong", "no context is selected", "ledgerctl enroll");
}

#[test]
fn a_port_where_nobody_listens_is_wrong_and_what_lies_behind_it_unknown() {
    let (machine, address) = (Machine::new(), closed_address());
    machine.enrolled("Salma", &address);
    let findings = findings(&machine, &[], &[]);
    found(&findings, "context", "ok", "Salma is Org1/Salma of network fleet", "");
    found(&findings, "port", "wrong", &address, "start the node there");
    found(&findings, "node", "wrong", "LGR-4001", "");
    found(&findings, "peers", "unknown", "no node answers", "");
}

#[test]
fn a_name_without_an_address_is_told_from_a_closed_port() {
    let machine = Machine::new();
    // No name at all: no server of names is asked, which may take long to say no.
    machine.enrolled("Salma", "nowhere..invalid:7450");
    found(&findings(&machine, &[], &[]), "port", "wrong", "nowhere..invalid", "getent hosts");
}

#[test]
fn a_certificate_that_has_ended_is_wrong_with_the_way_back() {
    let machine = Machine::new();
    machine.enrolled_until("Salma", &closed_address(), 1999);
    found(&findings(&machine, &[], &[]), "certificate", "wrong", "ended", "ledgerctl");
}

#[test]
fn a_key_that_others_can_read_is_wrong() {
    let machine = Machine::new();
    machine.enrolled("Salma", &closed_address());
    let key = machine.home.path().join("contexts/Salma/key.pem");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
    found(&findings(&machine, &[], &[]), "context", "wrong", "other users can read", "chmod 600");
}

#[test]
fn variables_of_ros_that_a_bridge_cannot_follow_are_wrong() {
    let machine = Machine::new();
    for (variable, value, check, repair) in [
        ("ROS_DOMAIN_ID", "seven", "DDS domain", "domain_id"),
        ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp", "DDS domain", "rmw_fastrtps_cpp"),
        ("ROS_DISCOVERY_SERVER", "10.0.0.1:11811", "DDS domain", "ROS_STATIC_PEERS"),
        ("FASTDDS_BUILTIN_TRANSPORTS", "SHM", "DDS domain", "UDPv4"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "DDS interfaces", "discovery_range"),
        ("ROS_STATIC_PEERS", "two words", "DDS interfaces", "static_peers"),
        ("ROS_SECURITY_ENABLE", "true", "DDS interfaces", "ROS_SECURITY_ENABLE=false"),
    ] {
        found(&findings(&machine, &[], &[(variable, value)]), check, "wrong", variable, repair);
    }
    let findings = findings(&machine, &[], &[("ROS_DOMAIN_ID", "7")]);
    found(&findings, "DDS domain", "ok", "domain 7, by ROS_DOMAIN_ID: UDP ports 9150 to 9399", "");
}

#[test]
fn settings_of_a_bridge_are_looked_at_with_every_fault() {
    let machine = Machine::new();
    let config = machine.home.path().join("bridge.toml");
    let at = config.to_string_lossy().into_owned();
    fs::write(&config, "domain_id = 400\nnode_nam = 'x'\n[log]\nlevel = 'info'\n").unwrap();
    let faults = findings(&machine, &["--config", &at], &[]);
    found(&faults, "bridge", "wrong", "domain_id", "");
    found(&faults, "bridge", "wrong", "node_nam", "");
    let route = "[[route]]\nservice = 'T/cmd_vel'\ndirection = 'to_ledger'\ntype = 'geometry_msgs/msg/Twist'\n";
    fs::write(&config, format!("domain_id = 3\ninterfaces = '192.0.2.77'\n{route}")).unwrap();
    let findings = findings(&machine, &["--config", &at], &[]);
    found(&findings, "DDS domain", "ok", "domain 3, by domain_id", "");
    found(&findings, "DDS interfaces", "wrong", "no interface has 192.0.2.77", "ip -4 address");
}

/// Runs a line of shell in namespaces of its own, with the program as its first argument.
fn apart(machine: &Machine, spaces: &str, line: &str) -> Vec<Value> {
    let is_root = Command::new("unshare").args([spaces, "true"]).stderr(Stdio::null()).status().unwrap().success();
    let flags = if is_root { spaces.to_owned() } else { spaces.replace('-', "-r") };
    let program = testkit::program("ledgerctl");
    let program = program.to_str().unwrap();
    let mut command = Command::new("unshare");
    command.args([&flags, "sh", "-c", line, program]);
    command.env("LEDGERD_HOME", machine.home.path()).env_remove("LEDGERCTL_CONTEXT").env_remove("ROS_DOMAIN_ID");
    told(&mut command)
}

#[test]
fn without_an_interface_there_is_neither_dds_nor_multicast() {
    let findings = apart(&Machine::new(), "-n", "exec \"$0\" doctor --json");
    found(&findings, "DDS interfaces", "wrong", "over none", "ip link set lo up");
    found(&findings, "multicast", "wrong", "not received", "multicast on");
}

#[test]
fn a_bridge_for_other_hosts_is_told_that_there_is_no_way_to_them() {
    let line = "ip link set lo up && ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET exec \"$0\" doctor --json";
    let findings = apart(&Machine::new(), "-n", line);
    found(&findings, "DDS interfaces", "wrong", "over lo 127.0.0.1", "connect this machine");
}

#[test]
fn a_full_disk_of_the_contexts_is_wrong() {
    let line = "mount -t tmpfs -o size=64k none \"$LEDGERD_HOME\" && exec \"$0\" doctor --json";
    let findings = apart(&Machine::new(), "-m", line);
    found(&findings, "own disk", "wrong", "free for contexts", "free disk space");
}
