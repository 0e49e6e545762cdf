//! `share`, `share list|show`, `unshare`: letting others use a robot without writing a policy.

mod list;
mod terms;
pub(crate) mod unshare;

use super::policy::change::{AppliedChange, ProposedChange, apply, propose};
use super::policy::meaning::meaning;
use super::policy::rights::changes;
use super::policy::unknown::shown;
use crate::answer;
use crate::confirm;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Format, Output, printable, printable_lines, warn};
use crate::session::{self, ABAC, Session};
use crate::words::Words;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyDiff, PolicyMeaning, SharePreview, ShareTerms, UnknownName};
use serde::Serialize;
use std::io::{self, Write};
use terms::Terms;

/// Permit an organisation or an identity to use a robot of yours; for admins of its owner.
///
/// Creates one policy. It shows the policy in words and in Cedar, and the permissions that it adds, and asks for
/// confirmation. A share permits acquire, publish and subscribe on command services, and subscribe on feeds: never
/// override, confirm, stop or resume. Other policies stay unchanged; the built-in policy stays in force. A share with
/// the same robot or service, receiver and attribute replaces the earlier one.
///
/// A named organisation does not have to be trusted. With --attr, the robot must trust it, so that the attributes of
/// its members count: `ledgerctl robot set ROBOT trust=ORG,ORG`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_help = "\
Example:
  ledgerctl share Turtlebot4 --with Org1
  ledgerctl share Turtlebot4/cmd_vel --with Org1/Salma --until 8h --max-linear 0.3
  ledgerctl share Husky --with Org1 --attr guest --hours '08:00-18:00 Mon-Fri' --yes
  ledgerctl share Husky --with Org3 --read-only")]
pub(crate) struct Share {
    #[command(subcommand)]
    command: Option<Shares>,
    #[command(flatten)]
    terms: Option<Terms>,
    #[command(flatten)]
    how: ChangeMode,
    /// Accept this name, although the network does not know it yet: Org1/Farhad
    #[arg(long, value_name = "NAME")]
    expect: Vec<String>,
}

/// How shares are changed.
#[derive(Debug, clap::Args)]
struct ChangeMode {
    /// Do not ask for confirmation
    #[arg(long)]
    yes: bool,
    /// Only show the changes
    #[arg(long, conflicts_with_all = ["yes", "propose"])]
    dry_run: bool,
    /// Propose the policy set with this change, if it needs approvals (see `ledgerctl policy approvals`)
    #[arg(long)]
    propose: bool,
}

#[derive(Debug, clap::Subcommand)]
enum Shares {
    List(list::List),
    Show(list::Show),
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words =
    Words { arguments: &[("TERMS_JSON", "the share"), ("ID", "the name of the share")], help: "ledgerctl share" };

impl Share {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        match (self.command, self.terms) {
            (Some(Shares::List(list)), _) => list.run(&session, output).await,
            (Some(Shares::Show(show)), _) => show.run(&session, output).await,
            (None, Some(terms)) => {
                let terms = terms.read(session.client.now())?;
                let preview = preview(&session, &terms).await?;
                check_names(&preview.unknown, &self.expect)?;
                finish(&session, output, terms, preview, &self.how).await
            }
            (None, None) => Err(Rejection::new(Code::BadArgument, "there is nothing to share")
                .wanted("ROBOT[/TOPIC] --with ORG[/PERSON]")
                .next("ledgerctl share --help")
                .into()),
        }
    }
}

/// The policy of a share, as the node composes it from the terms.
///
/// # Errors
/// [`Code::Untrusted`] if the node answers with another policy than these terms have.
async fn preview(session: &Session, terms: &ShareTerms) -> Result<SharePreview, Rejection> {
    let response = session.ask(ABAC, "share_preview", vec![session::argument(terms)?]).await;
    let preview: SharePreview = answer::parse(&response.map_err(|refused| WORDS.told(refused))?, "a share")?;
    check_text(terms, &preview)?;
    Ok(preview)
}

/// The admin signs this text: so it is compared with the one that the terms have.
fn check_text(terms: &ShareTerms, preview: &SharePreview) -> Result<(), Rejection> {
    let wanted = terms.text();
    let in_set = preview.set.policies.iter().flatten().find(|policy| policy.id == preview.id);
    if preview.text == wanted && in_set.is_some_and(|policy| policy.text == wanted) {
        return Ok(());
    }
    Err(Rejection::new(Code::Untrusted, "the node composed a policy that differs from these terms")
        .found(preview.text.clone())
        .wanted(wanted)
        .next("create the share through another node of your organisation"))
}

