//! The list of what needs attention at a node. `/readyz`, `/metrics` with its alerts, gRPC health, `ledgerctl status`, `network status`,
//! `doctor`, the HTTP API and the console show it. Nothing else judges a node. docs/operations.md has its table.

mod ca_keys;

pub(crate) use ca_keys::{CaKey, CaKeys};

use ledger_api::facts::{CRITICAL, ERROR, WARNING};
use ledger_api::v1::{Attention, CertificateStatus, StatusResponse};
use ledger_base::units::{size, span};
use ledger_replica::offsets::{self, CLOCK_OFF_MAX, Offset};
use std::collections::BTreeSet;

/// Everything that is checked, in the order of the list.
pub(crate) const CHECKS: [&str; 11] =
    ["log", "state", "quorum", "leader", "redundancy", "ca", "certificate", "disk", "clock", "proof", "fault"];

/// Advice where voters are not connected: one that hangs is not started again by a start.
const SILENT_VOTERS: &str = "on the machine of each unreachable voter: systemctl status ledgerd; start it if it is \
                             stopped, restart it if it runs and does not answer";

/// A clock needs attention that is further from those of most voters, microseconds.
const CLOCK_NEAR_US: u64 = 1_000_000;
/// A disk needs attention when less than 1/N of it is free.
const DISK_LOW_PART: u64 = 10;
/// A certificate needs attention in the last 1/N of its life: by then it should have been renewed.
const LIFE_PART: u64 = 6;
/// The same, at most so long before its end, microseconds: 30 days.
const ENDING_US: u64 = 30 * 86_400_000_000;
/// The same for a CA, which needs time to be replaced everywhere, microseconds: 180 days.
const CA_ENDING_US: u64 = 180 * 86_400_000_000;

/// Facts about a node that its status does not hold.
#[derive(Default)]
pub(crate) struct Inputs<'a> {
    /// Why this node, the only voter, does not trust the clock of its machine and orders nothing; empty otherwise.
    pub(crate) clock_doubt: &'a str,
    /// The CAs that this node reports about, and the nodes that hold their keys.
    pub(crate) ca_keys: &'a [CaKey],
    /// The chain of this node holds a forced recovery: nodes that were away then have another history.
    pub(crate) is_recovered: bool,
    /// A network for trials (`ledgerd dev`): the loss of its only node is expected.
    pub(crate) is_trial: bool,
}

/// Lists what needs attention at a node of this status.
pub(crate) fn of(status: &StatusResponse, inputs: &Inputs<'_>) -> Vec<Attention> {
    let found = [log(status, inputs.is_recovered), state(status), quorum(status), leader(status)];
    let mut all: Vec<Attention> = found.into_iter().flatten().collect();
    if !inputs.is_trial {
        all.extend(redundancy(status));
        all.extend(inputs.ca_keys.iter().filter_map(|key| ca(key, status.wall_clock)));
    }
    all.extend(certificates(status));
    all.extend([disk(status), clock(status, inputs.clock_doubt), proof(status), fault(status)].into_iter().flatten());
    all
}

fn critical(check: &str, message: String, next: impl Into<String>) -> Option<Attention> {
    Some(Attention { check: check.into(), severity: CRITICAL.into(), message, next: next.into() })
}

fn error(check: &str, message: String, next: impl Into<String>) -> Option<Attention> {
    Some(Attention { check: check.into(), severity: ERROR.into(), message, next: next.into() })
}

fn warning(check: &str, message: String, next: impl Into<String>) -> Option<Attention> {
    Some(Attention { check: check.into(), severity: WARNING.into(), message, next: next.into() })
}

/// Another node has other blocks, or another state.
fn log(status: &StatusResponse, is_recovered: bool) -> Option<Attention> {
    let next = if is_recovered {
        "if those nodes were offline during a forced recovery of this network: on each of them ledgerd rejoin \
         --config ledgerd.toml, and nothing here; otherwise on the machine of the node that differs from most: \
         ledgerd verify DATA, and rejoin only if it finds a fault; if it finds none, people choose a history: \
         docs/operations.md, No history is certified"
    } else {
        "if this node was offline during a forced recovery of the network, here: ledgerd rejoin --config \
         ledgerd.toml; otherwise on the machine of the node that differs from most: ledgerd verify DATA, and rejoin \
         only if it finds a fault; if it finds none, people choose a history: docs/operations.md, No history is \
         certified"
    };
    if status.divergence.is_empty() { None } else { critical("log", status.divergence.clone(), next) }
}

