//! One row of the audit, for people and programs.

use crate::output::{Facts, Table, printable};
use crate::time;
use ledger_api::facts::AuditFacts;
use serde::Serialize;
use std::io::{self, Write};

impl Facts for AuditFacts {
    /// One line of a stream: its columns keep their places.
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let [who, decision, subject, words] = [self.who.clone(), decided(self), self.subject.clone(), words(self)]
            .map(|cell| printable(&cell).into_owned());
        let times = if self.count > 1 { format!("{} times  ", self.count) } else { String::new() };
        let line =
            format!("{}  {decision:<18}  {subject:<24}  {who:<16}  {times}{words}", time::time_of_day(self.first));
        writeln!(out, "{}", line.trim_end())
    }
}

/// Rows for people.
#[derive(Serialize)]
pub(super) struct Rows(pub(super) Vec<AuditFacts>);

impl Facts for Rows {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no records match");
        }
        let mut table = Table::new(["TIME", "BLOCK", "WHO", "DECISION", "ABOUT", "TIMES", "POLICIES", "DETAIL"]);
        for row in &self.0 {
            table.row([
                time::moment(row.first),
                row.height.to_string(),
                row.who.clone(),
                decided(row),
                row.subject.clone(),
                row.count.to_string(),
                decided_by(row),
                words(row),
            ]);
        }
        table.write(out, 0)
    }
}

/// The set of policies that decided and those of it that did, e.g. `version 3: night, rain`.
fn decided_by(row: &AuditFacts) -> String {
    let version = if row.policy_version == 0 { String::new() } else { format!("version {}", row.policy_version) };
    let parts = [version, row.policies.join(", ")];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(": ")
}

fn decided(row: &AuditFacts) -> String {
    [&row.decision, &row.code].map(String::as_str).join(" ").trim().to_owned()
}

fn words(row: &AuditFacts) -> String {
    let by = if row.by.is_empty() { String::new() } else { format!("by {}", row.by) };
    let epoch = if row.epoch == 0 { String::new() } else { format!("epoch {}", row.epoch) };
    let told = if row.told_by.is_empty() { String::new() } else { format!("reported by {}", row.told_by) };
    let parts = [by, epoch, row.detail.clone(), told];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1::AuditRow;

    #[test]
    fn no_rows_are_said_to_be_none() {
        let mut out = Vec::new();
        Rows(Vec::new()).text(&mut out).unwrap();
        assert_eq!(out, b"no records match\n");
    }

    #[test]
    fn the_lines_of_a_stream_stand_below_each_other() {
        let line = |decision: &str, subject: &str| {
            let row = AuditRow {
                decision: decision.into(),
                subject: subject.into(),
                who: "Org1/Salma".into(),
                ..AuditRow::default()
            };
            let mut out = Vec::new();
            AuditFacts::from(row).text(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        let (short, long) = (line("granted", "T/c"), line("released", "Turtlebot4/cmd_vel"));
        assert_eq!(short.find("Org1/Salma"), long.find("Org1/Salma"));
        assert_eq!(short.lines().count(), 1);
    }
}
