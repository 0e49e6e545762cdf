//! The health of a network: voters, disks, certificates; as text, and as an exit code for monitoring.

use crate::failure::Failure;
use crate::output::printable;
use crate::time;
use ledger_api::context::warning_due;
use ledger_api::facts::{AttentionFacts, CRITICAL, CertificateFacts, DiskFacts, WARNING};
use ledger_api::v1;
use ledger_base::units::size;
use serde::Serialize;
use std::io::{self, Write};

/// Exit code where something needs attention.
const EXIT_ATTENTION: u8 = 1;
/// Exit code without a quorum.
const EXIT_NO_QUORUM: u8 = 4;

/// For monitoring.
#[derive(Debug, clap::Args)]
pub(crate) struct Check {
    /// For monitoring: exit with 0 if there are no conditions to report, and with 1 otherwise
    ///
    /// Each node reports conditions that need attention: docs/operations.md lists them. An unreachable node and your
    /// own certificate close to its expiry are conditions, too. Without a quorum, the exit code is 4 with and without
    /// this option.
    #[arg(long)]
    check: bool,
}

impl Check {
    /// The exit code after everything was told.
    pub(crate) fn judge(&self, quorum: bool, attention: &[Attention]) -> Result<(), Failure> {
        match (quorum, attention.is_empty()) {
            (false, _) => Err(Failure::Told(EXIT_NO_QUORUM)),
            (true, false) if self.check => Err(Failure::Told(EXIT_ATTENTION)),
            _ => Ok(()),
        }
    }
}

/// The voters, and those of them that answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Voters {
    /// How many vote.
    pub(crate) voters: u64,
    /// How many of them answer.
    pub(crate) voters_reachable: u64,
    /// How many more may fail now.
    pub(crate) failures_tolerated: u64,
    /// Can be ordered?
    pub(crate) quorum: bool,
}

impl Voters {
    /// `led`: somebody knows who leads.
    pub(crate) fn new(voters: u64, voters_reachable: u64, led: bool) -> Self {
        let majority = voters / 2 + 1;
        let quorum = led && voters_reachable >= majority;
        Self { voters, voters_reachable, failures_tolerated: voters_reachable.saturating_sub(majority), quorum }
    }

    /// In one line.
    pub(crate) fn text(&self) -> String {
        let Self { voters, voters_reachable, failures_tolerated, quorum } = *self;
        let answer = if voters_reachable == 1 { "answers" } else { "answer" };
        let mut text = format!("{voters_reachable} of {voters} {answer}");
        if !quorum && voters_reachable > voters / 2 {
            return text + "; no leader";
        }
        if !quorum {
            return text + &format!("; {} are needed to order", voters / 2 + 1);
        }
        let count = |count: u64| if count == 0 { "none".to_owned() } else { count.to_string() };
        text += &format!("; failures tolerated: {}", count(failures_tolerated));
        let of_all = voters.saturating_sub(1) / 2;
        if voters_reachable < voters {
            text += &format!(" ({} with all of them)", count(of_all));
        }
        text
    }
}

/// The report of a node about the disk of its data directory; none if it could not measure it.
pub(crate) fn disk(status: &v1::StatusResponse) -> Option<DiskFacts> {
    Some(DiskFacts::from(status)).filter(|disk| disk.total_bytes > 0)
}

/// How much of a disk is free, for a column.
pub(crate) fn disk_free(disk: &DiskFacts) -> String {
    format!("{} ({} %)", size(disk.free_bytes), disk.free_bytes.saturating_mul(100) / disk.total_bytes.max(1))
}

/// A disk in one line; nothing if the node could not measure it.
pub(crate) fn disk_text(disk: &DiskFacts) -> String {
    if disk.total_bytes == 0 {
        return String::new();
    }
    let text = format!("{} of {} free, in {}", disk_free(disk), size(disk.total_bytes), disk.path);
    match disk.accepts.as_str() {
        "ends" => text + "; only calls that end control are accepted",
        "nothing" => text + "; nothing is accepted",
        _ => text,
    }
}

/// The certificates and lists that a node depends on.
pub(crate) fn certificates(status: &v1::StatusResponse) -> Vec<CertificateFacts> {
    status.certificates.iter().cloned().map(CertificateFacts::from).collect()
}

