//! The example network of two organisations on three machines, run as it stands: each machine is a network namespace.

use crate::own_network::isolated;
use crate::site;
use crate::support::{Process, programs};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use tempfile::TempDir;

const MACHINES: usize = 3;

/// Runs a line of shell at a machine, as ssh does: in its network and its directory.
const ON: &str = r#"#!/bin/sh
cd "$DIRECTORY/$1" && exec nsenter -t "$(cat process)" -n -- sh -c "$2"
"#;
/// Starts the node of a machine, as systemd does.
const START: &str = "setsid ledgerd run --config ledgerd.toml >log 2>&1 </dev/null & echo $! >pid";

#[test]
fn the_example_of_two_organisations_on_three_machines_runs_as_it_stands() {
    if !isolated(&|| ()) {
        return;
    }
    let directory = TempDir::new().unwrap();
    let machines: Vec<Process> = (0..MACHINES).map(|machine| site::machine(machine, directory.path())).collect();
    fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap();
    let mut environment = "CONFIG=ledgerd.toml\n".to_owned();
    for (number, (machine, name)) in machines.iter().zip(["FACTORY1", "FACTORY2", "CARRIER"]).enumerate() {
        let address = site::address(number);
        let place = directory.path().join(&address);
        fs::create_dir(&place).unwrap();
        fs::write(place.join("process"), machine.id().to_string()).unwrap();
        environment += &format!("{name}={address}\n");
    }
    let [on, settings] = ["on", "machines.env"].map(|name| directory.path().join(name));
    fs::write(&settings, environment).unwrap();
    fs::write(&on, ON).unwrap();
    fs::set_permissions(&on, Permissions::from_mode(0o755)).unwrap();
    let programs = programs::ledgerctl().parent().unwrap().display().to_string();
    let mut command = Command::new(programs::repository().join("examples/networks/two-organisations/up"));
    command.env("MACHINES", &settings).env("ON", &on).env("START", START).env("DIRECTORY", directory.path());
    command.env("LEDGERD_HOME", directory.path().join("home")).env_remove("LEDGERCTL_CONTEXT").env_remove("RUST_LOG");
    command.env("PATH", format!("{programs}:{}", std::env::var("PATH").unwrap()));
    let ran = command.output().unwrap();
    let told = String::from_utf8_lossy(&ran.stdout).into_owned();
    let nodes = (0..MACHINES).map(|number| directory.path().join(site::address(number)));
    let logs: Vec<_> = nodes.clone().map(|node| fs::read_to_string(node.join("log")).unwrap_or_default()).collect();
    for pid in nodes.filter_map(|node| fs::read_to_string(node.join("pid")).ok()) {
        Command::new("kill").arg(pid.trim()).status().unwrap();
    }
    assert!(ran.status.success(), "{told}\n{}\n{}", String::from_utf8_lossy(&ran.stderr), logs.join("\n"));
    assert!(told.contains("Turtlebot4/cmd_vel is acquired (exclusive)") && told.contains("3 of 3"), "{told}");
}
