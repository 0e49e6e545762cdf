//! The parts of a node's readiness.

use crate::clients::monitoring::check::Check;
use ledger_api::v1::StatusResponse;

/// A certificate needs attention so long before its end, microseconds: 30 days.
const ENDING_US: u64 = 30 * 86_400_000_000;
/// The machine's clock may be so far behind block time, and so far from the clocks of most voters, microseconds: what gates bear.
const CLOCK_OFF_MAX_US: u64 = 5_000_000;
/// A clock needs attention that is further from those of most voters, microseconds.
const CLOCK_NEAR_US: u64 = 1_000_000;
/// A disk needs attention below one part in so many.
const DISK_LOW_PART: u64 = 10;

/// All parts, by what the node says of itself.
pub(super) fn all(status: &StatusResponse) -> Vec<Check> {
    let StatusResponse { voters, voters_connected, leader_id, disk_accepts, .. } = status;
    let majority = voters / 2 + 1;
    let (free, total) = (status.disk_free_bytes, status.disk_total_bytes);
    vec![
        Check::of("log", status.divergence.is_empty(), || status.divergence.clone()),
        Check::of("state", status.catching_up_to == 0, || {
            format!("height {} of {}: the node fetches what it lacks", status.height, status.catching_up_to)
        }),
        Check::of("quorum", *voters_connected >= majority, || {
            format!("{voters_connected} of {voters} voters are connected; {majority} are needed to order")
        })
        .warn(*voters_connected == majority && *voters > 2, || {
            format!("{voters_connected} of {voters} voters are connected: one less and nothing is ordered")
        }),
        Check::of("leader", *leader_id != 0, || "no leader is known".to_owned()),
        certificate(status),
        Check::of("disk", disk_accepts == "all", || format!("{free} bytes are free; accepted: {disk_accepts}"))
            .warn(free.saturating_mul(DISK_LOW_PART) < total, || format!("{free} of {total} bytes are free")),
        clock(status),
    ]
}

/// The clock of the machine, against block time and the clocks of the voters.
fn clock(status: &StatusResponse) -> Check {
    if !status.clock_doubt.is_empty() {
        return Check::failed("clock", status.clock_doubt.clone());
    }
    let late = status.block_time.saturating_sub(status.wall_clock);
    if late >= CLOCK_OFF_MAX_US {
        return Check::failed("clock", format!("block time is {} s ahead of this machine's clock", late / 1_000_000));
    }
    let off = off(status);
    let far = off.unsigned_abs();
    let told = || {
        let way = if off > 0 { "behind" } else { "ahead of" };
        format!("this machine's clock is {}.{} s {way} those of most voters", far / 1_000_000, far / 100_000 % 10)
    };
    Check::of("clock", far < CLOCK_OFF_MAX_US, told).warn(far >= CLOCK_NEAR_US, told)
}

/// How far the clocks of most voters are ahead of this machine's at least, microseconds; below 0 where they are behind. Of two in the
/// middle the nearer one counts: one other clock says nothing against this one.
fn off(status: &StatusResponse) -> i64 {
    let heard = status.peers.iter().filter(|peer| peer.voter && peer.clock_error_us > 0);
    let others = heard.map(|peer| {
        let sure = peer.clock_offset_us.unsigned_abs().saturating_sub(peer.clock_error_us);
        i64::try_from(sure).unwrap_or(i64::MAX) * peer.clock_offset_us.signum()
    });
    let mut all: Vec<i64> = others.chain([0]).collect();
    all.sort_unstable();
    let middle = [all.get((all.len() - 1) / 2), all.get(all.len() / 2)];
    middle.into_iter().flatten().copied().min_by_key(|off| off.unsigned_abs()).unwrap_or_default()
}

