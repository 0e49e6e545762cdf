//! Rows of the audit, and calls that were denied before ordering.

use super::{code_text, utc};
use ledger_api::v1;
use serde::Serialize;

/// A decision about control, as `ledgerctl audit -o json` prints it.
#[derive(Serialize)]
pub(in crate::clients::http) struct AuditFacts {
    time: u64,
    time_utc: Option<String>,
    height: u64,
    decision: String,
    who: String,
    by: String,
    robot: String,
    subject: String,
    code: String,
    count: u64,
    first: u64,
    first_utc: Option<String>,
    last: u64,
    last_utc: Option<String>,
    last_height: u64,
    epoch: u64,
    policy_version: u64,
    policies: Vec<String>,
    action: String,
    detail: String,
    found: String,
    transaction: String,
    told_by: String,
}

impl From<v1::AuditRow> for AuditFacts {
    fn from(row: v1::AuditRow) -> Self {
        Self {
            time: row.time,
            time_utc: utc(row.time),
            height: row.height,
            decision: row.decision,
            who: row.who,
            by: row.by,
            robot: row.robot,
            subject: row.subject,
            code: if row.code == 0 { String::new() } else { code_text(row.code) },
            count: row.count,
            first: row.first,
            first_utc: utc(row.first),
            last: row.last,
            last_utc: utc(row.last),
            last_height: row.last_height,
            epoch: row.epoch,
            policy_version: row.policy_version,
            policies: row.policies,
            action: row.action,
            detail: row.detail,
            found: row.found,
            transaction: hex::encode(row.transaction),
            told_by: row.told_by,
        }
    }
}

/// A call that this node denied, as `ledgerctl denials -o json` prints it.
#[derive(Serialize)]
pub(in crate::clients::http) struct DenialFacts {
    time: u64,
    time_utc: Option<String>,
    who: String,
    chaincode: String,
    function: String,
    subject: String,
    code: String,
    message: String,
    found: String,
    wanted: String,
    count: u64,
}

impl From<v1::Denial> for DenialFacts {
    fn from(denial: v1::Denial) -> Self {
        let verdict = denial.verdict.unwrap_or_default();
        Self {
            time: denial.time,
            time_utc: utc(denial.time),
            who: denial.who,
            chaincode: denial.chaincode,
            function: denial.function,
            subject: denial.subject,
            code: code_text(verdict.code),
            message: verdict.message,
            found: verdict.found,
            wanted: verdict.wanted,
            count: denial.count,
        }
    }
}
