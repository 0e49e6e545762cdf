//! The health of a network: voters, disks, certificates; in words for people, and as an exit code for monitoring.

use crate::failure::Failure;
use crate::output::printable;
use crate::time;
use ledger_api::context::warning_due;
use ledger_api::v1;
use ledger_base::units::size;
use serde::Serialize;
use std::io::{self, Write};

/// Exit code where something needs attention.
const EXIT_ATTENTION: u8 = 1;
/// Exit code without a quorum.
const EXIT_NO_QUORUM: u8 = 4;
/// It keeps somebody from something.
pub(crate) const CRITICAL: &str = "critical";
/// It may soon do so.
const WARNING: &str = "warning";

/// For monitoring.
#[derive(Debug, clap::Args)]
pub(crate) struct Check {
    /// For monitoring: end with 0 if all is well, with 1 if something needs attention
    ///
    /// Each node lists what needs attention: docs/metrics.md has the table. So do a node that does not answer, and your own
    /// certificate near its end. Without a quorum the exit code is 4 with and without this.
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
    failures_tolerated: u64,
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
            return text + "; no leader is known";
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

/// The disk of a node's data directory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Disk {
    path: String,
    free_bytes: u64,
    total_bytes: u64,
    /// all, ends or nothing.
    accepts: String,
}

impl Disk {
    /// The report of a node about it; none if it is older than that.
    pub(crate) fn of(status: &v1::StatusResponse) -> Option<Self> {
        let (free_bytes, total_bytes) = (status.disk_free_bytes, status.disk_total_bytes);
        let (path, accepts) = (status.data_directory.clone(), status.disk_accepts.clone());
        (total_bytes > 0).then_some(Self { path, free_bytes, total_bytes, accepts })
    }

    /// How much is free, for a column.
    pub(crate) fn free(&self) -> String {
        format!("{} ({} %)", size(self.free_bytes), self.free_bytes.saturating_mul(100) / self.total_bytes.max(1))
    }

    /// In one line.
    pub(crate) fn text(&self) -> String {
        let text = format!("{} of {} free, in {}", self.free(), size(self.total_bytes), self.path);
        match self.accepts.as_str() {
            "ends" => text + "; only calls that end control are accepted",
            "nothing" => text + "; nothing is accepted",
            _ => text,
        }
    }
}

/// A certificate and its life.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(crate) struct Certificate {
    /// node, ca, own or list.
    pub(crate) kind: String,
    pub(crate) name: String,
    not_before: u64,
    not_after: u64,
}

impl Certificate {
    /// Those that a node depends on.
    pub(crate) fn of(status: &v1::StatusResponse) -> Vec<Self> {
        let of = |found: &v1::CertificateStatus| Self {
            kind: found.kind.clone(),
            name: found.name.clone(),
            not_before: found.not_before,
            not_after: found.not_after,
        };
        status.certificates.iter().map(of).collect()
    }

    /// That of whoever asks.
    pub(crate) fn own(identity: &ledger_identity::Identity) -> Self {
        let (not_before, not_after) = (identity.not_before, identity.not_after);
        Self { kind: "own".to_owned(), name: identity.id(), not_before, not_after }
    }

    /// How long it is good for.
    pub(crate) fn ends(&self, now: u64) -> String {
        match now > self.not_after {
            true => format!("ended {}", time::relative(self.not_after, now)),
            false => format!("ends {}", time::relative(self.not_after, now)),
        }
    }

    /// In one line.
    pub(crate) fn text(&self, now: u64) -> String {
        let what = match self.kind.as_str() {
            "ca" => " (CA)",
            "own" => " (yours)",
            "list" => " (revocation list)",
            _ => "",
        };
        format!("{}{what} {}, {}", self.name, self.ends(now), time::moment(self.not_after))
    }

    /// Is it time to look after it? For the certificate of whoever asks: nodes judge theirs themselves.
    pub(crate) fn is_ending(&self, now: u64) -> bool {
        now >= warning_due(self.not_before, self.not_after)
    }
}

