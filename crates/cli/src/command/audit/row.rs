//! One row of the audit, for people and programs.

use crate::output::{Facts, Table, printable};
use crate::time;
use ledger_api::v1::AuditRow;
use serde::Serialize;
use std::io::{self, Write};

/// A decision about control.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    time: u64,
    height: u64,
    decision: String,
    who: String,
    by: String,
    robot: String,
    subject: String,
    /// Empty if nothing was refused.
    code: String,
    count: u64,
    first: u64,
    last: u64,
    last_height: u64,
    epoch: u64,
    policy_version: u64,
    /// Ids of those that decided.
    policies: Vec<String>,
    /// Empty if it is not known, or if policies did not decide.
    action: String,
    detail: String,
    found: String,
    transaction: String,
    told_by: String,
}

impl From<AuditRow> for Row {
    fn from(row: AuditRow) -> Self {
        Self {
            time: row.time,
            height: row.height,
            decision: row.decision,
            who: row.who,
            by: row.by,
            robot: row.robot,
            subject: row.subject,
            code: if row.code == 0 { String::new() } else { format!("LGR-{:04}", row.code) },
            count: row.count,
            first: row.first,
            last: row.last,
            last_height: row.last_height,
            epoch: row.epoch,
            policy_version: row.policy_version,
            policies: row.policies,
            action: row.action,
            detail: row.detail,
            found: row.found,
            transaction: hex::encode(&row.transaction),
            told_by: row.told_by,
        }
    }
}

impl Facts for Row {
    /// One line of a stream: its columns keep their places.
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let [who, decision, subject, words] = [self.who.clone(), self.decided(), self.subject.clone(), self.words()]
            .map(|cell| printable(&cell).into_owned());
        let times = if self.count > 1 { format!("{} times  ", self.count) } else { String::new() };
        let line =
            format!("{}  {decision:<18}  {subject:<24}  {who:<16}  {times}{words}", time::time_of_day(self.first));
        writeln!(out, "{}", line.trim_end())
    }
}

/// Rows for people.
#[derive(Serialize)]
pub(super) struct Rows(pub(super) Vec<Row>);

impl Facts for Rows {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "nothing is known of it");
        }
        let mut table = Table::new(["TIME", "BLOCK", "WHO", "DECISION", "ABOUT", "TIMES", "POLICIES", "DETAIL"]);
        for row in &self.0 {
            table.row([
                time::moment(row.first),
                row.height.to_string(),
                row.who.clone(),
                row.decided(),
                row.subject.clone(),
                row.count.to_string(),
                row.decided_by(),
                row.words(),
            ]);
        }
        table.write(out, 0)
    }
}

impl Row {
    /// The set of policies that decided and those of it that did, e.g. `version 3: night, rain`.
    fn decided_by(&self) -> String {
        let version = if self.policy_version == 0 { String::new() } else { format!("version {}", self.policy_version) };
        let parts = [version, self.policies.join(", ")];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(": ")
    }

    fn decided(&self) -> String {
        [&self.decision, &self.code].map(String::as_str).join(" ").trim().to_owned()
    }

    fn words(&self) -> String {
        let by = if self.by.is_empty() { String::new() } else { format!("by {}", self.by) };
        let epoch = if self.epoch == 0 { String::new() } else { format!("epoch {}", self.epoch) };
        let told = if self.told_by.is_empty() { String::new() } else { format!("told by {}", self.told_by) };
        let parts = [by, epoch, self.detail.clone(), told];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

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
            Row::from(row).text(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        let (short, long) = (line("granted", "T/c"), line("released", "Turtlebot4/cmd_vel"));
        assert_eq!(short.find("Org1/Salma"), long.find("Org1/Salma"));
        assert_eq!(short.lines().count(), 1);
    }
}
