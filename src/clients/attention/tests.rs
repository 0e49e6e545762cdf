//! Every check, and the table of the documentation.

#![expect(clippy::panic, clippy::indexing_slicing, reason = "tests")]

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
    let all = of(&status, &Inputs { clock_doubt: doubt, ..Inputs::default() });
    assert!(all.iter().all(|item| !item.next.is_empty()), "{all:?}");
    // The table of the documentation has a cell for it.
    assert!(all.iter().all(|item| documented(&item.check, &item.severity)), "{all:?}");
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
    only(&last, "quorum", WARNING, "4 of 5 voters are connected: if one more fails, moving robots stop");
}

/// The table of docs/operations.md: check, critical, error, warning, to do.
fn table() -> Vec<Vec<&'static str>> {
    let page = include_str!("../../../docs/operations.md");
    let table = page.split_once("| check | critical | error | warning | to do |").map_or("", |(_, table)| table);
    let rows = table.lines().skip(2).map_while(|row| row.strip_prefix("| ")?.strip_suffix(" |"));
    rows.map(|row| row.split(" | ").map(str::trim).collect()).collect()
}

fn documented(check: &str, severity: &str) -> bool {
    let column = [CRITICAL, ERROR, WARNING].iter().position(|known| *known == severity);
    let cell = |row: &Vec<&str>| row[0] == format!("`{check}`") && column.is_some_and(|at| row[at + 1] != "-");
    table().iter().any(cell)
}

#[test]
fn the_page_about_operations_has_every_check_in_the_order_of_the_list() {
    let rows = table();
    assert!(rows.iter().all(|row| row.len() == 5 && !row[4].is_empty()), "{rows:?}");
    let names: Vec<_> = rows.iter().map(|row| row[0].trim_matches('`')).collect();
    assert_eq!(names, CHECKS);
}

#[test]
fn after_a_forced_recovery_the_survivor_is_not_advised_to_rejoin() {
    let mut status = status();
    status.divergence = "Org1/node2 has another block at height 9".into();
    let next = |is_recovered| {
        let all = of(&status, &Inputs { is_recovered, ..Inputs::default() });
        all.into_iter().map(|item| item.next).collect::<String>()
    };
    assert!(
        next(true).contains("on each of them ledgerd rejoin --config ledgerd.toml, and nothing here"),
        "{}",
        next(true)
    );
    assert!(
        next(false).contains("offline during a forced recovery of the network, here: ledgerd rejoin"),
        "{}",
        next(false)
    );
}

#[test]
fn a_network_that_tolerates_no_failure_is_never_silent() {
    for voters in [1, 2] {
        let few = found(|s| (s.voters, s.voters_connected, s.peers) = (voters, voters, Vec::new()));
        only(&few, "redundancy", WARNING, "failures tolerated: none");
    }
    let mut status = status();
    (status.voters, status.voters_connected, status.peers) = (1, 1, Vec::new());
    assert_eq!(of(&status, &Inputs { is_trial: true, ..Inputs::default() }), []);
}

#[test]
fn a_ca_key_that_can_be_lost_is_a_warning_and_one_that_is_lost_an_error() {
    let key = |holders: &[&str], has_copy: bool, admins_until: u64| CaKey {
        organisation: "Org1".into(),
        holders: holders.iter().map(|name| (*name).to_owned()).collect(),
        has_copy,
        admins_until: admins_until * DAY,
    };
    let found = |key: CaKey| {
        let all = of(&status(), &Inputs { ca_keys: &[key], ..Inputs::default() });
        assert!(all.iter().all(|item| documented(&item.check, &item.severity)), "{all:?}");
        all.into_iter().map(|item| (item.check, item.severity, item.message)).collect::<Vec<_>>()
    };
    only(&found(key(&[], false, 112)), "ca", ERROR, "no node holds the CA key of Org1");
    only(&found(key(&[], true, 112)), "ca", ERROR, "in 12 days the last certificate of its admins expires");
    only(&found(key(&[], true, 99)), "ca", ERROR, "it is locked out");
    only(&found(key(&["Org1/node1"], false, 0)), "ca", WARNING, "only Org1/node1 holds the CA key of Org1");
    assert_eq!(found(key(&["Org1/node1"], true, 0)), []);
    assert_eq!(found(key(&["Org1/node1", "Org1/node2"], false, 0)), []);
}

