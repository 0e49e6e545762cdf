//! The health of a network: voters, disks, certificates; in words for people, and as an exit code for monitoring.

use crate::failure::Failure;
use crate::output::printable;
use crate::time;
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::{self, Write};

/// Exit code where something needs attention.
const EXIT_ATTENTION: u8 = 1;
/// Exit code without a quorum.
const EXIT_NO_QUORUM: u8 = 4;
/// A disk needs attention below one part in so many.
const DISK_LOW_PART: u64 = 10;
/// A certificate that renews itself needs attention in the last part of its life, one in so many: it should be renewed.
const LIFE_PART: u64 = 6;
/// The same, at most so long before its end, microseconds: 30 days.
const ENDING_US: u64 = 30 * 86_400_000_000;
/// A CA needs attention so long before its end, microseconds: a new one needs time to reach everybody. 180 days.
const CA_ENDING_US: u64 = 180 * 86_400_000_000;
/// The clock of a node's machine is wrong so far behind block time, microseconds: robots refuse messages then.
const CLOCK_LATE_US: u64 = 5_000_000;

/// For monitoring.
#[derive(Debug, clap::Args)]
pub(crate) struct Check {
    /// For monitoring: end with 0 if all is well, with 1 if something needs attention
    ///
    /// A node needs attention that is silent, lacks blocks or differs. So do a clock behind block time, a disk of which less
    /// than a tenth is free, and a certificate near its end. Without a quorum the exit code is 4 with and without this.
    #[arg(long)]
    check: bool,
}

impl Check {
    /// The exit code after everything was told.
    pub(crate) fn judge(&self, quorum: bool, attention: &[String]) -> Result<(), Failure> {
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

    /// The point that needs attention, if there is one.
    pub(crate) fn attention(&self) -> Option<String> {
        (self.voters_reachable < self.voters || !self.quorum).then(|| format!("voters: {}", self.text()))
    }
}

/// The point that needs attention where voters of one organisation alone answer, while voters are of several: nothing is certified
/// then. `voters`: the organisation of each, and whether it answers.
pub(crate) fn uncertified<'a>(voters: impl IntoIterator<Item = (&'a str, bool)>) -> Option<String> {
    let (mut answer, mut silent) = (BTreeSet::new(), BTreeSet::new());
    for (organisation, answers) in voters {
        if answers {
            answer.insert(organisation)
        } else {
            silent.insert(organisation)
        };
    }
    let missing: Vec<&str> = silent.difference(&answer).copied().collect();
    let alone = answer.first().filter(|_| answer.len() == 1 && !missing.is_empty())?;
    let missing = missing.join(" or ");
    Some(format!(
        "voters: only those of {alone} answer; without one of {missing} nothing is certified, and robots that move stop"
    ))
}

/// The point that needs attention where a node lacks blocks and fetches them, up to this height; 0 if it follows as usual.
pub(crate) fn lag(node: &str, height: u64, catching_up_to: u64) -> Option<String> {
    (catching_up_to > 0).then(|| format!("{node} lags: it has block {height} and fetches up to {catching_up_to}"))
}