/// Rejects names that are unknown today and not expected.
fn check_names(unknown: &[UnknownName], expected: &[String]) -> Result<(), Rejection> {
    let Some(name) = unknown.iter().find(|name| !expected.contains(&name.name)) else { return Ok(()) };
    Err(Rejection::new(Code::PolicyInvalid, "the share names something that the network does not have")
        .found(shown(name))
        .wanted("a member of the network, or an enrolled identity")
        .next(format!("correct it, or if it will exist later: --expect '{}'", name.name)))
}

async fn finish(
    session: &Session,
    output: &mut Output,
    terms: ShareTerms,
    preview: SharePreview,
    how: &ChangeMode,
) -> Result<(), Failure> {
    let set = preview.set.clone();
    let shared = ShareDifference::of(terms, preview);
    let (format, is_new) = (output.format(), shared.is_new());
    if format == Format::Table {
        output.show(&shared)?;
    }
    if !shared.trusted && is_new {
        let robot = shared.terms.robot().to_owned();
        let message =
            format!("{robot} does not trust {}: attributes of its members have no effect", shared.terms.organisation());
        let next = format!(
            "this share needs no attribute; to trust the organisation: ledgerctl robot set {robot} \
                            trust=ORG,ORG"
        );
        warn(format, &message, &next);
    }
    if how.dry_run || !is_new {
        return if format == Format::Table { Ok(()) } else { output.show(&shared) };
    }
    confirm::agree("the share", how.yes)?;
    if how.propose {
        return output.show(&ProposedChange::of(shared, propose(session, &set).await?));
    }
    output.show(&AppliedChange::of(shared, apply(session, &set).await?))
}

/// A share before it is in force.
#[derive(Serialize)]
struct ShareDifference {
    id: String,
    #[serde(flatten)]
    terms: ShareTerms,
    text: String,
    meaning: Vec<PolicyMeaning>,
    replaces: String,
    keeps_built_in: bool,
    trusted: bool,
    diff: PolicyDiff,
}

impl ShareDifference {
    fn of(terms: ShareTerms, preview: SharePreview) -> Self {
        let SharePreview { id, text, meaning, replaces, keeps_built_in, trusted, diff, .. } = preview;
        Self { id, terms, text, meaning, replaces, keeps_built_in, trusted, diff }
    }

    /// Does it change the set in force?
    fn is_new(&self) -> bool {
        !(self.diff.added.is_empty() && self.diff.changed.is_empty())
    }
}

impl Facts for ShareDifference {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if !self.is_new() {
            return writeln!(out, "nothing to change: it is shared already, as {}", printable(&self.id));
        }
        writeln!(out, "{}:", printable(&self.id))?;
        for policy in &self.meaning {
            meaning(out, policy)?;
        }
        for line in printable_lines(self.text.trim()).lines() {
            writeln!(out, "    {line}")?;
        }
        if !self.replaces.is_empty() {
            writeln!(out, "it replaces the share {}", printable(&self.replaces))?;
        }
        if self.keeps_built_in {
            writeln!(out, "the built-in policy stays in force, as the policy default")?;
        }
        changes(out, &self.diff)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{PolicyDraft, PolicyText};

    fn preview(terms: &ShareTerms) -> SharePreview {
        let text = terms.text();
        let policies = Some(vec![PolicyText { id: "share-x".into(), text: text.clone() }]);
        SharePreview {
            id: "share-x".into(),
            text,
            meaning: vec![],
            replaces: String::new(),
            keeps_built_in: true,
            trusted: true,
            unknown: vec![],
            set: PolicyDraft { policies, ..PolicyDraft::default() },
            diff: PolicyDiff::default(),
        }
    }

    #[test]
    fn a_policy_that_a_node_has_made_of_other_terms_is_not_signed() {
        let terms = ShareTerms { resource: "Husky".into(), with: "Org1".into(), ..ShareTerms::default() };
        assert!(check_text(&terms, &preview(&terms)).is_ok());
        let other = ShareTerms { with: "Org3".into(), ..terms.clone() };
        assert_eq!(check_text(&terms, &preview(&other)).unwrap_err().code, Code::Untrusted);
        let hidden = SharePreview { text: terms.text(), ..preview(&other) };
        assert_eq!(check_text(&terms, &hidden).unwrap_err().code, Code::Untrusted, "the set has another text");
    }

    #[test]
    fn an_unknown_name_is_shared_with_only_if_it_is_expected() {
        let unknown = [UnknownName { line: 1, kind: "User".into(), name: "Org1/Late".into(), near: String::new() }];
        let refused = check_names(&unknown, &[]).unwrap_err();
        assert!(refused.advice().contains("--expect 'Org1/Late'"), "{refused}");
        assert!(check_names(&unknown, &["Org1/Late".to_owned()]).is_ok());
    }
}