/// The node lacks blocks.
fn state(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { height, catching_up_to, .. } = status;
    let message = || format!("height {height} of {catching_up_to}: the node is fetching blocks");
    let next = "wait: ledgerctl network status shows the progress";
    if *catching_up_to == 0 { None } else { critical("state", message(), next) }
}

/// The voters that this node is connected to, itself counted.
fn quorum(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { voters, voters_connected: connected, .. } = status;
    let majority = voters / 2 + 1;
    let found = format!("{connected} of {voters} voters are connected");
    if *connected < majority {
        return critical("quorum", format!("{found}; {majority} are needed to order"), SILENT_VOTERS);
    }
    let rule = status.certificate_rule.unwrap_or_default();
    if rule.strict_since.is_some() && *connected < rule.needed {
        let needed = rule.needed;
        let message = format!("{found}; {needed} must sign: no block is certified, and moving robots stop");
        return critical("quorum", message, SILENT_VOTERS);
    }
    if let Some((only, missing)) = uncertified(status) {
        let message = format!(
            "only voters of {only} are connected; without one of {missing} no block is certified, and moving robots \
             stop"
        );
        return critical("quorum", message, format!("of {missing}: {SILENT_VOTERS}"));
    }
    let left = match *connected {
        one if one == majority => ": if one more fails, nothing is ordered",
        one if rule.strict_since.is_some() && one == rule.needed => ": if one more fails, moving robots stop",
        _ => "",
    };
    if connected < voters { warning("quorum", found + left, SILENT_VOTERS) } else { None }
}

/// The only organisation of which voters are connected, and those whose voters are silent. None if blocks can be certified: voters
/// of two organisations are connected, or there is one organisation alone.
fn uncertified(status: &StatusResponse) -> Option<(String, String)> {
    let others: Vec<_> = status.peers.iter().filter(|peer| peer.voter).collect();
    // This node is a voter if its peers are not all of them.
    let own = u32::try_from(others.len()).is_ok_and(|count| count != status.voters);
    let voters = others.into_iter().map(|peer| (&*peer.organisation, peer.connected));
    let (mut connected, mut silent) = (BTreeSet::new(), BTreeSet::new());
    for (organisation, is_connected) in voters.chain(own.then_some((&*status.organisation, true))) {
        let side = if is_connected { &mut connected } else { &mut silent };
        side.insert(organisation);
    }
    let missing: Vec<&str> = silent.difference(&connected).copied().collect();
    let only = connected.first().filter(|_| connected.len() == 1 && !missing.is_empty())?;
    Some(((*only).to_owned(), missing.join(" or ")))
}

fn leader(status: &StatusResponse) -> Option<Attention> {
    let next = "wait for the election; if there is none: ledgerctl network status shows the voters that do not answer";
    if status.leader_id == 0 {
        return critical("leader", "there is no leader".to_owned(), next);
    }
    let next = "ask the organisation of that node: it ordered messages and omitted control calls (docs/security.md, \
                \"A node that lies, with a vote\")";
    if status.deposed.is_empty() { None } else { warning("leader", status.deposed.clone(), next) }
}

/// The network does not survive the loss of one voter, also while all are connected.
fn redundancy(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { voters, .. } = status;
    let message = match voters {
        1 => {
            "failures tolerated: none: there is one voter; without it nothing is ordered, and if its disk is lost, so \
             is the ledger"
        }
        _ => "failures tolerated: none: there are two voters; without one of them nothing is ordered",
    };
    let message = message.to_owned();
    let next = "add voters until there are three: ledgerctl network invite, ledgerd join, ledgerctl network promote; \
                until then: ledgerd backup DIR";
    if (1..=2).contains(voters) { warning("redundancy", message, next) } else { None }
}

/// The key of an organisation's CA. Without it, no one of the organisation enrols or renews: once the certificates of its admins have
/// ended, it is locked out.
fn ca(key: &CaKey, now: u64) -> Option<Attention> {
    let CaKey { organisation, holders, has_copy, admins_until } = key;
    let next = "ledgerctl ca carry NODE, with another node of the organisation; or make a backup: ledgerctl ca backup \
                FILE";
    match &holders[..] {
        [] => {
            let until = match admins_until.saturating_sub(now) {
                0 => "; no admin of it has a valid certificate: it is locked out".to_owned(),
                left => {
                    format!("; in {} the last certificate of its admins expires: then it is locked out", span(left))
                }
            };
            let next = "ledgerctl ca restore FILE; without a backup: docs/operations.md, \"When a disk is lost\"";
            error(
                "ca",
                format!("no node holds the CA key of {organisation}: enrolment and renewal do not work{until}"),
                next,
            )
        }
        [only] if !has_copy => {
            let message = format!(
                "only {only} holds the CA key of {organisation}, and there is no backup: if its disk is lost, the \
                 organisation is locked out once its certificates expire"
            );
            warning("ca", message, next)
        }
        _ => None,
    }
}

