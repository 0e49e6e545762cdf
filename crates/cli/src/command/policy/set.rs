//! A whole set of policies on the command line.

use super::unknown::Expected;
use crate::argument::policies;
use crate::session::Session;
use ledger_base::rejection::Rejection;
use ledger_contract::PolicyDraft;
use std::path::PathBuf;

/// A set in files.
#[derive(Debug, clap::Args)]
pub(super) struct Set {
    /// Files with policies in Cedar: night.cedar is the policy `night`
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,
    /// No policies of your own: the built-in policy decides
    #[arg(long, conflicts_with = "files")]
    built_in: bool,
    #[command(flatten)]
    about: About,
    /// Approval rule for the next set: a quorum such as 'admins = 2', or none
    #[arg(long, value_name = "QUORUM")]
    approvals: Option<String>,
    #[command(flatten)]
    expected: Expected,
}

/// The circumstances of a set.
#[derive(Debug, clap::Args)]
pub(super) struct About {
    /// Reason; recorded in the history
    #[arg(long, short, default_value = "", hide_default_value = true)]
    message: String,
    /// Version that the set was made from: if another one is in force, nothing is changed
    #[arg(long, value_name = "VERSION")]
    base: Option<u64>,
    /// Also if no one could publish to some robot afterwards
    #[arg(long)]
    i_mean_it: bool,
}

impl Set {
    /// The set as an argument, if the network knows its names. An earlier version comes back whatever names it has.
    pub(super) async fn checked(self, session: &Session, restores: Option<u64>) -> Result<PolicyDraft, Rejection> {
        let expected = self.expected.clone();
        let draft = self.draft(restores)?;
        expected.check(session, draft.policies.as_deref().unwrap_or_default()).await?;
        Ok(draft)
    }

    /// The set as an argument.
    fn draft(self, restores: Option<u64>) -> Result<PolicyDraft, Rejection> {
        let policies = match restores {
            Some(_) => None,
            None => Some(policies::read(&self.files)?.unwrap_or_default()),
        };
        Ok(self.about.draft(PolicyDraft { policies, restores, approvals: self.approvals, ..PolicyDraft::default() }))
    }
}

impl About {
    /// The draft with these circumstances.
    pub(super) fn draft(self, draft: PolicyDraft) -> PolicyDraft {
        PolicyDraft { message: self.message, base: self.base, means_it: self.i_mean_it, ..draft }
    }
}
