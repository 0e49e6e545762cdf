//! `confirm`, and the answer to a contender whom others must confirm first.

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger_api::Committed;
use ledger_base::rejection::Class;
use ledger_contract::{Acquired, Confirmation, Pending};
use serde::Serialize;
use std::io::{self, Write};

/// Confirm a contender for a service whose owner requires confirmations.
///
/// For admins of the robot's owner, identities with the attribute safety=true of organisations that the owner trusts,
/// and identities to which its policies permit `confirm`. A contender cannot confirm itself.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl confirm Turtlebot4/cmd_vel Org1/Salma")]
pub(crate) struct Confirm {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// The contender
    #[arg(value_name = "ORG/NAME")]
    contender: String,
}

const WORDS: Words = Words { arguments: &[("CONTENDER", "ORG/NAME")], help: "ledgerctl confirm" };

/// The answer, and the transaction that it came with.
#[derive(Serialize)]
struct Confirmed {
    #[serde(flatten)]
    answer: Confirmation,
    time: u64,
    height: u64,
    transaction: ledger_base::hash::Hash,
}

impl Facts for Confirmed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Confirmation { pending, acquired, refused } = &self.answer;
        let Pending { service, contender, .. } = pending;
        writeln!(out, "{contender} is confirmed by {}", state(pending))?;
        match acquired {
            Some(Acquired::Granted(grant)) => writeln!(out, "{contender} holds {service} with epoch {}", grant.epoch),
            Some(Acquired::Queued { queued }) => {
                writeln!(out, "{contender} waits in the queue, position {}", queued.position)
            }
            Some(Acquired::Pending { .. }) | None if refused.is_empty() => Ok(()),
            Some(Acquired::Pending { .. }) | None => {
                writeln!(out, "{service} cannot be granted yet: {refused}")?;
                writeln!(out, "the confirmations expire {}", time::relative(pending.until, self.time))
            }
        }
    }
}

/// `Org2/admin (1 of 2)`.
pub(super) fn state(pending: &Pending) -> String {
    let Pending { confirmed, wanted, .. } = pending;
    let names = if confirmed.is_empty() { "none".to_owned() } else { confirmed.join(", ") };
    format!("{names} ({} of {wanted})", confirmed.len())
}

impl Confirm {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let args = vec![Bytes::from(self.service), Bytes::from(self.contender)];
        let done = session.call(ABAC, "confirm", args).await.map_err(|refused| WORDS.told(refused))?;
        let Committed { id, height, time, response, .. } = done;
        let answer = answer::parse(&response, "a confirmation")?;
        output.show(&Confirmed { answer, time, height, transaction: id })
    }
}

/// A contender that waits to be confirmed, and the transaction by which it asked.
#[derive(Serialize)]
struct Asked<'a> {
    pending: Pending,
    time: u64,
    height: u64,
    transaction: &'a ledger_base::hash::Hash,
}

impl Facts for Asked<'_> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Pending { service, contender, wanted, owner, until, .. } = &self.pending;
        let missing = wanted.saturating_sub(self.pending.confirmed.len() as u64);
        let noun = if missing == 1 { "confirmation" } else { "confirmations" };
        writeln!(out, "{service} is not acquired yet: waiting for {missing} {noun}")?;
        let mut table = Table::pairs();
        table.pair("confirmed", state(&self.pending));
        table.pair("until", format!("{} ({})", time::moment(*until), time::relative(*until, self.time)));
        table.pair("by", format!("admins of {owner}, and identities to which its policies permit `confirm`"));
        table.write(out, 2)?;
        writeln!(out, "to confirm: ledgerctl confirm {service} {contender}")?;
        writeln!(
            out,
            "to wait: ledgerctl acquire {service} --wait 5m; to withdraw the request: ledgerctl release {service}"
        )
    }
}

/// Tells a caller who does not wait that others must confirm it. It has no grant, and the exit code says so.
pub(super) fn asked(pending: Pending, done: &Committed, output: &mut Output) -> Result<(), Failure> {
    output.show(&Asked { pending, time: done.time, height: done.height, transaction: &done.id })?;
    Err(Failure::Told(Class::Conflict.exit_code()))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn asked(wanted: u64, confirmed: &[&str]) -> String {
        let json = serde_json::json!({"service": "Turtlebot4/cmd_vel", "contender": "Org1/Salma", "confirmed": confirmed,
            "wanted": wanted, "owner": "Org2", "until": 61_000_000});
        let pending = serde_json::from_value(json).unwrap();
        let asked = Asked { pending, time: 1_000_000, height: 1, transaction: &ledger_base::hash::Hash::ZERO };
        let mut out = Vec::new();
        asked.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_contender_reads_how_many_confirmations_are_missing() {
        assert!(asked(1, &[]).starts_with("Turtlebot4/cmd_vel is not acquired yet: waiting for 1 confirmation\n"));
        assert!(
            asked(3, &["Org2/Admin"])
                .starts_with("Turtlebot4/cmd_vel is not acquired yet: waiting for 2 confirmations\n")
        );
    }
}
