//! The list of what needs attention at a node. `/readyz`, gRPC health, `ledgerctl status`, `network status`, `doctor`, the HTTP API
//! and the console show it. Nothing else judges a node.

use ledger_api::v1::{Attention, CertificateStatus, StatusResponse};
use ledger_base::units::{size, span};
use ledger_replica::offsets::{self, CLOCK_OFF_MAX, Offset};
use std::collections::BTreeSet;

/// Everything that is checked, in the order of the list.
pub(crate) const CHECKS: [&str; 9] =
    ["log", "state", "quorum", "leader", "certificate", "disk", "clock", "proof", "fault"];

/// The node is not ready.
pub(crate) const CRITICAL: &str = "critical";
/// The node is ready, and may not stay so.
pub(crate) const WARNING: &str = "warning";

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

/// Lists what needs attention at a node of this status. `clock_doubt`: why this node, the only voter, does not trust the clock of
/// its machine and orders nothing; empty otherwise.
pub(crate) fn of(status: &StatusResponse, clock_doubt: &str) -> Vec<Attention> {
    let found = [log(status), state(status), quorum(status), leader(status)];
    let mut all: Vec<Attention> = found.into_iter().flatten().collect();
    all.extend(certificates(status));
    all.extend([disk(status), clock(status, clock_doubt), proof(status), fault(status)].into_iter().flatten());
    all
}

fn critical(check: &str, message: String, next: impl Into<String>) -> Option<Attention> {
    Some(Attention { check: check.into(), severity: CRITICAL.into(), message, next: next.into() })
}

fn warning(check: &str, message: String, next: impl Into<String>) -> Option<Attention> {
    Some(Attention { check: check.into(), severity: WARNING.into(), message, next: next.into() })
}

/// Another node has other blocks, or another state.
fn log(status: &StatusResponse) -> Option<Attention> {
    let next = "where the node that differs from most runs: ledgerd verify DATA; only if that finds a fault: ledgerd rejoin \
                --config ledgerd.toml";
    if status.divergence.is_empty() { None } else { critical("log", status.divergence.clone(), next) }
}

/// The node lacks blocks.
fn state(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { height, catching_up_to, .. } = status;
    let message = || format!("height {height} of {catching_up_to}: the node fetches the blocks that it lacks");
    let next = "wait: ledgerctl network status shows the progress";
    if *catching_up_to == 0 { None } else { critical("state", message(), next) }
}

/// The voters that this node is connected to, itself counted.
fn quorum(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { voters, voters_connected: connected, .. } = status;
    let majority = voters / 2 + 1;
    let found = format!("{connected} of {voters} voters are connected");
    if *connected < majority {
        let next = "start the voters that are silent: systemctl start ledgerd";
        return critical("quorum", format!("{found}; {majority} are needed to order"), next);
    }
    let rule = status.certificate_rule.unwrap_or_default();
    if rule.strict_since.is_some() && *connected < rule.needed {
        let needed = rule.needed;
        let message = format!("{found}; {needed} must sign: no block is certified, and robots that move stop");
        return critical("quorum", message, "start the voters that are silent: systemctl start ledgerd");
    }
    if let Some((only, missing)) = uncertified(status) {
        let message = format!(
            "only voters of {only} are connected; without one of {missing} no block is certified, and robots that move stop"
        );
        return critical("quorum", message, format!("start a voter of {missing}: systemctl start ledgerd"));
    }
    let left = match *connected {
        one if one == majority => ": one less and nothing is ordered",
        one if rule.strict_since.is_some() && one == rule.needed => ": one less and robots that move stop",
        _ => "",
    };
    let next = "start the voters that are silent before another one fails: systemctl start ledgerd";
    if connected < voters { warning("quorum", found + left, next) } else { None }
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
    let next = "wait for the election; if none ends, start the voters that ledgerctl network status calls unreachable";
    if status.leader_id == 0 {
        return critical("leader", "no leader is known".to_owned(), next);
    }
    let next = "ask the organisation of that node: it ordered messages and left out control calls \
                (docs/security.md, \"A node that lies, with a vote\")";
    if status.deposed.is_empty() { None } else { warning("leader", status.deposed.clone(), next) }
}