/// The certificates of the node and its CA, and the revocation lists of the network.
fn certificates(status: &StatusResponse) -> Vec<Attention> {
    if status.certificates.iter().all(|certificate| certificate.kind == "list") {
        let message = "no certificate can be read".to_owned();
        return critical("certificate", message, "compare the files of [tls] in ledgerd.toml with those on disk")
            .into_iter()
            .collect();
    }
    status.certificates.iter().filter_map(|certificate| ending(certificate, status.wall_clock)).collect()
}

fn ending(certificate: &CertificateStatus, now: u64) -> Option<Attention> {
    let CertificateStatus { kind, name, not_before, not_after } = certificate;
    let life = not_after.saturating_sub(*not_before);
    let left = not_after.saturating_sub(now);
    let (what, next, notice) = match kind.as_str() {
        "node" => (
            format!("the certificate of {name}"),
            "nodes renew automatically: the log of the node has the reason for the failure (journalctl -u ledgerd)",
            ENDING_US,
        ),
        // A list is replaced every few days: it is late once it has ended.
        "list" => {
            (format!("the revocation list {name}"), "record a new list of that CA: ledgerctl identity crl FILE", 0)
        }
        _ => (
            format!("the CA {name}"),
            "create a new CA while the old one is valid: docs/operations.md, \"The CA of an organisation\"",
            CA_ENDING_US,
        ),
    };
    match left {
        // The last list counts until the next one comes.
        0 if kind == "list" => warning("certificate", format!("{what} has expired"), next),
        0 => critical("certificate", format!("{what} has expired"), next),
        _ if left < notice.min(life / LIFE_PART) => {
            warning("certificate", format!("{what} expires in {}", span(left)), next)
        }
        _ => None,
    }
}

fn disk(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { disk_free_bytes: free, disk_total_bytes: total, disk_accepts, data_directory, .. } = status;
    let percent = free.saturating_mul(100) / (*total).max(1);
    let found = format!("{} ({percent} %) of {} free, in {data_directory}", size(*free), size(*total));
    let next = "free disk space there, or keep fewer blocks: `retention` and `archive` in ledgerd.toml";
    match disk_accepts.as_str() {
        "ends" => critical("disk", found + "; only calls that end control are accepted", next),
        "nothing" => critical("disk", found + "; nothing is accepted", next),
        _ if free.saturating_mul(DISK_LOW_PART) < *total => warning("disk", found, next),
        _ => None,
    }
}

/// The clock of the machine, against block time and the clocks of the voters.
fn clock(status: &StatusResponse, doubt: &str) -> Option<Attention> {
    let next = "on its machine: timedatectl set-ntp true; if its clock is right: docs/operations.md, \"Clocks\"";
    if !doubt.is_empty() {
        return critical("clock", doubt.to_owned(), next);
    }
    let late = status.block_time.saturating_sub(status.wall_clock);
    if late >= CLOCK_OFF_MAX {
        return critical("clock", format!("block time is {} ahead of the clock of its machine", span(late)), next);
    }
    let off = off(status);
    let message = || format!("the clock of its machine is {}", offsets::described(off));
    match off.unsigned_abs() {
        CLOCK_OFF_MAX.. => critical("clock", message() + "; it accepts only calls that end control", next),
        CLOCK_NEAR_US.. => warning("clock", message(), next),
        _ => None,
    }
}

/// How far the clocks of most voters are ahead of this machine's at least, microseconds; below 0 where they are behind.
fn off(status: &StatusResponse) -> i64 {
    let measured = status.peers.iter().filter(|peer| peer.voter && peer.clock_error_us > 0);
    offsets::ahead_of_this(measured.map(|peer| Offset { ahead: peer.clock_offset_us, error: peer.clock_error_us }))
}

/// Members that have signed two different results of one block.
fn fault(status: &StatusResponse) -> Option<Attention> {
    let next = "on its machine: check memory and disk, then start it: it computes its state again from the blocks";
    if status.faults.is_empty() { None } else { warning("fault", status.faults.clone(), next) }
}

/// Members that have signed two different things for one place.
fn proof(status: &StatusResponse) -> Option<Attention> {
    let next = "read docs/security.md, \"A node that lies, with a vote\", then: ledgerctl network remove NODE --proof FILE, with the file in \
                certificates/ of this node's data directory";
    if status.lies.is_empty() { None } else { warning("proof", status.lies.clone(), next) }
}

#[cfg(test)]
mod tests;
