//! The parts of a node's readiness.

use crate::admin::check::Check;
use ledger_api::v1::StatusResponse;

/// A certificate needs attention so long before its end, microseconds: 30 days.
const ENDING_US: u64 = 30 * 86_400_000_000;
/// Block time may be ahead of the node's clock by so much, microseconds.
const AHEAD_MAX_US: u64 = 5_000_000;
/// A disk needs attention below one part in so many.
const DISK_LOW_PART: u64 = 10;

/// All parts, by what the node says of itself.
pub(super) fn all(status: &StatusResponse) -> Vec<Check> {
    let StatusResponse { voters, voters_connected, leader_id, disk_accepts, clock, block_time, .. } = status;
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
        Check::of("clock", block_time.saturating_sub(*clock) < AHEAD_MAX_US, || {
            format!("block time is {} s ahead of this machine's clock", (block_time - clock) / 1_000_000)
        }),
    ]
}

/// The certificates of the node and its CA.
fn certificate(status: &StatusResponse) -> Check {
    let own = status.certificates.iter().filter(|certificate| certificate.kind != "list");
    let Some(first) = own.min_by_key(|certificate| certificate.not_after) else {
        return Check::failed("certificate", "there is none that can be read".to_owned());
    };
    let left = first.not_after.saturating_sub(status.clock);
    let days = left / 86_400_000_000;
    Check::of("certificate", left > 0, || format!("{} {} has ended", first.kind, first.name))
        .warn(left < ENDING_US, || format!("{} {} ends in {days} days", first.kind, first.name))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1::CertificateStatus;

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
            block_time: 100 * DAY,
            certificates: vec![certificate],
            ..StatusResponse::default()
        }
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
            ("certificate", &|s| s.clock = 501 * DAY, "node Org1/node1 has ended"),
            ("certificate", &|s| s.certificates.clear(), "there is none"),
            ("disk", &|s| s.disk_accepts = "ends".into(), "accepted: ends"),
            ("clock", &|s| s.block_time += 9_000_000, "9 s ahead"),
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
    fn what_is_near_its_end_is_told_while_the_node_is_ready() {
        let near = StatusResponse { voters_connected: 2, disk_free_bytes: 9, clock: 480 * DAY, ..status() };
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