#[test]
fn a_node_that_lacks_nothing_needs_no_attention() {
    assert_eq!(found(|_| ()), []);
}

#[test]
fn what_keeps_a_node_from_its_work_is_critical() {
    only(&found(|s| s.divergence = "Org2/node2 has another block".into()), "log", CRITICAL, "another block");
    only(&found(|s| s.catching_up_to = 9), "state", CRITICAL, "height 0 of 9");
    only(&found(|s| s.voters_connected = 1), "quorum", CRITICAL, "1 of 3 voters are connected; 2 are needed to order");
    only(&found(|s| s.leader_id = 0), "leader", CRITICAL, "there is no leader");
    only(&found(|s| s.deposed = "voters deposed Org2/node2 12 s ago".into()), "leader", WARNING, "voters deposed");
    let ended = found(|s| s.wall_clock = 501 * DAY);
    only(&ended, "certificate", CRITICAL, "the certificate of Org1/node1 has expired");
    only(&found(|s| s.certificates.clear()), "certificate", CRITICAL, "no certificate can be read");
    let list = found(|s| s.certificates = vec![certificate("list", 0, 500)]);
    only(&list, "certificate", CRITICAL, "no certificate can be read");
    only(&found(|s| s.disk_accepts = "ends".into()), "disk", CRITICAL, "only calls that end control are accepted");
    only(&found(|s| s.disk_accepts = "nothing".into()), "disk", CRITICAL, "nothing is accepted");
    only(&found_with("it has jumped ahead", |_| ()), "clock", CRITICAL, "it has jumped ahead");
}

#[test]
fn what_may_soon_keep_a_node_from_its_work_is_a_warning() {
    let one_less = found(|s| s.voters_connected = 2);
    only(&one_less, "quorum", WARNING, "2 of 3 voters are connected: if one more fails, nothing is ordered");
    let of_five = found(|s| (s.voters, s.voters_connected) = (5, 4));
    only(&of_five, "quorum", WARNING, "4 of 5 voters are connected");
    assert!(!of_five.iter().any(|(.., message)| message.contains("if one more fails")), "{of_five:?}");
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
    only(&alone, "quorum", CRITICAL, "only voters of Org1 are connected; without one of Org2 no block is certified");
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
    only(&ends_in("node", 29, 365), "certificate", WARNING, "the certificate of Org1/node1 expires in 29 days");
    assert_eq!(ends_in("node", 2, 10), [], "a short life is renewed late");
    only(&ends_in("node", 1, 10), "certificate", WARNING, "expires in 1 day");
    assert_eq!(ends_in("ca", 181, 1180), []);
    only(&ends_in("ca", 179, 1179), "certificate", WARNING, "the CA ca of Org1 expires in 179 days");
    assert_eq!(ends_in("list", 1, 7), [], "a list is late once it has expired");
    only(&ends_in("list", 0, 7), "certificate", WARNING, "the revocation list ca of Org1 has expired");
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
        .into_iter()
        .filter(|(check, ..)| check != "redundancy")
        .collect::<Vec<_>>()
    };
    let well: [&[i64]; 5] = [&[0], &[9_000_000], &[0, 9_000_000], &[1_099_999, 1_099_999], &[-9_000_000, 9_000_000]];
    for offsets in well {
        assert_eq!(found(offsets), [], "{offsets:?}");
    }
    let near = found(&[-1_100_000, -9_000_000]);
    only(&near, "clock", WARNING, "the clock of its machine is 1.0 s ahead of those of most voters");
    let far = found(&[6_000_000, 5_100_000]);
    only(&far, "clock", CRITICAL, "the clock of its machine is 5.0 s behind those of most voters");
}
