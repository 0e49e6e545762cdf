//! `policy apply`, `policy rollback`: a whole set takes the place of the one in force.

use super::propose::{self, resolve};
use super::set::{About, Set};
use super::{Changed, WORDS};
use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_contract::PolicyDraft;

/// Put a complete set of policies in force; for admins.
///
/// The set replaces all policies of your organisation and gets the next version number. Grants that it no longer
/// permits end in the same block. If the change needs approvals, propose it first, and apply the proposal once it is
/// approved.
#[derive(Debug, clap::Args)]
#[command(mut_arg("files", |files| files.required_unless_present_any(["proposal", "built_in"])))]
#[command(after_help = "\
Example:
  ledgerctl policy apply night.cedar guests.cedar -m 'guests until Friday'
  ledgerctl policy apply night.cedar --approvals 'admins = 2'
  ledgerctl policy apply --proposal 3f9a0c77")]
pub(crate) struct Apply {
    #[command(flatten)]
    set: Set,
    /// Apply a proposal: its id, or at least its first 8 digits
    #[arg(long, value_name = "ID", conflicts_with_all = ["files", "built_in", "message", "base", "approvals", "i_mean_it", "expect"])]
    proposal: Option<String>,
    /// Apply a proposal that is three days old without the approvals that your organisation requires
    #[arg(long, requires = "proposal")]
    break_glass: bool,
}

/// Restore the policies of an earlier version; for admins.
///
/// They become a new version. Grants that they do not permit end in the same block.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy rollback 3 -m 'guests could not drive'")]
pub(crate) struct Rollback {
    /// The version, as `ledgerctl policy history` shows it
    version: u64,
    #[command(flatten)]
    about: About,
}

impl Apply {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let args = match self.proposal {
            Some(id) => {
                let id = Bytes::from(resolve(&session, &id).await?);
                let break_glass = self.break_glass.then(|| Bytes::from_static(b"break-glass"));
                [Bytes::from_static(b"enact"), id].into_iter().chain(break_glass).collect()
            }
            None => propose::arguments("apply", &self.set.checked(&session, None).await?)?,
        };
        change(&session, output, args).await
    }
}

impl Rollback {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let draft = self.about.draft(PolicyDraft { restores: Some(self.version), ..PolicyDraft::default() });
        change(&Session::open(global).await?, output, propose::arguments("apply", &draft)?).await
    }
}

async fn change(session: &Session, output: &mut Output, args: Vec<Bytes>) -> Result<(), Failure> {
    let done = session.call(ABAC, "policy", args).await.map_err(|refused| WORDS.told(refused))?;
    output.show(&Changed(answer::parse(&done.response, "a change of policies")?))
}
