//! The figures of a node: docs/metrics.md describes each.

use crate::clients::attention::CHECKS;
use crate::clients::monitoring::figures::{Labels, Several, bytes, counts, number, numbers, seconds, seconds_in_all};
use crate::process::meters::Meters;
use ledger_api::facts::{CRITICAL, ERROR, WARNING};
use ledger_api::v1::StatusResponse;
use ledger_base::rejection::Code;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};
use std::collections::BTreeMap;
use std::time::Duration;

const MICROS: f64 = 1_000_000.0;
/// Severities in the order of their figures.
const SEVERITIES: [&str; 4] = ["", WARNING, ERROR, CRITICAL];

/// Registers the figures of a node, which has kept the processors awake for so long.
pub(super) fn register(registry: &mut Registry, status: &StatusResponse, meters: &Meters, awake: Duration) {
    about(registry, status);
    chain(registry, status);
    order(registry, status);
    calls(registry, status);
    machine(registry, status);
    attention(registry, status);
    seconds_in_all(registry, "awake", "Time during which the node kept the processors awake", awake);
    let mut steps = |name: &str, help: &str, histogram: &Histogram| {
        registry.register_with_unit(name, help, Unit::Seconds, histogram.clone());
    };
    steps("gateway", "From a transaction's arrival at this node until it is handed to ordering", &meters.gateway);
    steps("commit", "From a transaction's arrival at this node to its verdict from a block", &meters.commit);
    steps("flush", "One flush of the log to the disk", &meters.flush);
    steps("execute", "Executing a group of blocks", &meters.execute);
}

fn about(registry: &mut Registry, status: &StatusResponse) {
    let StatusResponse { version, node_name, organisation, network_label, .. } = status;
    let facts: Labels = vec![
        ("version", version.clone()),
        ("node", node_name.clone()),
        ("organisation", organisation.clone()),
        ("network", network_label.clone()),
    ];
    registry.register("node", "This node", Info::new(facts));
    seconds(registry, "uptime", "Time since the node started", status.uptime_ms as f64 / 1000.0);
}

fn chain(registry: &mut Registry, status: &StatusResponse) {
    number(registry, "height", "Newest executed block", status.height);
    number(registry, "committed_height", "Newest committed block", status.committed);
    number(registry, "certified_height", "Newest block with a certificate of the voters", status.certified);
    number(registry, "first_height", "Oldest stored block", status.first_height);
    number(registry, "snapshot_height", "Newest snapshot of the node", status.snapshot_height);
    let help = "Height up to which the node fetches blocks; 0 in normal operation";
    number(registry, "catching_up_to_height", help, status.catching_up_to);
    seconds(registry, "block_time", "Time of the newest block, since 1970", status.block_time as f64 / MICROS);
    seconds(registry, "clock", "The clock of the node's machine, since 1970", status.wall_clock as f64 / MICROS);
    let help = "1 while the state of this node differs from that of another one, 0 otherwise";
    number(registry, "diverged", help, u64::from(!status.divergence.is_empty()));
    let help = "1 if a member has signed two different blocks of one height or two votes in one term, 0 otherwise";
    number(registry, "lies", help, u64::from(!status.lies.is_empty()));
    let help = "1 if a member has signed two different results of one block, 0 otherwise";
    number(registry, "faults", help, u64::from(!status.faults.is_empty()));
}

fn order(registry: &mut Registry, status: &StatusResponse) {
    number(registry, "is_leader", "1 while this node is the leader, 0 otherwise", u64::from(status.role == "leader"));
    number(registry, "has_leader", "1 while there is a leader, 0 otherwise", u64::from(status.leader_id != 0));
    number(registry, "term", "Term of the ordering; increases with every election", status.term);
    let help = "Leaders deposed by complaints of voters, since the start of the node";
    registry.register("depositions", help, ConstCounter::new(status.depositions));
    number(registry, "voters", "Voters", u64::from(status.voters));
    let help = "Connected voters, including this node";
    number(registry, "voters_connected", help, u64::from(status.voters_connected));
    let lag = Several::default();
    for peer in status.peers.iter().filter(|_| status.role == "leader") {
        let of = vec![("peer", format!("{}/{}", peer.organisation, peer.name))];
        lag.get_or_create(&of).set(status.last_index.saturating_sub(peer.matched) as f64);
    }
    registry.register("peer_lag_blocks", "Blocks that a node has not acknowledged; reported by the leader", lag);
}

fn calls(registry: &mut Registry, status: &StatusResponse) {
    counted(registry, "executed", "Executed transactions, by code of the verdict", &status.executed);
    let help = "Transactions rejected by this node before ordering, by code";
    counted(registry, "refused", help, &status.refused);
    number(registry, "in_flight", "Transactions without a verdict yet", status.in_flight);
    number(registry, "in_flight_limit", "Limit of in_flight", status.in_flight_max);
    let waiting = Several::default();
    for (lane, waits) in [("control", status.waiting_control), ("data", status.waiting_data)] {
        waiting.get_or_create(&vec![("lane", lane.to_owned())]).set(waits as f64);
    }
    registry.register("waiting", "Transactions at this node that wait to be ordered", waiting);
    number(registry, "subscribers", "Open subscriptions", status.subscribers);
}

fn machine(registry: &mut Registry, status: &StatusResponse) {
    bytes(registry, "resident_memory", "Resident memory of the process", status.resident_bytes);
    bytes(registry, "disk_free", "Free bytes on the disk of the data directory", status.disk_free_bytes);
    bytes(registry, "disk_size", "Size of that disk in bytes", status.disk_total_bytes);
    let accepts = match status.disk_accepts.as_str() {
        "all" => 2,
        "ends" => 1,
        _ => 0,
    };
    number(registry, "disk_accepts", "2: all calls; 1: only those that end control; 0: none", accepts);
    let lives = Several::default();
    for certificate in &status.certificates {
        let left = (certificate.not_after as f64 - status.wall_clock as f64) / MICROS;
        let of = vec![("kind", certificate.kind.clone()), ("name", certificate.name.clone())];
        lives.get_or_create(&of).set(left);
    }
    let help = "Time until a certificate expires, or until a revocation list is overdue; negative afterwards";
    registry.register_with_unit("certificate_remaining", help, Unit::Seconds, lives);
}

/// The list of what needs attention, by check: its worst severity.
fn attention(registry: &mut Registry, status: &StatusResponse) {
    let level = |check: &str| {
        let of = status.attention.iter().filter(|item| item.check == check);
        of.map(|item| SEVERITIES.iter().position(|known| *known == item.severity).unwrap_or_default()).max()
    };
    let each = CHECKS.map(|check| (vec![("check", check.to_owned())], level(check).unwrap_or_default() as u64));
    let help = "Worst finding of a check: 0 none, 1 warning, 2 error, 3 critical";
    numbers(registry, "attention", help, each.into_iter());
}

/// Counts by the names of codes.
fn counted(registry: &mut Registry, name: &str, help: &str, by_code: &BTreeMap<u32, u64>) {
    let of = |number: &u32| u16::try_from(*number).ok().and_then(Code::from_number);
    let name_of = |number: &u32| of(number).map_or_else(|| number.to_string(), |code| code.name().to_owned());
    counts(registry, name, help, by_code.iter().map(|(number, count)| (vec![("code", name_of(number))], *count)));
}