/// Something that needs attention: what a node reports of itself, or what is seen from here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Attention {
    /// Full names of the nodes that report it; none for what is seen from here.
    nodes: Vec<String>,
    /// What was checked, such as `disk`.
    pub(crate) check: String,
    severity: String,
    /// What is found, in one line.
    pub(crate) message: String,
    /// What to do next.
    pub(crate) next: String,
}

impl Attention {
    /// Something that is seen from here.
    pub(crate) fn here(check: &str, severity: &str, message: String, next: impl Into<String>) -> Self {
        Self { nodes: Vec::new(), check: check.to_owned(), severity: severity.to_owned(), message, next: next.into() }
    }

    /// What a node reports of itself.
    pub(crate) fn of(status: &v1::StatusResponse) -> Vec<Self> {
        let name = format!("{}/{}", status.organisation, status.node_name);
        let of = |item: &v1::Attention| Self {
            nodes: vec![name.clone()],
            check: item.check.clone(),
            severity: item.severity.clone(),
            message: item.message.clone(),
            next: item.next.clone(),
        };
        status.attention.iter().map(of).collect()
    }

    /// Adds items to a list: what several nodes report alike stands there once, with their names.
    pub(crate) fn add(list: &mut Vec<Self>, more: impl IntoIterator<Item = Self>) {
        for item in more {
            match list.iter_mut().find(|known| known.check == item.check && known.message == item.message) {
                Some(known) => known.nodes.extend(item.nodes),
                None => list.push(item),
            }
        }
    }

    /// The own certificate near its end, or after it.
    pub(crate) fn own_certificate(own: &Certificate, now: u64) -> Option<Self> {
        let severity = if now > own.not_after { CRITICAL } else { WARNING };
        own.is_ending(now).then(|| Self::here("certificate", severity, own.text(now), "ledgerctl identity renew"))
    }

    /// Does it keep somebody from something now?
    pub(crate) fn is_critical(&self) -> bool {
        self.severity != WARNING
    }

    /// Does this node report it?
    pub(crate) fn is_of(&self, node: &str) -> bool {
        self.nodes.iter().any(|name| name == node)
    }

    /// Is it about whoever asks?
    pub(crate) fn is_own(&self) -> bool {
        self.nodes.is_empty() && self.check == "certificate"
    }

    /// In one line.
    pub(crate) fn text(&self) -> String {
        let nodes = self.nodes.join(", ");
        if nodes.is_empty() { self.message.clone() } else { format!("{nodes}: {}", self.message) }
    }
}

/// Prints what needs attention, at the end.
pub(crate) fn print_attention(attention: &[Attention], out: &mut dyn Write) -> io::Result<()> {
    if !attention.is_empty() {
        writeln!(out)?;
    }
    attention.iter().try_for_each(|item| {
        writeln!(out, "attention: {}", printable(&item.text()))?;
        writeln!(out, "  try      {}", printable(&item.next))
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
        assert_eq!(told(3, 2, false), "2 of 3 answer; no leader is known");
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
        let found = |days: u64, life: u64| {
            let not_after = 20_000 * DAY + days * DAY;
            let own =
                Certificate { kind: "own".into(), name: "n".into(), not_before: not_after - life * DAY, not_after };
            Attention::own_certificate(&own, 20_000 * DAY).map(|item| item.is_critical())
        };
        assert_eq!([found(31, 365), found(29, 365)], [None, Some(false)]);
        assert_eq!([found(4, 10), found(3, 10)], [None, Some(false)], "a short life is renewed late");
        let ended = Certificate { kind: "own".into(), name: "n".into(), not_before: 0, not_after: 5 };
        assert!(Attention::own_certificate(&ended, 6).is_some_and(|item| item.is_critical()));
    }

    #[test]
    fn a_disk_is_printed_with_path_and_numbers() {
        let disk = |accepts: &str| Disk {
            path: "/var/lib/ledgerd".into(),
            free_bytes: (1 << 30) + (1 << 29),
            total_bytes: 20 << 30,
            accepts: accepts.into(),
        };
        assert_eq!(disk("all").text(), "1.5 GiB (7 %) of 20 GiB free, in /var/lib/ledgerd");
        assert!(disk("ends").text().ends_with("; only calls that end control are accepted"));
    }
}