/// The own certificate.
pub(crate) fn own_certificate(identity: &ledger_identity::Identity) -> CertificateFacts {
    let (not_before, not_after) = (identity.not_before, identity.not_after);
    v1::CertificateStatus { kind: "own".to_owned(), name: identity.id(), not_before, not_after }.into()
}

/// How long a certificate is valid.
pub(crate) fn certificate_ends(certificate: &CertificateFacts, now: u64) -> String {
    let verb = if now > certificate.not_after { "ended" } else { "ends" };
    format!("{verb} {}", time::relative(certificate.not_after, now))
}

/// A certificate in one line.
pub(crate) fn certificate_text(certificate: &CertificateFacts, now: u64) -> String {
    let what = match certificate.kind.as_str() {
        "ca" => " (CA)",
        "own" => " (yours)",
        "list" => " (revocation list)",
        _ => "",
    };
    let ends = certificate_ends(certificate, now);
    format!("{}{what} {ends}, {}", certificate.name, time::moment(certificate.not_after))
}

/// Is the own certificate due for renewal? Nodes judge theirs themselves.
pub(crate) fn is_ending(own: &CertificateFacts, now: u64) -> bool {
    now >= warning_due(own.not_before, own.not_after)
}

/// Something that needs attention: what a node reports of itself, or what is seen from here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Attention {
    /// Full names of the nodes that report it; none for what is seen from here.
    nodes: Vec<String>,
    #[serde(flatten)]
    pub(crate) facts: AttentionFacts,
}

impl Attention {
    /// Something that is seen from here.
    pub(crate) fn here(check: &str, severity: &str, message: String, next: impl Into<String>) -> Self {
        let (check, severity) = (check.to_owned(), severity.to_owned());
        Self { nodes: Vec::new(), facts: AttentionFacts { check, severity, message, next: next.into() } }
    }

    /// Problems that a node reports.
    pub(crate) fn of(status: &v1::StatusResponse) -> Vec<Self> {
        let name = format!("{}/{}", status.organisation, status.node_name);
        let of = |facts: AttentionFacts| Self { nodes: vec![name.clone()], facts };
        status.attention.iter().cloned().map(AttentionFacts::from).map(of).collect()
    }

    /// Adds items to a list: what several nodes report alike stands there once, with their names.
    pub(crate) fn add(list: &mut Vec<Self>, more: impl IntoIterator<Item = Self>) {
        for found in more {
            let is_alike = |known: &&mut Self| {
                known.facts.check == found.facts.check && known.facts.message == found.facts.message
            };
            match list.iter_mut().find(is_alike) {
                Some(known) => known.nodes.extend(found.nodes),
                None => list.push(found),
            }
        }
    }

    /// The own certificate near its end, or after it.
    pub(crate) fn own_certificate(own: &CertificateFacts, now: u64) -> Option<Self> {
        let severity = if now > own.not_after { CRITICAL } else { WARNING };
        is_ending(own, now)
            .then(|| Self::here("certificate", severity, certificate_text(own, now), "ledgerctl identity renew"))
    }

    /// Does something not work because of it?
    pub(crate) fn is_critical(&self) -> bool {
        self.facts.severity != WARNING
    }

    /// Does this node report it?
    pub(crate) fn is_of(&self, node: &str) -> bool {
        self.nodes.iter().any(|name| name == node)
    }

    /// Is it about the caller's own certificate?
    pub(crate) fn is_own(&self) -> bool {
        self.nodes.is_empty() && self.facts.check == "certificate"
    }

    /// In one line.
    pub(crate) fn text(&self) -> String {
        let nodes = self.nodes.join(", ");
        if nodes.is_empty() { self.facts.message.clone() } else { format!("{nodes}: {}", self.facts.message) }
    }
}

