//! Applying or proposing a set of policies that was previewed.

use super::propose::arguments;
use super::{Changed, WORDS};
use crate::answer;
use crate::output::{Facts, printable};
use crate::session::{ABAC, Session};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyDraft, PolicyProposal};
use serde::Serialize;
use std::io::{self, Write};

/// Puts a set in force, unless another one came in force after the preview.
///
/// # Errors
/// [`Code::PoliciesChanged`], [`Code::NeedsApproval`], and all others of `policy apply`.
pub(in crate::command) async fn apply(session: &Session, set: &PolicyDraft) -> Result<PolicyChange, Rejection> {
    let done = session.call(ABAC, "policy", arguments("apply", set)?).await.map_err(|refused| match refused.code {
        Code::PoliciesChanged => WORDS.told(refused).next("run the command again: it starts from the set in force"),
        Code::NeedsApproval => WORDS.told(refused).next("propose it: the same command with --propose"),
        _ => WORDS.told(refused),
    })?;
    answer::parse(&done.response, "a change of policies")
}

/// Proposes a set to those who must agree.
///
/// # Errors
/// Those of `policy propose`.
pub(in crate::command) async fn propose(session: &Session, set: &PolicyDraft) -> Result<PolicyProposal, Rejection> {
    let done = session.call(ABAC, "policy", arguments("propose", set)?).await.map_err(|refused| WORDS.told(refused))?;
    answer::parse(&done.response, "a proposal of policies")
}

/// A previewed change that is in force.
#[derive(Serialize)]
pub(in crate::command) struct AppliedChange<T> {
    #[serde(flatten)]
    preview: T,
    change: PolicyChange,
}

/// A previewed change that is proposed.
#[derive(Serialize)]
pub(in crate::command) struct ProposedChange<T> {
    #[serde(flatten)]
    preview: T,
    proposal: String,
}

impl<T> AppliedChange<T> {
    pub(in crate::command) fn of(preview: T, change: PolicyChange) -> Self {
        Self { preview, change }
    }
}

impl<T> ProposedChange<T> {
    pub(in crate::command) fn of(preview: T, proposal: PolicyProposal) -> Self {
        Self { preview, proposal: proposal.id }
    }
}

/// The preview was shown before.
impl<T: Serialize> Facts for AppliedChange<T> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        Changed(self.change.clone()).text(out)
    }
}

impl<T: Serialize> Facts for ProposedChange<T> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let id = printable(&self.proposal);
        writeln!(out, "proposed as {id}\n  to approve: ledgerctl policy approve {id}")
    }
}
