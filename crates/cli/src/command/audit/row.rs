//! One row of the audit, for people and programs.

use crate::output::{Facts, Table};
use crate::time;
use ledger_api::v1::AuditRow;
use serde::Serialize;
use std::io::{self, Write};

/// A decision about control.
#[derive(Clone, Debug, Serialize)]
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
            detail: row.detail,
            found: row.found,
            transaction: hex::encode(&row.transaction),
            told_by: row.told_by,
        }
    }
}

impl Facts for Row {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        Rows::of([self.clone()], false).text(out)
    }
}

/// Rows for people.
#[derive(Serialize)]
pub(super) struct Rows {
    rows: Vec<Row>,
    headings: bool,
}

impl Rows {
    pub(super) fn of(rows: impl IntoIterator<Item = Row>, headings: bool) -> Self {
        Self { rows: rows.into_iter().collect(), headings }
    }
}

impl Facts for Rows {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.rows.is_empty() {
            return if self.headings { writeln!(out, "nothing is known of it") } else { Ok(()) };
        }
        let mut table = match self.headings {
            true => Table::new(["TIME", "BLOCK", "WHO", "DECISION", "ABOUT", "TIMES", "POLICIES", "DETAIL"]),
            false => Table::pairs(),
        };
        for row in &self.rows {
            table.row([
                time::moment(row.first),
                row.height.to_string(),
                row.who.clone(),
                [&row.decision, &row.code].map(String::as_str).join(" ").trim().to_owned(),
                row.subject.clone(),
                row.count.to_string(),
                if row.policy_version == 0 { String::new() } else { format!("version {}", row.policy_version) },
                row.words(),
            ]);
        }
        table.write(out, 0)
    }
}

impl Row {
    fn words(&self) -> String {
        let by = if self.by.is_empty() { String::new() } else { format!("by {}", self.by) };
        let epoch = if self.epoch == 0 { String::new() } else { format!("epoch {}", self.epoch) };
        let told = if self.told_by.is_empty() { String::new() } else { format!("told by {}", self.told_by) };
        let parts = [by, epoch, self.detail.clone(), told];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
    }
}
