//! `policy diff`: the grants that a set of policies would end, and the decisions of the past that it would change.

use super::recorded::{Compared, compare};
use super::rights::changes;
use crate::answer;
use crate::argument::{number, policies};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, printable};
use crate::session::{self, ABAC, Session};
use crate::time;
use ledger_contract::{PolicyDiff, WouldEnd};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Show which current grants the policies in files would end.
///
/// The files are taken as the complete set of your organisation, each policy with the name of its file. Nothing is
/// changed. With `--decisions`, it also evaluates decisions of the last week again, as `ledgerctl policy shadow` does.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl policy diff night.cedar guests.cedar
  ledgerctl policy diff night.cedar --decisions 100")]
pub(crate) struct Diff {
    /// Files with policies in Cedar
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Also show which of the last N recorded decisions would change
    #[arg(long, value_name = "N", value_parser = number::count)]
    decisions: Option<u64>,
}

/// Decisions of this time are asked about again, microseconds.
const WEEK: u64 = 7 * 86_400_000_000;

impl Diff {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let policies = policies::read(&self.files)?.unwrap_or_default();
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "diff", vec![session::argument(&policies)?]).await?;
        let diff = answer::parse(&response, "a difference of policies")?;
        let recorded = match self.decisions {
            Some(most) => Some(compare(&session, policies, time::now().saturating_sub(WEEK), most).await?),
            None => None,
        };
        output.show(&Told { diff, recorded })
    }
}

#[derive(Serialize)]
struct Told {
    #[serde(flatten)]
    diff: PolicyDiff,
    #[serde(skip_serializing_if = "Option::is_none")]
    recorded: Option<Compared>,
}

impl Facts for Told {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let PolicyDiff { organisation, added, changed, removed, grants, ends, ended, unreachable, .. } = &self.diff;
        for (what, ids) in [("added", added), ("changed", changed), ("removed", removed)] {
            if !ids.is_empty() {
                writeln!(out, "{what}: {}", printable(&ids.join(", ")))?;
            }
        }
        writeln!(out, "grants of robots of {organisation} that this set would end: {ended} of {grants}")?;
        for WouldEnd { service, holder, epoch, reason, found, wanted } in ends {
            writeln!(out, "  {service}, held by {} (epoch {epoch}): {}", printable(holder), printable(reason))?;
            writeln!(out, "    found {}; wanted {}", printable(found), printable(wanted))?;
        }
        for robot in unreachable {
            writeln!(out, "no known identity could publish to {} any more", printable(robot))?;
        }
        changes(out, &PolicyDiff { ends: Vec::new(), unreachable: Vec::new(), ..self.diff.clone() })?;
        self.recorded.as_ref().map_or(Ok(()), |recorded| recorded.text(out))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn what_changes_and_what_would_end_is_told() {
        let end = WouldEnd {
            service: "Husky/cmd_vel".into(),
            holder: "Org1/Salma".into(),
            epoch: 3,
            reason: "no policy of Org2 permits it".into(),
            found: "principal.role is \"member\"".into(),
            wanted: "principal.role == \"admin\"".into(),
        };
        let diff = PolicyDiff {
            organisation: "Org2".into(),
            added: vec!["night".into()],
            changed: vec![],
            removed: vec!["day".into(), "noon".into()],
            grants: 2,
            ends: vec![end],
            ended: 1,
            unreachable: vec!["Husky".into()],
            ..PolicyDiff::default()
        };
        let mut out = Vec::new();
        Told { diff, recorded: None }.text(&mut out).unwrap();
        let wanted = "added: night\nremoved: day, noon\ngrants of robots of Org2 that this set would end: 1 of 2\n  \
                      Husky/cmd_vel, held by Org1/Salma (epoch 3): no policy of Org2 permits it\n    \
                      found principal.role is \"member\"; wanted principal.role == \"admin\"\n\
                      no known identity could publish to Husky any more\n\
                      no listed identity gains or loses permissions\n";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
    }
}
