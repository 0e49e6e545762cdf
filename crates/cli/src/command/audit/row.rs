//! One row of the audit, for people and programs.

use crate::output::{Facts, Table};
use crate::time;
use ledger_api::v1::AuditRow;
use serde::Serialize;
use std::io::{self, Write};

/// The names of the columns, as those of the fields in JSON.
pub(super) const CSV_HEAD: &str = "time,height,decision,who,by,robot,subject,code,count,first,last,last_height,epoch,policy_version,policies,detail,found,transaction,told_by\n";

/// A decision about control. Times are those of RFC 3339.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    time: String,
    height: u64,
    decision: String,
    who: String,
    by: String,
    robot: String,
    subject: String,
    /// Empty if nothing was refused.
    code: String,
    count: u64,
    first: String,
    last: String,
    last_height: u64,
    epoch: u64,
    policy_version: u64,
    /// Ids of those that decided.
    policies: Vec<String>,
    detail: String,
    found: String,
    transaction: String,
    told_by: String,
    #[serde(skip)]
    began: u64,
}

impl From<AuditRow> for Row {
    fn from(row: AuditRow) -> Self {
        Self {
            time: time::rfc3339(row.time),
            height: row.height,
            decision: row.decision,
            who: row.who,
            by: row.by,
            robot: row.robot,
            subject: row.subject,
            code: if row.code == 0 { String::new() } else { format!("LGR-{:04}", row.code) },
            count: row.count,
            first: time::rfc3339(row.first),
            last: time::rfc3339(row.last),
            last_height: row.last_height,
            epoch: row.epoch,
            policy_version: row.policy_version,
            policies: row.policies,
            detail: row.detail,
            found: row.found,
            transaction: hex::encode(&row.transaction),
            told_by: row.told_by,
            began: row.first,
        }
    }
}

impl Row {
    /// One line of comma-separated values (RFC 4180).
    pub(super) fn csv(&self) -> String {
        let numbers =
            [self.height, self.count, self.last_height, self.epoch, self.policy_version].map(|n| n.to_string());
        let [height, count, last_height, epoch, version] = &numbers;
        let cells = [
            &self.time,
            height,
            &self.decision,
            &self.who,
            &self.by,
            &self.robot,
            &self.subject,
            &self.code,
            count,
            &self.first,
            &self.last,
            last_height,
            epoch,
            version,
            &self.policies.join(" "),
            &self.detail,
            &self.found,
            &self.transaction,
            &self.told_by,
        ];
        cells.map(|cell| quoted(cell)).join(",") + "\n"
    }
}

/// A cell that no program takes for a formula or for more than one cell, and no terminal obeys.
fn quoted(cell: &str) -> String {
    let cell = crate::output::printable(cell);
    let formula = cell.starts_with(['=', '+', '-', '@']);
    if formula || cell.contains([',', '"', '\n']) {
        format!("\"{}{}\"", if formula { "'" } else { "" }, cell.replace('"', "\"\""))
    } else {
        cell.into_owned()
    }
}

impl Facts for Row {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(self.csv().as_bytes())
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
                time::moment(row.began),
                row.height.to_string(),
                row.who.clone(),
                [&row.decision, &row.code].map(String::as_str).join(" ").trim().to_owned(),
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

    fn words(&self) -> String {
        let by = if self.by.is_empty() { String::new() } else { format!("by {}", self.by) };
        let epoch = if self.epoch == 0 { String::new() } else { format!("epoch {}", self.epoch) };
        let told = if self.told_by.is_empty() { String::new() } else { format!("told by {}", self.told_by) };
        let parts = [by, epoch, self.detail.clone(), told];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_one_cell_and_no_formula() {
        for (cell, wanted) in [
            ("Org1/Salma", "Org1/Salma"),
            ("a, \"b\"", "\"a, \"\"b\"\"\""),
            ("=HYPERLINK(1)", "\"'=HYPERLINK(1)\""),
            ("a\nb\u{1b}", "a\\nb\\u{1b}"),
        ] {
            assert_eq!(quoted(cell), wanted);
        }
        let columns = CSV_HEAD.trim_end().split(',').count();
        assert_eq!(Row::from(AuditRow::default()).csv().trim_end().split(',').count(), columns);
    }
}
