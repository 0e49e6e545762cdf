//! A node as its page shows it, with the bridge that may run inside.

mod metrics;

use super::bridge;
use super::check::Check;
use super::{Watched, is_well};
use crate::clients::attention::CHECKS;
use crate::clients::gateway::Description;
use ledger_api::facts::{CRITICAL, CertificateRuleFacts};
use ledger_api::v1::{Attention, StatusResponse};
use ledger_base::rejection::Rejection;
use prometheus_client::registry::Registry;
use ros_bridge::BridgeMonitor;
use std::sync::Arc;

/// A node, for its page.
pub(crate) struct WatchedNode {
    /// The node.
    pub(crate) node: Arc<Description>,
    /// The bridge inside, if it has one: its figures are there, too. Whether the node is ready does not depend on it.
    pub(crate) bridge: Option<BridgeMonitor>,
}

impl Watched for WatchedNode {
    fn checks(&self) -> Vec<Check> {
        checks(&self.node)
    }

    fn register(&self, registry: &mut Registry) -> Result<(), Rejection> {
        metrics::register(
            registry,
            &self.node.status()?,
            &self.node.ordering.meters,
            self.node.ordering.idle_control.held(),
        );
        if let Some(bridge) = &self.bridge {
            bridge::register(registry, &bridge.look());
        }
        Ok(())
    }
}

fn checks(node: &Description) -> Vec<Check> {
    match node.status() {
        Ok(status) => {
            let note = |name| (name == "quorum").then(|| survived(&status)).flatten();
            CHECKS.into_iter().map(|name| check(name, &status.attention).note(note(name))).collect()
        }
        Err(fault) => vec![Check::failed("state", fault.to_string())],
    }
}

/// The faults that the voters survive, in words.
fn survived(status: &StatusResponse) -> Option<String> {
    let rule = CertificateRuleFacts::from(status.certificate_rule?);
    Some(format!("{}; the voters survive {}", rule.rule(), rule.survives()))
}

/// A line of `/readyz`, of what needs attention.
fn check(name: &'static str, attention: &[Attention]) -> Check {
    let reasons = |is_critical: bool| {
        let of = attention.iter().filter(|item| item.check == name && (item.severity == CRITICAL) == is_critical);
        of.map(|item| &*item.message).collect::<Vec<_>>().join("; ")
    };
    let (failed, warnings) = (reasons(true), reasons(false));
    Check::of(name, failed.is_empty(), || failed).warn(!warnings.is_empty(), || warnings)
}

/// Can the node do its work?
pub(crate) fn is_ready(node: &Description) -> bool {
    is_well(&checks(node))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_api::facts::WARNING;
    use ledger_api::v1::CertificateRule;

    #[test]
    fn a_check_fails_by_what_is_critical_and_warns_of_the_rest() {
        let item = |check: &str, severity: &str, message: &str| Attention {
            check: check.into(),
            severity: severity.into(),
            message: message.into(),
            next: String::new(),
        };
        let all = [
            item("certificate", WARNING, "one ends soon"),
            item("certificate", WARNING, "another one, too"),
            item("disk", CRITICAL, "it is full"),
            item("disk", WARNING, "it was almost full"),
        ];
        let line = |name| check(name, &all).to_string();
        assert_eq!(line("certificate"), "[+] certificate ok, but one ends soon; another one, too\n");
        assert_eq!(line("disk"), "[-] disk failed: it is full\n");
        assert_eq!(line("log"), "[+] log ok\n");
        let noted = |name| check(name, &all).note(Some("3 of 4".into())).to_string();
        assert_eq!(noted("log"), "[+] log ok: 3 of 4\n");
        assert_eq!(noted("disk"), "[-] disk failed: it is full\n");
    }

    #[test]
    fn the_line_of_the_quorum_says_which_faults_the_voters_survive() {
        let rule = CertificateRule {
            needed: 3,
            strict_since: Some(0),
            survives_crashes: 1,
            survives_lie: true,
            survives_silence: true,
        };
        let status = StatusResponse { certificate_rule: Some(rule), ..StatusResponse::default() };
        let line = "3 signatures, strict since block 0; the voters survive 1 crash, lies of one organisation, silence of one organisation";
        assert_eq!(survived(&status).as_deref(), Some(line));
        assert_eq!(survived(&StatusResponse::default()), None);
    }
}
