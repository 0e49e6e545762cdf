//! `policy …`: the Cedar policies by which an organisation decides about its robots, and the numbered sets that they form.

mod apply;
pub(in crate::command) mod change;
mod check;
mod diff;
mod history;
pub(in crate::command) mod meaning;
pub(in crate::command) mod one;
mod propose;
mod recorded;
pub(in crate::command) mod rights;
mod set;
mod test;
pub(in crate::command) mod unknown;

use crate::argument::bytes;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, printable_lines};
use crate::session::{ABAC, Session};
use crate::words::{Words, shell_word};
use ::bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyEntry};
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;

/// Show and change the policies of the owners of robots.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Policy {
    List(List),
    Show(Show),
    Check(check::Check),
    Test(test::Test),
    Diff(diff::Diff),
    Shadow(recorded::Shadow),
    Put(one::Put),
    Remove(one::Remove),
    Apply(apply::Apply),
    History(history::History),
    Rollback(apply::Rollback),
    Propose(propose::Propose),
    Proposals(propose::Proposals),
    Approve(propose::Approve),
    Withdraw(propose::Withdraw),
    Approvals(propose::Approvals),
}

/// List the policies of every organisation, and the built-in policy.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy list")]
pub(crate) struct List {}

/// Show a policy.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl policy show night
  ledgerctl policy show Org2/night --version 3")]
pub(crate) struct Show {
    /// Name of the policy within your organisation, ORG/NAME, or `default` for the built-in policy
    id: String,
    /// From an earlier set (see `ledgerctl policy history`)
    #[arg(long, value_name = "NUMBER")]
    version: Option<u64>,
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words {
    arguments: &[
        ("ID", "the name of the policy"),
        ("TEXT", "the policy"),
        ("SET_JSON", "the set"),
        ("approvals", "--approvals"),
    ],
    help: "ledgerctl policy",
};

/// The text of a policy. One that begins with an annotation begins like the name of a file, and ends with a semicolon.
fn text(policy: &str) -> Result<Bytes, Rejection> {
    if policy.starts_with('@') && policy.trim_end().ends_with(';') {
        return Ok(Bytes::from(policy.to_owned()));
    }
    if Path::new(policy).is_file() {
        return Err(Rejection::new(Code::BadArgument, "the policy is not Cedar text")
            .found(format!("{policy}, the name of a file"))
            .wanted("a text such as permit(principal, action, resource);")
            .next(format!("ledgerctl policy put ID {}", shell_word(&format!("@{policy}")))));
    }
    bytes::argument(policy)
}

impl Policy {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        match self {
            Self::List(_) => output.show(&Policies(Session::open(global).await?.list(ABAC, "policies").await?)),
            Self::Show(show) => show.run(global, output).await,
            Self::Check(check) => check.run(global, output).await,
            Self::Diff(diff) => diff.run(global, output).await,
            Self::Shadow(shadow) => shadow.run(global, output).await,
            Self::Test(test) => test.run(global, output).await,
            Self::Apply(apply) => apply.run(global, output).await,
            Self::Rollback(rollback) => rollback.run(global, output).await,
            Self::History(history) => history.run(global, output).await,
            Self::Propose(propose) => propose.run(global, output).await,
            Self::Proposals(proposals) => proposals.run(global, output).await,
            Self::Approve(approve) => approve.run(global, output).await,
            Self::Withdraw(withdraw) => withdraw.run(global, output).await,
            Self::Approvals(approvals) => approvals.run(global, output).await,
            Self::Put(put) => put.run(global, output).await,
            Self::Remove(remove) => remove.run(global, output).await,
        }
    }
}

impl Show {
    async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let home = session.identity()?.organisation;
        if let Some(version) = self.version {
            return output.show(&One(history::entry(&session, &home, &self.id, version).await?));
        }
        let mut all: Vec<PolicyEntry> = session.list(ABAC, "policies").await?;
        let wanted = |entry: &PolicyEntry| match self.id.split_once('/') {
            Some((organisation, id)) => entry.organisation == organisation && entry.id == id,
            None => entry.id == self.id && (entry.organisation == home || entry.organisation.is_empty()),
        };
        // The organisation's own one stands behind the built-in one.
        match all.iter().rposition(wanted) {
            Some(at) => output.show(&One(all.swap_remove(at))),
            None => Err(not_found(&self.id, &home, &all).into()),
        }
    }
}

fn not_found(id: &str, home: &str, all: &[PolicyEntry]) -> Rejection {
    let known = all.iter().filter(|entry| entry.organisation == home || entry.organisation.is_empty());
    let known: Vec<&str> = known.map(|entry| entry.id.as_str()).collect();
    let near = ledger_base::nearest::did_you_mean(id, known.iter().copied(), "ledgerctl policy list");
    Rejection::new(Code::NotFound, "there is no policy of this name")
        .found(id)
        .wanted(format!("one of {}, or ORG/NAME of another organisation", known.join(", ")))
        .next(near)
}

#[derive(Serialize)]
struct One(PolicyEntry);

impl Facts for One {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{}", printable_lines(self.0.text.trim()))
    }
}

#[derive(Serialize)]
struct Policies(Vec<PolicyEntry>);

impl Facts for Policies {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        for PolicyEntry { organisation, id, text } in &self.0 {
            let owner =
                if organisation.is_empty() { "built in, for organisations without policies" } else { organisation };
            writeln!(out, "// {id} ({owner})\n{}\n", printable_lines(text.trim()))?;
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct Changed(PolicyChange);

impl Facts for Changed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let PolicyChange { organisation, id, change, default_in_force, ended, version, .. } = &self.0;
        let set = if *version == 0 { String::new() } else { format!(", version {version} of its policies") };
        match (change.as_str(), id.as_str()) {
            ("put", id) => writeln!(out, "policy {id} of {organisation} is in force{set}")?,
            ("unchanged", _) => writeln!(
                out,
                "nothing to change: version {version} of {organisation} is this set \
                                               already"
            )?,
            (done, "") => writeln!(out, "the policies of {organisation} are {done}{set}")?,
            (done, id) => writeln!(out, "policy {id} of {organisation} is {done}{set}")?,
        }
        if *default_in_force {
            writeln!(out, "{organisation} has no policy of its own any more: the built-in policy decides")?;
        }
        for grant in ended {
            writeln!(out, "  ended the grant of {} by {} (epoch {})", grant.service, grant.holder, grant.epoch)?;
        }
        Ok(())
    }
}