/// Why the clock of a node is wrong, by its own words; empty if it is not.
pub(crate) fn clock_wrong(status: &v1::StatusResponse) -> String {
    let late = status.block_time.saturating_sub(status.wall_clock);
    match status.clock_doubt.is_empty() {
        false => status.clock_doubt.clone(),
        true if late >= CLOCK_LATE_US => format!("block time is {} ahead of its clock", time::span(late)),
        true => String::new(),
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

    /// The point that needs attention, if there is one.
    pub(crate) fn attention(&self, node: &str) -> Option<String> {
        let low = self.free_bytes < self.total_bytes / DISK_LOW_PART || self.accepts != "all";
        low.then(|| format!("disk of {node}: {}", self.text()))
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

    /// The point that needs attention, if there is one.
    pub(crate) fn attention(&self, now: u64) -> Option<String> {
        let life = self.not_after.saturating_sub(self.not_before);
        let most = if self.kind == "ca" { CA_ENDING_US } else { ENDING_US };
        let left = self.not_after.saturating_sub(now);
        // A list is made anew every few days: it is late only once it has ended.
        if self.kind == "list" {
            return (now > self.not_after).then(|| format!("revocation list: {}", self.text(now)));
        }
        (left < most.min(life / LIFE_PART)).then(|| format!("certificate: {}", self.text(now)))
    }
}

/// Tells what needs attention, at the end.
pub(crate) fn attention(attention: &[String], out: &mut dyn Write) -> io::Result<()> {
    if !attention.is_empty() {
        writeln!(out)?;
    }
    attention.iter().try_for_each(|what| writeln!(out, "attention: {}", printable(what)))
}

/// A size as people read it.
pub(crate) fn size(bytes: u64) -> String {
    const UNITS: [(u64, &str); 3] = [(30, "GiB"), (20, "MiB"), (10, "KiB")];
    for (shift, unit) in UNITS {
        if bytes >> shift >= 10 {
            return format!("{} {unit}", bytes >> shift);
        }
        if bytes >> shift > 0 {
            let tenths = (bytes >> (shift - 10)) * 10 / 1024;
            return format!("{}.{} {unit}", tenths / 10, tenths % 10);
        }
    }
    format!("{bytes} bytes")
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
        let judged = |check, quorum, attention: &[String]| match (Check { check }).judge(quorum, attention) {
            Ok(()) => 0,
            Err(Failure::Told(exit)) => exit,
            Err(_) => u8::MAX,
        };
        let some = ["voters: 2 of 3 answer".to_owned()];
        assert_eq!([judged(false, true, &[]), judged(true, true, &[])], [0, 0]);
        assert_eq!([judged(false, true, &some), judged(true, true, &some)], [0, 1]);
        assert_eq!([judged(false, false, &[]), judged(true, false, &some)], [4, 4]);
    }

    #[test]
    fn voters_of_one_organisation_alone_need_attention_where_another_one_has_voters() {
        let told = |voters: &[(&'static str, bool)]| uncertified(voters.iter().copied());
        let alone = told(&[("Org1", true), ("Org2", false), ("Org1", true), ("Org3", false)]).unwrap_or_default();
        assert!(alone.contains("only those of Org1 answer; without one of Org2 or Org3"), "{alone}");
        assert_eq!(told(&[("Org1", true), ("Org2", true), ("Org3", false)]), None);
        assert_eq!(told(&[("Org1", true), ("Org1", false)]), None, "there are no others");
        assert_eq!(told(&[("Org1", false), ("Org2", false)]), None, "that is another matter");
    }

    #[test]
    fn a_clock_is_wrong_that_is_behind_block_time_or_that_its_node_doubts() {
        let told = |wall_clock, block_time, doubt: &str| {
            let clock_doubt = doubt.to_owned();
            clock_wrong(&v1::StatusResponse { wall_clock, block_time, clock_doubt, ..Default::default() })
        };
        assert_eq!(told(DAY, DAY + CLOCK_LATE_US - 1, ""), "");
        assert_eq!(told(DAY, DAY + 9_000_000, ""), "block time is 9 s ahead of its clock");
        assert_eq!(told(DAY, DAY, "it has jumped ahead"), "it has jumped ahead");
        assert_eq!(told(DAY, 0, ""), "", "no block yet");
    }

    #[test]
    fn a_single_voter_that_answers_needs_no_attention() {
        assert_eq!(Voters::new(1, 1, true).attention(), None);
        assert_eq!(Voters::new(2, 2, true).attention(), None);
        assert!(Voters::new(3, 2, true).attention().is_some());
        assert!(Voters::new(3, 3, false).attention().is_some());
    }

    #[test]
    fn certificates_need_attention_when_they_should_have_been_renewed() {
        let ends_in = |kind: &str, days: u64, life: u64| {
            let now = 20_000 * DAY;
            let (not_after, kind) = (now + days * DAY, kind.to_owned());
            Certificate { kind, name: "n".into(), not_before: not_after - life * DAY, not_after }.attention(now)
        };
        assert!(ends_in("node", 31, 365).is_none() && ends_in("node", 29, 365).is_some());
        assert!(ends_in("own", 2, 10).is_none() && ends_in("own", 1, 10).is_some(), "a short life is renewed late");
        assert!(ends_in("ca", 181, 7300).is_none() && ends_in("ca", 179, 7300).is_some());
        assert!(ends_in("list", 0, 7).is_none(), "a list is late once it has ended");
        let late = Certificate { kind: "list".into(), name: "ca".into(), not_before: 0, not_after: 5 }.attention(6);
        assert!(late.is_some_and(|late| late.contains("(revocation list) ended")));
    }

    #[test]
    fn a_disk_needs_attention_below_a_tenth_with_path_and_numbers() {
        let disk = |free_bytes, accepts: &str| Disk {
            path: "/var/lib/ledgerd".into(),
            free_bytes,
            total_bytes: 20 << 30,
            accepts: accepts.into(),
        };
        assert_eq!(disk(2 << 30, "all").attention("Org1/a"), None);
        let told = disk((1 << 30) + (1 << 29), "all").attention("Org1/a");
        let wanted = "disk of Org1/a: 1.5 GiB (7 %) of 20 GiB free, in /var/lib/ledgerd";
        assert_eq!(told.as_deref(), Some(wanted));
        assert!(disk(3 << 30, "ends").attention("Org1/a").is_some_and(|told| told.contains("only calls that end")));
    }
}