/// The certificates of the node and its CA.
fn certificate(status: &StatusResponse) -> Check {
    let own = status.certificates.iter().filter(|certificate| certificate.kind != "list");
    let Some(first) = own.min_by_key(|certificate| certificate.not_after) else {
        return Check::failed("certificate", "there is none that can be read".to_owned());
    };
    let left = first.not_after.saturating_sub(status.wall_clock);
    let days = left / 86_400_000_000;
    Check::of("certificate", left > 0, || format!("{} {} has ended", first.kind, first.name))
        .warn(left < ENDING_US, || format!("{} {} ends in {days} days", first.kind, first.name))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1::{CertificateStatus, PeerStatus};

    /// The check, what makes it fail, and a part of the reason.
    type Case = (&'static str, &'static dyn Fn(&mut StatusResponse), &'static str);

    const DAY: u64 = 86_400_000_000;

    fn status() -> StatusResponse {
        let certificate =
            CertificateStatus { kind: "node".into(), name: "Org1/node1".into(), not_before: 0, not_after: 500 * DAY };
        StatusResponse {
            voters: 3,
            voters_connected: 3,
            leader_id: 2,
            disk_accepts: "all".into(),
            disk_free_bytes: 50,
            disk_total_bytes: 100,
            clock: 100 * DAY,
            wall_clock: 100 * DAY,
            block_time: 100 * DAY,
            certificates: vec![certificate],
            ..StatusResponse::default()
        }
    }

    /// The same where block time is ahead of the machine's clock: the clock of the node goes on from block time.
    fn with_block_time_ahead(by: u64) -> StatusResponse {
        let block_time = 100 * DAY + by;
        StatusResponse { block_time, clock: block_time, ..status() }
    }

    /// Of a node that hears these clocks of others, each known to 100 ms.
    fn with_clocks(offsets: &[i64]) -> StatusResponse {
        let heard = |offset: &i64| PeerStatus {
            voter: true,
            clock_offset_us: *offset,
            clock_error_us: 100_000,
            ..PeerStatus::default()
        };
        StatusResponse { peers: offsets.iter().map(heard).collect(), ..status() }
    }

    /// The lines about this part.
    fn told(status: &StatusResponse, name: &str) -> String {
        all(status).iter().find(|check| check.name() == name).unwrap().to_string()
    }

    #[test]
    fn a_node_that_lacks_nothing_is_ready() {
        let checks = all(&status());
        assert!(checks.iter().all(|check| check.to_string().ends_with(" ok\n")), "{checks:?}");
        assert_eq!(checks.len(), 7);
    }

    #[test]
    fn each_part_fails_by_itself_with_a_reason() {
        let changed = |change: &dyn Fn(&mut StatusResponse)| {
            let mut status = status();
            change(&mut status);
            status
        };
        let cases: [Case; 8] = [
            ("log", &|s| s.divergence = "Org2/node2 has another block".into(), "another block"),
            ("state", &|s| s.catching_up_to = 9, "height 0 of 9"),
            ("quorum", &|s| s.voters_connected = 1, "1 of 3 voters are connected; 2 are needed"),
            ("leader", &|s| s.leader_id = 0, "no leader is known"),
            ("certificate", &|s| s.wall_clock = 501 * DAY, "node Org1/node1 has ended"),
            ("certificate", &|s| s.certificates.clear(), "there is none"),
            ("disk", &|s| s.disk_accepts = "ends".into(), "accepted: ends"),
            ("clock", &|s| s.clock_doubt = "it has jumped ahead".into(), "it has jumped ahead"),
        ];
        for (name, change, reason) in cases {
            let status = changed(change);
            let said = told(&status, name);
            assert!(said.starts_with(&format!("[-] {name} failed: ")) && said.contains(reason), "{said}");
            let failed: Vec<_> = all(&status).into_iter().filter(|check| !check.is_ok()).collect();
            assert!(failed.iter().any(|check| check.name() == name), "{failed:?}");
        }
    }

    #[test]
    fn a_machine_whose_clock_is_five_seconds_behind_block_time_is_not_ready() {
        assert_eq!(told(&with_block_time_ahead(4_999_999), "clock"), "[+] clock ok\n");
        let said = told(&with_block_time_ahead(240_000_000), "clock");
        assert_eq!(said, "[-] clock failed: block time is 240 s ahead of this machine's clock\n");
    }

    #[test]
    fn a_clock_is_judged_by_those_of_most_voters_as_far_as_they_are_known() {
        let said = |offsets: &[i64]| told(&with_clocks(offsets), "clock");
        let well: [&[i64]; 5] = [&[], &[9_000_000], &[0, 9_000_000], &[1_099_999, 1_099_999], &[-9_000_000, 9_000_000]];
        for offsets in well {
            assert_eq!(said(offsets), "[+] clock ok\n", "{offsets:?}");
        }
        let near = said(&[-1_100_000, -9_000_000]);
        assert_eq!(near, "[+] clock ok, but this machine's clock is 1.0 s ahead of those of most voters\n");
        let far = said(&[6_000_000, 5_100_000]);
        assert_eq!(far, "[-] clock failed: this machine's clock is 5.0 s behind those of most voters\n");
    }

    #[test]
    fn what_is_near_its_end_is_told_while_the_node_is_ready() {
        let near = StatusResponse { voters_connected: 2, disk_free_bytes: 9, wall_clock: 480 * DAY, ..status() };
        for (name, warning) in [
            ("quorum", "one less and nothing is ordered"),
            ("disk", "9 of 100 bytes are free"),
            ("certificate", "ends in 20 days"),
        ] {
            let said = told(&near, name);
            assert!(said.starts_with(&format!("[+] {name} ok, but ")) && said.contains(warning), "{said}");
        }
        // Of two voters both are always needed.
        let two = StatusResponse { voters: 2, voters_connected: 2, ..status() };
        assert_eq!(told(&two, "quorum"), "[+] quorum ok\n");
    }
}
