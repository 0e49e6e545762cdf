//! The parts of a bridge's readiness.

use crate::clients::monitoring::check::Check;
use ledger_base::rejection::{Class, Rejection};
use ros_bridge::{BridgeStatus, BridgeView, RouteView};
use ros_bridge::{Level, Status};

/// All parts, by what is seen of the bridge.
pub(super) fn all(view: &BridgeView) -> Vec<Check> {
    match view {
        BridgeView::Waits(None) => vec![Check::failed("graph", "the bridge has not started yet".to_owned())],
        BridgeView::Waits(Some(reason)) => waiting(reason),
        BridgeView::Runs(standing) => running(standing),
    }
}

/// Of a bridge that waits no more is known than why.
fn waiting(reason: &Rejection) -> Vec<Check> {
    let reached = Check::of("ledger", reason.code.class() != Class::Unreachable, || in_line(reason));
    vec![reached, Check::failed("graph", format!("not joined: {}", in_line(reason)))]
}

fn in_line(reason: &Rejection) -> String {
    let Rejection { code, message, found, .. } = reason;
    let found = if found.is_empty() { String::new() } else { format!("; found {found}") };
    format!("{code} {message}{found}")
}

fn running(standing: &BridgeStatus) -> Vec<Check> {
    let graph = Check::ok("graph");
    let parts = standing.statuses.iter().map(part);
    let grant = standing.routes.iter().any(|route| route.takes_in && route.needs_grant).then(|| grant(standing));
    parts.chain([graph]).chain(grant).collect()
}

/// The ledger, or a route.
fn part(status: &Status) -> Check {
    let Status { level, name, message, .. } = status;
    let is_ok = matches!(level, Level::Ok | Level::Warn);
    Check::of(name.clone(), is_ok, || message.clone()).warn(*level == Level::Warn, || message.clone())
}

/// Does the bridge hold what it takes commands to? Nobody has to, so it is ready without.
fn grant(standing: &BridgeStatus) -> Check {
    let lacks = |route: &&RouteView| route.takes_in && route.needs_grant && !route.is_held;
    let missing: Vec<&str> = standing.routes.iter().filter(lacks).map(|route| &*route.summary.service).collect();
    Check::ok("grant")
        .warn(!missing.is_empty(), || format!("{} does not hold {}", standing.identity, missing.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::rejection::Code;

    fn told(view: &BridgeView) -> String {
        all(view).iter().map(ToString::to_string).collect()
    }

    fn standing(statuses: Vec<Status>) -> BridgeView {
        let identity = "Org1/Salma".to_owned();
        BridgeView::Runs(BridgeStatus { identity, domain: 1, silent: None, statuses, routes: Vec::new() })
    }

    fn status(level: Level, name: &str, message: &str) -> Status {
        Status { level, name: name.to_owned(), message: message.to_owned(), values: Vec::new() }
    }

    #[test]
    fn a_bridge_that_waits_says_why_and_whether_the_ledger_answers() {
        assert_eq!(told(&BridgeView::Waits(None)), "[-] graph failed: the bridge has not started yet\n");
        let silent = Rejection::new(Code::Unreachable, "no node answers").found("10.0.0.4:7450 refuses");
        let said = told(&BridgeView::Waits(Some(silent)));
        assert!(said.starts_with("[-] ledger failed: LGR-"), "{said}");
        assert!(said.contains("\n[-] graph failed: not joined: LGR-") && said.contains("; found 10.0.0.4"), "{said}");
        let unknown = Rejection::new(Code::UnknownRobot, "there is no robot Rover");
        assert!(told(&BridgeView::Waits(Some(unknown))).starts_with("[+] ledger ok\n[-] graph failed: "));
    }

    #[test]
    fn each_level_of_diagnostics_is_one_of_readiness() {
        let statuses = vec![
            status(Level::Ok, "ledger", "connected"),
            status(Level::Ok, "R/a to_ledger", "silent: nobody publishes on /a"),
            status(Level::Warn, "R/b to_ledger", "silent: refused"),
            status(Level::Error, "R/c to_ledger", "waits: no such service"),
            status(Level::Stale, "R/d to_ledger", "the ledger gives no sign of life"),
        ];
        let said = told(&standing(statuses));
        assert_eq!(
            said.lines().collect::<Vec<_>>(),
            [
                "[+] ledger ok",
                "[+] R/a to_ledger ok",
                "[+] R/b to_ledger ok, but silent: refused",
                "[-] R/c to_ledger failed: waits: no such service",
                "[-] R/d to_ledger failed: the ledger gives no sign of life",
                "[+] graph ok",
            ]
        );
    }
}
