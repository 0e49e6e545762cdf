//! `unshare`: taking a share back.

use super::list::find;
use super::{ChangeMode, WORDS};
use crate::answer;
use crate::command::policy::change::{AppliedChange, ProposedChange, apply, propose};
use crate::command::policy::rights::{Holdings, changes};
use crate::confirm;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Format, Output, printable};
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Access, PolicyDiff, ShareEntry, UnsharePreview};
use serde::Serialize;
use std::io::{self, Write};

/// Remove a share; for admins of its owner.
///
/// Grants that nothing else permits end in the same block. The command shows the permissions that people lose, and who
/// may still use the robot and why. Then it asks for confirmation.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl unshare share-Turtlebot4-Org1
  ledgerctl unshare Turtlebot4 --with Org1 --yes")]
pub(crate) struct Unshare {
    /// Name of the share, as in `share list`; with --with the robot or the service
    #[arg(value_name = "SHARE")]
    name: String,
    /// The organisation or the identity with which it is shared
    #[arg(long, value_name = "ORG[/PERSON]")]
    with: Option<String>,
    #[command(flatten)]
    how: ChangeMode,
}

impl Unshare {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let share = match &self.with {
            None => find(&session, &self.name).await?,
            Some(with) => of_receiver(&session, &self.name, with).await?,
        };
        let response = session.ask(ABAC, "unshare_preview", vec![Bytes::from(share.id)]).await;
        let preview: UnsharePreview =
            answer::parse(&response.map_err(|refused| WORDS.told(refused))?, "a share that ends")?;
        let UnsharePreview { id, text, mut set, diff, still } = preview;
        let ended = UnshareDifference { id, text, diff, still };
        let format = output.format();
        if format == Format::Table {
            output.show(&ended)?;
        }
        if self.how.dry_run {
            return if format == Format::Table { Ok(()) } else { output.show(&ended) };
        }
        confirm::agree("the end of the share", self.how.yes)?;
        // Robots without anyone who may publish were shown.
        set.means_it = true;
        if self.how.propose {
            return output.show(&ProposedChange::of(ended, propose(&session, &set).await?));
        }
        output.show(&AppliedChange::of(ended, apply(&session, &set).await?))
    }
}

/// The share of a robot or a service with this receiver.
async fn of_receiver(session: &Session, resource: &str, with: &str) -> Result<ShareEntry, Rejection> {
    let home = session.identity()?.organisation;
    let all: Vec<ShareEntry> = session.list(ABAC, "shares").await?;
    let is_meant = |share: &&ShareEntry| {
        share.terms.as_ref().is_some_and(|terms| terms.resource == resource && terms.with == with)
            && share.organisation == home
    };
    let found: Vec<&ShareEntry> = all.iter().filter(is_meant).collect();
    match found.as_slice() {
        [one] => Ok((*one).clone()),
        several => {
            let ids: Vec<&str> = several.iter().map(|share| share.id.as_str()).collect();
            let message = match ids.is_empty() {
                true => format!("{home} does not share {resource} with {with}"),
                false => format!("{home} shares {resource} with {with} more than once"),
            };
            Err(Rejection::new(Code::NotFound, message)
                .found(if ids.is_empty() { "no such share".to_owned() } else { ids.join(", ") })
                .wanted("one share")
                .next("ledgerctl share list, then ledgerctl unshare SHARE"))
        }
    }
}

/// The end of a share before it is in force.
#[derive(Serialize)]
struct UnshareDifference {
    id: String,
    text: String,
    diff: PolicyDiff,
    still: Vec<Access>,
}

impl Facts for UnshareDifference {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "the share {} ends", printable(&self.id))?;
        changes(out, &self.diff)?;
        if self.still.is_empty() {
            return writeln!(out, "afterwards, no listed member of another organisation may use the robot");
        }
        writeln!(out, "members of other organisations who may still use the robot:")?;
        Holdings(&self.still).write(out, 2)
    }
}
