//! Rows of the audit, and calls that were rejected before ordering.

use super::{code_text, utc};
use crate::v1;
use serde::Serialize;

/// A decision about control (docs/audit.md).
#[derive(Debug, Serialize)]
pub struct AuditFacts {
    /// Block time.
    pub time: u64,
    time_utc: Option<String>,
    /// Height of the block.
    pub height: u64,
    /// The name of an event; `used` for commands, `refused` for rejections.
    pub decision: String,
    /// The identity that it is about; empty if there is none.
    pub who: String,
    /// The author, if that is another identity.
    pub by: String,
    /// The robot; empty if it is about none.
    pub robot: String,
    /// The service, or what else it is about.
    pub subject: String,
    /// Code of a rejection; empty if nothing was rejected.
    pub code: String,
    /// Number of commands or rejections of a minute in this row.
    pub count: u64,
    /// Time of the first of them.
    pub first: u64,
    first_utc: Option<String>,
    /// Time of the last of them.
    pub last: u64,
    last_utc: Option<String>,
    /// Height of the last of them.
    pub last_height: u64,
    /// Epoch of a grant, or of commands.
    pub epoch: u64,
    /// Number of the owner's set of policies that decided; 0 if it is unknown, or the owner has none.
    pub policy_version: u64,
    /// Ids of the policies that decided.
    pub policies: Vec<String>,
    /// The action that policies decided on; empty if it is unknown, or policies did not decide.
    pub action: String,
    /// A reason, a change, or the message of a rejection.
    pub detail: String,
    /// The value that a rejection names as found.
    pub found: String,
    /// Id of the transaction, or of one of them; empty if there is none.
    pub transaction: String,
    /// The node that rejected before ordering and reports it; empty if the chain shows it.
    pub told_by: String,
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

/// Calls that a node rejected before ordering, alike in a row.
#[derive(Debug, Serialize)]
pub struct DenialFacts {
    /// The node's clock.
    pub time: u64,
    time_utc: Option<String>,
    /// The caller.
    pub who: String,
    /// The chaincode that was called.
    pub chaincode: String,
    /// The function that was called.
    pub function: String,
    /// The first argument, usually the service.
    pub subject: String,
    /// Code of the rejection.
    pub code: String,
    /// Why it was rejected.
    pub message: String,
    /// The value that was found.
    pub found: String,
    /// The value that was wanted.
    pub wanted: String,
    /// Number of them.
    pub count: u64,
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
