//! Four machines and a router between them, in network namespaces: each node has a network of its own, and the test,
//! with its clients, is the router. A bridge would do for whole machines, but only a router can lose packets in one
//! direction between two of them. A rule for source and destination drops them without a word.
//!
//! Only for tests that are [`isolated`](crate::own_network::isolated): the rules end with their namespace.

use crate::cluster::{Cluster, NODES};
use crate::support::{Process, eventually};
use std::path::Path;
use std::process::Command;

/// The port of every node; each has an address of its own.
const PORT: u16 = 7450;

/// The namespaces.
pub struct Site {
    /// One process in each; a namespace ends with its process.
    machines: Vec<Process>,
    /// Directed pairs that are cut.
    cut: Vec<(usize, usize)>,
}

impl Site {
    /// Builds the network and a cluster on it; nothing runs yet.
    pub fn build() -> (Self, Cluster) {
        let mut addresses = 0;
        let mut cluster = Cluster::found_at([(); NODES].map(|()| {
            addresses += 1;
            format!("{}:{PORT}", address(addresses - 1))
        }));
        std::fs::write("/proc/sys/net/ipv4/ip_forward", "1").expect("the router may forward");
        let machines: Vec<_> = (0..NODES).map(|node| machine(node, cluster.fleet.path())).collect();
        for (node, machine) in machines.iter().enumerate() {
            let machine = machine.id().to_string();
            let enter = Box::new(move |command: Command| enter(&machine, &command));
            cluster.surround(node, enter);
        }
        (Self { machines, cut: Vec::new() }, cluster)
    }

    /// From now on, nothing from one node reaches the other.
    pub fn cut(&mut self, from: usize, to: usize) {
        if !self.cut.contains(&(from, to)) {
            ip(&["rule", "add", "from", &address(from), "to", &address(to), "blackhole"]);
            self.cut.push((from, to));
        }
    }

    /// From now on, these nodes and the others do not reach each other. Clients reach them all.
    pub fn part(&mut self, nodes: &[usize]) {
        for node in nodes {
            for other in (0..NODES).filter(|other| !nodes.contains(other)) {
                self.cut(*node, other);
                self.cut(other, *node);
            }
        }
    }

    /// Everything arrives again.
    pub fn heal(&mut self) {
        for (from, to) in self.cut.drain(..) {
            ip(&["rule", "del", "from", &address(from), "to", &address(to), "blackhole"]);
        }
        for machine in &mut self.machines {
            machine.check();
        }
    }
}

/// The address of a node.
pub fn address(node: usize) -> String {
    format!("10.77.{}.1", node + 1)
}

/// A namespace with a link to the router.
pub fn machine(node: usize, logs: &Path) -> Process {
    let name = format!("machine{}", node + 1);
    let mut command = Command::new("unshare");
    command.args(["-n", "sh", "-c", "echo ready && exec sleep 3600"]);
    let mut machine = Process::start(&name, logs, command);
    eventually("a machine is there", || {
        machine.check();
        machine.stdout().contains("ready").then_some(())
    });
    let inside = machine.id().to_string();
    let (router, own) = (format!("10.77.{}.254", node + 1), address(node));
    ip(&["link", "add", &name, "type", "veth", "peer", "name", "uplink", "netns", &inside]);
    ip(&["address", "add", &format!("{router}/24"), "dev", &name]);
    ip(&["link", "set", &name, "up"]);
    let within = |words: &[&str]| {
        let mut command = Command::new("ip");
        command.args(words);
        run(enter(&inside, &command));
    };
    within(&["link", "set", "lo", "up"]);
    within(&["address", "add", &format!("{own}/24"), "dev", "uplink"]);
    within(&["link", "set", "uplink", "up"]);
    within(&["route", "add", "default", "via", &router]);
    machine
}

/// The command, in the network of that process.
fn enter(process: &str, command: &Command) -> Command {
    let mut entered = Command::new("nsenter");
    entered.args(["-t", process, "-n", "--"]).arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => entered.env(name, value),
            None => entered.env_remove(name),
        };
    }
    entered
}

fn ip(words: &[&str]) {
    let mut command = Command::new("ip");
    command.args(words);
    run(command);
}

fn run(mut command: Command) {
    let done = command.output().expect("ip of iproute2, nsenter of util-linux");
    assert!(done.status.success(), "{command:?}: {}", String::from_utf8_lossy(&done.stderr));
}
