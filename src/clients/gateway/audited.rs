//! Answers from the index of the audit.

use super::Questions;
use crate::clients::audit::Audit;
use crate::ordering::Ordering;
use ledger::Ledger;
use ledger_api::v1::{AuditRequest, AuditResponse, AuditRow};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use ledger_storage::audit::{Page, Question, Row};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Rows that are answered if the caller names no limit.
const ROWS_DEFAULT: u32 = 100;
/// Most rows of one answer.
const ROWS_MAX: u32 = 1000;

/// The answers that a node gives about the past.
pub(crate) struct Answers {
    /// The index.
    pub audit: Arc<Audit>,
    /// The ledger, its blocks, and readers that wait for a current state.
    pub ordering: Arc<Ordering>,
    /// The turns to read.
    pub questions: Questions,
}

impl Answers {
    pub(super) async fn answer(
        &self,
        reader: Arc<Identity>,
        request: AuditRequest,
    ) -> Result<AuditResponse, Rejection> {
        // Also a node without a leader tells what it knows.
        let _perhaps_older = self.ordering.reads.reach().await;
        self.audit.refresh().await?;
        let turn = self.questions.turn(&reader).await;
        let (audit, ledger) = (Arc::clone(&self.audit), Arc::clone(&self.ordering.storage.ledger));
        let found = tokio::task::spawn_blocking(move || {
            let mut owners = Owners { ledger: &ledger, reader: &reader, known: BTreeMap::new() };
            audit.find(&question(request), |row| owners.may_see(row)).map(|found| (found, ledger.tip().height))
        });
        let ((page, known), executed) =
            found.await.map_err(|_| Rejection::new(Code::Internal, "a thread panicked"))??;
        drop(turn);
        let Page { rows, after, more } = page;
        let (from_height, height) = known.map_or((0, 0), |known| (known.from, known.height));
        Ok(AuditResponse { rows: rows.into_iter().map(shown).collect(), after, more, from_height, height, executed })
    }
}

fn question(request: AuditRequest) -> Question {
    let AuditRequest { robot, user, organisation, code, since, until, after, limit } = request;
    let most = if limit == 0 { ROWS_DEFAULT } else { limit.min(ROWS_MAX) } as usize;
    Question { robot, user, organisation, code, since, until, after, most }
}

/// Knows whose robots a reader may look after.
struct Owners<'a> {
    ledger: &'a Ledger,
    reader: &'a Identity,
    /// By robot: does the reader's organisation own it?
    known: BTreeMap<String, bool>,
}

impl Owners<'_> {
    /// Everybody may see who holds what; others' commands and refusals are for those whom they concern, and for admins.
    fn may_see(&mut self, row: &Row) -> bool {
        let reader = self.reader;
        let is_about_others = row.is_use() || row.is_refusal();
        !is_about_others
            || reader.role == Role::Admin
            || row.organisations().any(|organisation| organisation == reader.organisation)
            || self.owns(&row.robot)
    }

    fn owns(&mut self, robot: &str) -> bool {
        if let Some(known) = self.known.get(robot) {
            return *known;
        }
        let owns = self.asked(robot).is_some_and(|owner| owner == self.reader.organisation);
        self.known.insert(robot.to_owned(), owns);
        owns
    }

    /// The organisation that owns a robot now.
    fn asked(&self, robot: &str) -> Option<String> {
        if robot.is_empty() {
            return None;
        }
        let args = [robot.to_owned().into()];
        let (answer, _) = self.ledger.query(self.reader, self.ledger.tip().time, "abac", "robot", &args).ok()?;
        let robot: serde_json::Value = serde_json::from_slice(&answer).ok()?;
        robot.get("organisation")?.as_str().map(str::to_owned)
    }
}

fn shown(row: Row) -> AuditRow {
    let Row { time, height, decision, who, by, robot, subject, code, count, first, last, last_height, .. } = row;
    let Row { epoch, policy_version, detail, found, transaction, told_by, policies, action, .. } = row;
    AuditRow {
        time,
        height,
        decision,
        who,
        by,
        robot,
        subject,
        code,
        count,
        first,
        last,
        last_height,
        epoch,
        policy_version,
        detail,
        found,
        transaction,
        told_by,
        policies,
        action,
    }
}