/// Prints what needs attention, at the end.
pub(crate) fn print_attention(attention: &[Attention], out: &mut dyn Write) -> io::Result<()> {
    if !attention.is_empty() {
        writeln!(out)?;
    }
    attention.iter().try_for_each(|item| {
        writeln!(out, "attention: {}", printable(&item.text()))?;
        writeln!(out, "  try      {}", printable(&item.facts.next))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: u64 = 86_400_000_000;

    #[test]
    fn how_many_may_fail_is_told_in_numbers() {
        let told = |voters, answer, led| Voters::new(voters, answer, led).text();
        assert_eq!(told(1, 1, true), "1 of 1 answers; failures tolerated: none");
        assert_eq!(told(2, 2, true), "2 of 2 answer; failures tolerated: none");
        assert_eq!(told(3, 3, true), "3 of 3 answer; failures tolerated: 1");
        assert_eq!(told(3, 2, true), "2 of 3 answer; failures tolerated: none (1 with all of them)");
        assert_eq!(told(3, 1, false), "1 of 3 answers; 2 are needed to order");
        assert_eq!(told(3, 2, false), "2 of 3 answer; no leader");
        assert_eq!(told(5, 5, true), "5 of 5 answer; failures tolerated: 2");
    }

    #[test]
    fn exit_codes_are_for_monitoring() {
        let judged = |check, quorum, attention: &[Attention]| match (Check { check }).judge(quorum, attention) {
            Ok(()) => 0,
            Err(Failure::Told(exit)) => exit,
            Err(_) => u8::MAX,
        };
        let some = [Attention::here("disk", WARNING, "it is almost full".to_owned(), "make room")];
        assert_eq!([judged(false, true, &[]), judged(true, true, &[])], [0, 0]);
        assert_eq!([judged(false, true, &some), judged(true, true, &some)], [0, 1]);
        assert_eq!([judged(false, false, &[]), judged(true, false, &some)], [4, 4]);
    }

    #[test]
    fn what_several_nodes_report_alike_stands_there_once() {
        let reports = |name: &str, messages: &[&str]| {
            let item = |message: &&str| v1::Attention {
                check: "quorum".into(),
                severity: "warning".into(),
                message: (*message).into(),
                next: "wait".into(),
            };
            let attention = messages.iter().map(item).collect();
            v1::StatusResponse { organisation: "Org1".into(), node_name: name.into(), attention, ..Default::default() }
        };
        let mut list = Vec::new();
        for status in [reports("a", &["2 of 3"]), reports("b", &["2 of 3", "it is late"])] {
            Attention::add(&mut list, Attention::of(&status));
        }
        let texts: Vec<String> = list.iter().map(Attention::text).collect();
        assert_eq!(texts, ["Org1/a, Org1/b: 2 of 3", "Org1/b: it is late"]);
        assert!(list.iter().all(|item| item.is_of("Org1/b") && !item.is_critical()));
        let mut out = Vec::new();
        assert!(print_attention(&list, &mut out).is_ok());
        let printed =
            "\nattention: Org1/a, Org1/b: 2 of 3\n  try      wait\nattention: Org1/b: it is late\n  try      wait\n";
        assert_eq!(String::from_utf8_lossy(&out), printed);
    }

    #[test]
    fn an_own_certificate_needs_attention_a_month_before_its_end_once_its_renewal_is_due() {
        let own = |not_before, not_after| {
            CertificateFacts::from(v1::CertificateStatus {
                kind: "own".into(),
                name: "n".into(),
                not_before,
                not_after,
            })
        };
        let found = |days: u64, life: u64| {
            let not_after = 20_000 * DAY + days * DAY;
            let own = own(not_after - life * DAY, not_after);
            Attention::own_certificate(&own, 20_000 * DAY).map(|item| item.is_critical())
        };
        assert_eq!([found(31, 365), found(29, 365)], [None, Some(false)]);
        assert_eq!([found(4, 10), found(3, 10)], [None, Some(false)], "a short life is renewed late");
        assert!(Attention::own_certificate(&own(0, 5), 6).is_some_and(|item| item.is_critical()));
    }

    #[test]
    fn a_disk_is_printed_with_path_and_numbers() {
        let disk = |accepts: &str| DiskFacts {
            path: "/var/lib/ledgerd".into(),
            free_bytes: (1 << 30) + (1 << 29),
            total_bytes: 20 << 30,
            accepts: accepts.into(),
        };
        assert_eq!(disk_text(&disk("all")), "1.5 GiB (7 %) of 20 GiB free, in /var/lib/ledgerd");
        assert!(disk_text(&disk("ends")).ends_with("; only calls that end control are accepted"));
    }
}