/// The certificates of the node and its CA, and the revocation lists of the network.
fn certificates(status: &StatusResponse) -> Vec<Attention> {
    if status.certificates.iter().all(|certificate| certificate.kind == "list") {
        let message = "there is no certificate that can be read".to_owned();
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
            "a node renews by itself: its log has the reason that it could not (journalctl -u ledgerd)",
            ENDING_US,
        ),
        // A list is replaced every few days: it is late once it has ended.
        "list" => (format!("the revocation list {name}"), "ledgerctl identity crl FILE, with a new list of that CA", 0),
        _ => (
            format!("the CA {name}"),
            "make a new CA while the old one is valid: docs/operations.md, \"The CA of an organisation\"",
            CA_ENDING_US,
        ),
    };
    match left {
        // The last list counts until the next one comes.
        0 if kind == "list" => warning("certificate", format!("{what} has ended"), next),
        0 => critical("certificate", format!("{what} has ended"), next),
        _ if left < notice.min(life / LIFE_PART) => {
            warning("certificate", format!("{what} ends in {}", span(left)), next)
        }
        _ => None,
    }
}

fn disk(status: &StatusResponse) -> Option<Attention> {
    let StatusResponse { disk_free_bytes: free, disk_total_bytes: total, disk_accepts, data_directory, .. } = status;
    let percent = free.saturating_mul(100) / (*total).max(1);
    let found = format!("{} ({percent} %) of {} free, in {data_directory}", size(*free), size(*total));
    let next = "make room there, or keep fewer blocks: `retention` and `archive` in ledgerd.toml";
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
        CLOCK_OFF_MAX.. => critical("clock", message() + "; it judges no calls but those that end control", next),
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
#[expect(clippy::panic, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1::{CertificateRule, PeerStatus};

    const DAY: u64 = 86_400_000_000;

    /// Org1/node1 of three voters, of which the second is Org2's.
    fn status() -> StatusResponse {
        let peer = |organisation: &str| PeerStatus {
            organisation: organisation.into(),
            voter: true,
            connected: true,
            ..PeerStatus::default()
        };
        StatusResponse {
            organisation: "Org1".into(),
            voters: 3,
            voters_connected: 3,
            leader_id: 2,
            disk_accepts: "all".into(),
            disk_free_bytes: 5 << 30,
            disk_total_bytes: 20 << 30,
            data_directory: "/var/lib/ledgerd".into(),
            clock: 100 * DAY,
            wall_clock: 100 * DAY,
            block_time: 100 * DAY,
            peers: vec![peer("Org2"), peer("Org1")],
            certificates: vec![certificate("node", 0, 500)],
            ..StatusResponse::default()
        }
    }

    fn certificate(kind: &str, from: u64, to: u64) -> CertificateStatus {
        let name = if kind == "node" { "Org1/node1" } else { "ca of Org1" };
        CertificateStatus { kind: kind.into(), name: name.into(), not_before: from * DAY, not_after: to * DAY }
    }

    /// Check, severity and message of what needs attention after this change.
    fn found(change: impl FnOnce(&mut StatusResponse)) -> Vec<(String, String, String)> {
        found_with("", change)
    }

    fn found_with(doubt: &str, change: impl FnOnce(&mut StatusResponse)) -> Vec<(String, String, String)> {
        let mut status = status();
        change(&mut status);
        let all = of(&status, doubt);
        assert!(all.iter().all(|item| !item.next.is_empty()), "{all:?}");
        assert!(all.iter().all(|item| CHECKS.contains(&&*item.check)), "{all:?}");
        all.into_iter().map(|item| (item.check, item.severity, item.message)).collect()
    }

    /// This alone needs attention.
    fn only(found: &[(String, String, String)], check: &str, severity: &str, message: &str) {
        let [(of, how, why)] = found else { panic!("{check}: {found:?}") };
        assert_eq!((&**of, &**how), (check, severity), "{why}");
        assert!(why.contains(message), "{why}");
    }

    #[test]
    fn strict_certificates_need_more_voters_than_ordering_does() {
        let strict = |needed| Some(CertificateRule { needed, strict_since: Some(7), ..CertificateRule::default() });
        let few = found(|status| {
            (status.voters, status.voters_connected, status.certificate_rule) = (5, 3, strict(4));
        });
        only(&few, "quorum", CRITICAL, "3 of 5 voters are connected; 4 must sign: no block is certified");
        let last = found(|status| {
            (status.voters, status.voters_connected, status.certificate_rule) = (5, 4, strict(4));
        });
        only(&last, "quorum", WARNING, "4 of 5 voters are connected: one less and robots that move stop");
    }

    #[test]
    fn the_page_about_metrics_has_every_check() {
        let page = include_str!("../../docs/metrics.md");
        let table = page.split_once("| check | critical | warning |").map_or("", |(_, table)| table);
        let rows = table.lines().skip(2).map_while(|row| row.strip_prefix("| `")?.split('`').next());
        assert_eq!(rows.collect::<Vec<_>>(), CHECKS);
    }

    #[test]
    fn a_node_that_lacks_nothing_needs_no_attention() {
        assert_eq!(found(|_| ()), []);
    }

    #[test]
    fn what_keeps_a_node_from_its_work_is_critical() {
        only(&found(|s| s.divergence = "Org2/node2 has another block".into()), "log", CRITICAL, "another block");
        only(&found(|s| s.catching_up_to = 9), "state", CRITICAL, "height 0 of 9");
        only(
            &found(|s| s.voters_connected = 1),
            "quorum",
            CRITICAL,
            "1 of 3 voters are connected; 2 are needed to order",
        );
        only(&found(|s| s.leader_id = 0), "leader", CRITICAL, "no leader is known");
        only(&found(|s| s.deposed = "voters deposed Org2/node2 12 s ago".into()), "leader", WARNING, "voters deposed");
        let ended = found(|s| s.wall_clock = 501 * DAY);
        only(&ended, "certificate", CRITICAL, "the certificate of Org1/node1 has ended");
        only(&found(|s| s.certificates.clear()), "certificate", CRITICAL, "no certificate that can be read");
        let list = found(|s| s.certificates = vec![certificate("list", 0, 500)]);
        only(&list, "certificate", CRITICAL, "no certificate that can be read");
        only(&found(|s| s.disk_accepts = "ends".into()), "disk", CRITICAL, "only calls that end control are accepted");
        only(&found(|s| s.disk_accepts = "nothing".into()), "disk", CRITICAL, "nothing is accepted");
        only(&found_with("it has jumped ahead", |_| ()), "clock", CRITICAL, "it has jumped ahead");
    }

    #[test]
    fn what_may_soon_keep_a_node_from_its_work_is_a_warning() {
        let one_less = found(|s| s.voters_connected = 2);
        only(&one_less, "quorum", WARNING, "2 of 3 voters are connected: one less and nothing is ordered");
        let of_five = found(|s| (s.voters, s.voters_connected) = (5, 4));
        only(&of_five, "quorum", WARNING, "4 of 5 voters are connected");
        assert!(!of_five.iter().any(|(.., message)| message.contains("one less")), "{of_five:?}");
        let low = found(|s| s.disk_free_bytes = (1 << 30) + (1 << 29));
        only(&low, "disk", WARNING, "1.5 GiB (7 %) of 20 GiB free, in /var/lib/ledgerd");
        assert_eq!(found(|s| s.disk_free_bytes = 2 << 30), []);
        only(&found(|s| s.lies = "Org2/node2: 1 proof".into()), "proof", WARNING, "Org2/node2");
        only(&found(|s| s.faults = "Org2/node2: 1 proof".into()), "fault", WARNING, "Org2/node2");
    }

    #[test]
    fn voters_of_one_organisation_alone_certify_nothing_where_another_one_has_voters() {
        let without = |silent: &[usize], change: &dyn Fn(&mut StatusResponse)| {
            found(|status| {
                for (at, peer) in status.peers.iter_mut().enumerate() {
                    peer.connected = !silent.contains(&at);
                }
                status.voters_connected -= u32::try_from(silent.len()).unwrap_or_default();
                change(status);
            })
        };
        let alone = without(&[0], &|_| ());
        only(
            &alone,
            "quorum",
            CRITICAL,
            "only voters of Org1 are connected; without one of Org2 no block is certified",
        );
        only(&without(&[1], &|_| ()), "quorum", WARNING, "2 of 3");
        // Of a node that only follows, its peers are all voters.
        let follows = without(&[1], &|status| {
            status.peers.push(status.peers[0].clone());
            (status.voters, status.voters_connected) = (3, 2);
        });
        only(&follows, "quorum", CRITICAL, "only voters of Org2 are connected; without one of Org1");
        let one = without(&[0], &|status| status.peers.iter_mut().for_each(|peer| peer.organisation = "Org1".into()));
        only(&one, "quorum", WARNING, "2 of 3");
    }

    #[test]
    fn certificates_need_attention_once_they_should_have_been_renewed() {
        let ends_in = |kind: &str, days: u64, life: u64| {
            let all = vec![certificate("node", 0, 5000), certificate(kind, 1000 + days - life, 1000 + days)];
            let now = 1000 * DAY;
            found(|s| (s.certificates, s.wall_clock, s.clock, s.block_time) = (all, now, now, now))
        };
        assert_eq!(ends_in("node", 31, 365), []);
        only(&ends_in("node", 29, 365), "certificate", WARNING, "the certificate of Org1/node1 ends in 29 days");
        assert_eq!(ends_in("node", 2, 10), [], "a short life is renewed late");
        only(&ends_in("node", 1, 10), "certificate", WARNING, "ends in 1 day");
        assert_eq!(ends_in("ca", 181, 1180), []);
        only(&ends_in("ca", 179, 1179), "certificate", WARNING, "the CA ca of Org1 ends in 179 days");
        assert_eq!(ends_in("list", 1, 7), [], "a list is late once it has ended");
        only(&ends_in("list", 0, 7), "certificate", WARNING, "the revocation list ca of Org1 has ended");
    }

    #[test]
    fn a_clock_five_seconds_behind_block_time_is_critical() {
        // The clock of the node is never behind block time.
        let ahead = |by: u64| found(|s| (s.block_time, s.clock) = (100 * DAY + by, 100 * DAY + by));
        assert_eq!(ahead(4_999_999), []);
        only(&ahead(240_000_000), "clock", CRITICAL, "block time is 4 min ahead of the clock of its machine");
        assert_eq!(found(|s| s.block_time = 0), [], "no block yet");
    }

    #[test]
    fn a_clock_is_judged_by_those_of_most_voters_as_far_as_they_are_known() {
        let found = |offsets: &[i64]| {
            let measured = |offset: &i64| PeerStatus {
                voter: true,
                connected: true,
                clock_offset_us: *offset,
                clock_error_us: 100_000,
                ..PeerStatus::default()
            };
            let voters = u32::try_from(offsets.len()).unwrap_or_default();
            found(|s| {
                s.peers = offsets.iter().map(measured).collect();
                (s.voters, s.voters_connected) = (voters, voters);
            })
        };
        let well: [&[i64]; 5] =
            [&[0], &[9_000_000], &[0, 9_000_000], &[1_099_999, 1_099_999], &[-9_000_000, 9_000_000]];
        for offsets in well {
            assert_eq!(found(offsets), [], "{offsets:?}");
        }
        let near = found(&[-1_100_000, -9_000_000]);
        only(&near, "clock", WARNING, "the clock of its machine is 1.0 s ahead of those of most voters");
        let far = found(&[6_000_000, 5_100_000]);
        only(&far, "clock", CRITICAL, "the clock of its machine is 5.0 s behind those of most voters");
    }
}
